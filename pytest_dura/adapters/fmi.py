"""Fmu: a Functional Mock-up Unit as a black box, by FMPy (``pip install pytest-dura[fmi]``)."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any
from weakref import finalize

import numpy as np

from pytest_dura.adapters.black_box import BlackBox, Curves, Floats, Input
from pytest_dura.core.errors import ConfigurationError, describe_error, did_you_mean
from pytest_dura.core.state import NOTHING

_LOGGED = 3
"""The last so many messages of an FMU stand in the error of a run that it ended."""
_FATAL = 4
"""The status of a call after which an FMU is unusable, in FMI 2 and 3."""
_VERSIONS = ("2.", "3.")


class Fmu(BlackBox):
    """An FMU for co-simulation, FMI 2 or 3, whose inputs are searched and whose outputs are judged.

    It steps from sample to sample, so that the scenario's ``time_step`` is its communication step;
    where it allows other steps, a piece of a constant input begins exactly where it should. Each
    run has an instance of its own. It is native code: one that crashes ends its process, of which
    ``--dura-executor=processes`` makes an episode that is missing.

    Args:
        file: The ``.fmu``; best from the module's own place, ``Path(__file__).parent / ...``.
        inputs: Inputs of the FMU that scenarios give. Others keep their start values.
        signals: Variables of the FMU that requirements read.
        variables: The FMU's name of an input or signal that is called otherwise here.
        start_values: Values of parameters, by the FMU's names.
        tolerances: See :class:`BlackBox`.

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
    ) -> None:
        self.file, self.start_values = Path(file), dict(start_values)
        self._variables = dict(variables)
        super().__init__(self._simulate, inputs, signals, files=[file], tolerances=tolerances)

    def check_scenario(self, world: Mapping[str, Any]) -> dict[str, Any]:
        """Return the inputs that a scenario gives, defaults filled in.

        Raises:
            ConfigurationError: For what the inputs do not take, and for an FMU that cannot be used,
                or has no such variables.
        """
        _ = self._description
        return super().check_scenario(world)

    def _simulate(self, time: Floats, inputs: Curves) -> dict[str, Floats]:
        """Run a fresh instance of the FMU from 0 to the last sample."""
        from fmpy.simulation import instantiate_fmu, simulate_fmu

        description, messages = self._description, _Messages(self._description.fmiVersion)
        instance = instantiate_fmu(
            self._folder, description, "CoSimulation", logger=messages.receive, debug_logging=True
        )
        try:
            result = simulate_fmu(
                self._folder,
                validate=False,
                start_time=0.0,
                stop_time=float(time[-1]),
                output_interval=float(time[1] - time[0]),
                start_values=dict(self.start_values),
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
        rest = [v for v in self._inputs if v.name not in {name for name, _ in kinds}]
        kinds += [(variable.name, np.float64) for variable in rest]
        table = np.zeros(len(times), dtype=[("time", np.float64), *kinds])
        table["time"] = times
        before = np.flatnonzero(np.diff(table["time"]) == 0.0)
        for name, curve in inputs.items():
            column = curve(table["time"])
            if curve.interpolation == "constant":
                column[before] = column[before - 1]
            table[self._variable(name)] = column
        for variable in rest:
            table[variable.name] = _start(variable)
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
        return description

    @property
    def _inputs(self) -> list[Any]:
        return [v for v in self._description.modelVariables if v.causality == "input"]

    def _read(self) -> Any:
        try:
            from fmpy import read_model_description
        except ImportError:
            raise ConfigurationError(
                "FMUs need the package FMPy",
                file=str(self.file),
                remedy="pip install 'pytest-dura[fmi]'",
            ) from None
        try:
            return read_model_description(str(self.file))
        except Exception as error:  # of zipfile, of lxml, and of FMPy itself
            raise ConfigurationError(
                f"{self.file.name} is no FMU that can be read: {describe_error(error)}",
                file=str(self.file),
                key="simulator",  # of a scenario, whose place may replace this file's
                found=str(self.file) if self.file.is_file() else f"no file {self.file}",
                expected="an .fmu of FMI 2 or 3, a zip archive with modelDescription.xml",
                remedy="export it again, or correct the path that is given to Fmu",
            ) from None

    def _variable(self, name: str) -> str:
        return self._variables.get(name, name)


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


def _start(variable: Any) -> float:
    """Start value of an input as a number."""
    return float({"true": 1, "false": 0, None: 0}.get(variable.start, variable.start))
