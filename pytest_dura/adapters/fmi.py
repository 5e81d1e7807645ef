"""Fmu: a Functional Mock-up Unit as a black box, by FMPy (``pip install pytest-dura[fmi]``)."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property
from pathlib import Path
from typing import Any
from weakref import finalize

import numpy as np

from pytest_dura.adapters.black_box import BlackBox, Curves, Input
from pytest_dura.adapters.black_box_run import Floats
from pytest_dura.core.errors import ConfigurationError, describe_error, did_you_mean
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.roles import Generator
from pytest_dura.core.simulator import Simulator

_LOGGED = 3
"""The last so many messages of an FMU stand in the error of a run that it ended."""
_FATAL = 4
"""The status of a call after which an FMU is unusable, in FMI 2 and 3."""
_VERSIONS = ("2.", "3.")
_REALS = ("Real", "Float32", "Float64")
_INTEGERS = ("Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")
_WHOLE: Mapping[str, tuple[int, int]] = {
    **{name: (np.iinfo(name.lower()).min, np.iinfo(name.lower()).max) for name in _INTEGERS},
    **dict.fromkeys(("Integer", "Enumeration"), (np.iinfo("int32").min, np.iinfo("int32").max)),
    "Boolean": (0, 1),
}
"""Types of variables whose values are whole numbers, with the least and the greatest of them."""


class Fmu(BlackBox):
    """An FMU for co-simulation, FMI 2 or 3, whose inputs are searched and whose outputs are judged.

    It steps from sample to sample, so that the scenario's ``time_step`` is its communication step;
    where it allows other steps, a piece of a constant input begins exactly where it should. Each
    run has an instance of its own. It is native code: one that crashes ends its process, of which
    ``--dura-executor=processes`` makes an episode that is missing.

    Args:
        file: The ``.fmu``; best from the module's own place, ``Path(__file__).parent / ...``.
        inputs: Inputs of the FMU that scenarios give, each a scalar. One of type Boolean (0 and 1),
            Integer or Enumeration gets the nearest whole number, which its signal has as well.
            Others keep their start values, whatever their type.
        signals: Variables of the FMU that requirements read.
        variables: The FMU's name of an input or signal that is called otherwise here.
        start_values: Values of parameters and of inputs that scenarios do not give, by the FMU's
            names.
        tolerances: See :class:`BlackBox`.
        validate: Whether FMPy validates the model description of the file. ``False`` takes a file
            that it refuses as it is; the evidence names it among the component's parameters.

    Raises:
        ConfigurationError: For names that cannot be used. What the FMU itself does not have is
            refused when a scenario is first checked.
    """

    def __init__(
        self,
        file: str | Path,
        inputs: Sequence[Input],
        signals: Sequence[str],
        *,
        variables: Mapping[str, str] = NOTHING,
        start_values: Mapping[str, Any] = NOTHING,
        tolerances: Mapping[str, float] = NOTHING,
        validate: bool = True,
    ) -> None:
        self.file, self.start_values, self.validate = Path(file), dict(start_values), validate
        self._variables = dict(variables)
        super().__init__(self._simulate, inputs, signals, files=[file], tolerances=tolerances)

    def __call__(
        self,
        *,
        component: bool = False,
        files: Mapping[str, str] = NOTHING,
        validate: bool = True,  # noqa: ARG002 - for the record: a run depends on the file
    ) -> Simulator | Generator:
        """Build the simulator of an episode; or its component, see :class:`BlackBox`."""
        return super().__call__(component=component, files=files)

    def resolve_parameters(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return the parameters with the file's digest, and with ``validate`` where that is off."""
        unchecked = {} if self.validate else {"validate": False}
        return super().resolve_parameters({**unchecked, **params})

    def check_scenario(self, world: Mapping[str, Any]) -> dict[str, Any]:
        """Return the inputs that a scenario gives, defaults filled in, whole where they have to be.

        Raises:
            ConfigurationError: For what the inputs do not take, and for an FMU that cannot be used,
                or has no such variables.
        """
        variables = {variable.name: variable for variable in self._description.modelVariables}
        values = super().check_scenario(world)
        for name, value in values.items():
            if variables[self._variable(name)].type in _WHOLE:
                listed = isinstance(value, list)
                values[name] = [float(round(v)) for v in value] if listed else float(round(value))
        return values

    def _simulate(self, time: Floats, inputs: Curves) -> dict[str, Floats]:
        """Run a fresh instance of the FMU from 0 to the last sample."""
        from fmpy.simulation import apply_start_values, instantiate_fmu, simulate_fmu

        description, messages = self._description_of_runs, _Messages(self._description.fmiVersion)
        instance = instantiate_fmu(
            self._folder, description, "CoSimulation", logger=messages.receive, debug_logging=True
        )
        left = {variable.name for variable in self._inputs_left}
        kept = {name: self.start_values[name] for name in self.start_values if name in left}
        others = {name: self.start_values[name] for name in self.start_values if name not in left}
        try:
            apply_start_values(instance, self._description, kept)
            result = simulate_fmu(
                self._folder,
                validate=False,
                start_time=0.0,
                stop_time=float(time[-1]),
                output_interval=float(time[1] - time[0]),
                start_values=others,
                input=self._table(inputs, float(time[-1])),
                output=[self._variable(name) for name in self.signals],
                model_description=description,
                fmu_instance=instance,
            )
        except Exception as error:
            if getattr(error, "status", None) != _FATAL:  # after it nothing may be called any more
                instance.freeInstance()
            logged = "".join(f"; {message}" for message in messages.last)
            raise RuntimeError(
                f"{self.file.name} failed: {describe_error(error)}{logged}"
            ) from None
        instance.freeInstance()
        columns = {name: result[self._variable(name)] for name in self.signals}
        return {"time": np.asarray(result["time"], dtype=np.float64), **columns}

    def _table(self, inputs: Curves, end: float) -> Any:
        """Make FMPy's table of inputs: a time that stands twice is a jump."""
        breaks = {True: {0.0}, False: {0.0}}  # whether the input jumps there
        for curve in inputs.values():
            breaks[curve.interpolation == "constant"] |= set(curve.times.tolist())
        jumps = [at for at in breaks[True] if 0.0 < at < end]
        times = sorted([*(breaks[True] | breaks[False] | {end}), *jumps])
        kinds = [(self._variable(name), np.float64) for name in inputs]
        table = np.zeros(len(times), dtype=[("time", np.float64), *kinds])
        table["time"] = times
        before = np.flatnonzero(np.diff(table["time"]) == 0.0)
        for name, curve in inputs.items():
            column = curve(table["time"])
            if curve.interpolation == "constant":
                column[before] = column[before - 1]
            table[self._variable(name)] = column
        return table

    @cached_property
    def _folder(self) -> str:
        """The unpacked FMU, as long as this object lives in the process that made it."""
        from fmpy import extract

        folder = tempfile.mkdtemp(prefix="dura-fmu-")
        finalize(self, _remove, folder, os.getpid())
        extract(str(self.file), folder)
        return folder

    @cached_property
    def _description(self) -> Any:
        """FMPy's description of the model, checked."""
        description = self._read()
        if not str(description.fmiVersion).startswith(_VERSIONS) or not description.coSimulation:
            kinds = ("modelExchange", "coSimulation", "scheduledExecution")
            offered = [kind for kind in kinds if getattr(description, kind, None)]
            raise ConfigurationError(
                "this FMU cannot be run",
                file=str(self.file),
                found=f"FMI {description.fmiVersion}, {', '.join(offered)}",
                expected="FMI 2 or 3, co-simulation",
                remedy="export it for co-simulation",
            )
        variables = {variable.name: variable for variable in description.modelVariables}
        places = dict.fromkeys((self._variable(given.name) for given in self.inputs), "inputs")
        places |= {self._variable(name): "signals" for name in self.signals}
        places |= dict.fromkeys(self.start_values, "start_values")
        for name, key in places.items():
            known = [v for v in variables if key != "inputs" or variables[v].causality == "input"]
            if name not in known:
                raise ConfigurationError(
                    f"the FMU has no {'input' if key == 'inputs' else 'variable'} {name!r}",
                    file=str(self.file),
                    key=key,
                    found=name,
                    expected=", ".join(known[:20]) or "none",
                    remedy=did_you_mean(name, known),
                )
        for name, key in places.items():
            if key != "start_values" and not _is_number(variables[name]):
                kind = variables[name].type
                raise ConfigurationError(
                    f"the FMU's variable {name!r} is not a number",
                    file=str(self.file),
                    key=key,
                    found=f"an array of {kind}" if variables[name].shape else f"type {kind}",
                    expected="a scalar: a number, Boolean or Enumeration",
                    remedy=f"leave it out of `{key}`; an input keeps its start value without it",
                )
        for given in self.inputs:
            self._check_range(given, variables[self._variable(given.name)])
        return description

    def _check_range(self, given: Input, variable: Any) -> None:
        """Refuse an input whose numbers are not all those of a variable that takes whole numbers.

        Raises:
            ConfigurationError: With the variable's type and its least and greatest value.
        """
        if variable.type not in _WHOLE:
            return
        least, greatest = _WHOLE[variable.type]
        items = [] if variable.declaredType is None else variable.declaredType.items
        if items:
            numbers = [int(item.value) for item in items]
            least, greatest = min(numbers), max(numbers)
        range_ = given.low, given.value_by_default, given.high
        is_whole = all(float(value).is_integer() and least <= value <= greatest for value in range_)
        if not is_whole or given.interpolation == "linear":
            raise ConfigurationError(
                f"the FMU's input {variable.name!r} of type {variable.type} takes whole numbers",
                file=str(self.file),
                key="inputs",
                found=given,
                expected=f"low, high and nominal from {least} to {greatest}, constant in pieces",
            )

    @cached_property
    def _inputs_left(self) -> list[Any]:
        """Inputs of the FMU that no scenario gives."""
        given = {self._variable(name.name) for name in self.inputs}
        inputs = [v for v in self._description.modelVariables if v.causality == "input"]
        return [variable for variable in inputs if variable.name not in given]

    @cached_property
    def _description_of_runs(self) -> Any:
        """The description in which inputs that no scenario gives are none, so that FMPy sets none.

        Its table of inputs holds numbers only, and it prints a warning for each that is missing.
        """
        left = {variable.name for variable in self._inputs_left}
        description = copy(self._description)
        description.modelVariables = [copy(v) for v in description.modelVariables]
        for variable in description.modelVariables:
            if variable.name in left:
                variable.causality, variable.variability = "local", "discrete"
        return description

    @property
    def is_log(self) -> bool:
        """No: its times are those of its communication steps."""
        return False

    def _read(self) -> Any:
        try:
            from fmpy import read_model_description
            from fmpy.model_description import ValidationError
        except ImportError:
            raise ConfigurationError(
                "FMUs need the package FMPy",
                file=str(self.file),
                remedy="pip install 'pytest-dura[fmi]'",
            ) from None
        try:
            return read_model_description(str(self.file), validate=self.validate)
        except Exception as error:  # of zipfile, of lxml, and of FMPy itself
            remedy = "correct the path that is given to Fmu"
            if isinstance(error, ValidationError):
                remedy = "give Fmu `validate=False`, which the evidence names"
            raise ConfigurationError(
                f"{self.file.name} is no FMU that can be read: {describe_error(error)}",
                file=str(self.file),
                key="simulator",  # of a scenario, whose place may replace this file's
                found=str(self.file) if self.file.is_file() else f"no file {self.file}",
                expected="an .fmu of FMI 2 or 3, a zip archive with modelDescription.xml",
                remedy=f"export it again, or {remedy}",
            ) from None

    def _variable(self, name: str) -> str:
        return self._variables.get(name, name)


def _is_number(variable: Any) -> bool:
    """Whether a variable is a scalar with numbers as values."""
    return not variable.shape and variable.type in (*_REALS, *_WHOLE)


def _remove(folder: str, process: int) -> None:
    if os.getpid() == process:  # and not in one that was forked of it
        shutil.rmtree(folder, ignore_errors=True)


class _Messages:
    """Keeps the last messages of an FMU, which calls it from native code."""

    def __init__(self, version: str) -> None:
        self.last: list[str] = []
        self._place = 4 if version.startswith("2") else 3
        """Of the text among the arguments."""

    def receive(self, *arguments: Any) -> None:
        """Keep a message."""
        text = arguments[self._place]
        plain = text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
        self.last = [*self.last, " ".join(plain.split())][-_LOGGED:]
