"""FMUs as black boxes; those of FMI 2 and 3 that are run here are built by the tests."""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from pytest_dura import ConfigurationError, Input
from pytest_dura.adapters.fmi import Fmu

TIME = np.arange(101) * 0.1
SOURCE = """
from {package} import {prefix}Causality, {prefix}Slave, {prefix}Variability, {real}

class Tank(Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time, self.inflow, self.leak, self.level, self.drain = 0.0, 0.0, 0.125, 1.0, 0.5
        continuous = {prefix}Variability.continuous
        {independent}
        kinds = {prefix}Causality
        tunable = {prefix}Variability.tunable
        self.register_variable({real}("inflow", causality=kinds.input, variability=continuous))
        self.register_variable({real}("leak", causality=kinds.input, variability=continuous))
        self.register_variable({real}("drain", causality=kinds.parameter, variability=tunable))
        self.register_variable({real}("level", causality=kinds.output, variability=continuous))

    def do_step(self, current_time, step_size):
        if self.inflow > 4.0:
            raise RuntimeError("the pump has tripped")
        if self.inflow > 2.0:
            self.level = float("nan")
        change = self.inflow - self.leak - self.drain * max(self.level, 0.0) ** 0.5
        self.level += step_size * change
        return True
""".replace("class Tank(Slave)", "class Tank({prefix}Slave)")
INDEPENDENT = (
    'self.register_variable(Float64("time", causality=Fmi3Causality.independent,'
    " variability=continuous))"
)
KINDS = {
    "FMI 2": {"package": "pythonfmu", "prefix": "Fmi2", "real": "Real", "independent": ""},
    "FMI 3": {
        "package": "pythonfmu3",
        "prefix": "Fmi3",
        "real": "Float64",
        "independent": INDEPENDENT,
    },
}


@pytest.fixture(scope="session", params=list(KINDS))
def fmu_file(request, tmp_path_factory):
    kind = KINDS[request.param]
    folder = tmp_path_factory.mktemp(kind["package"])
    # Slaves written in Python run in this process, where a module's name stands for one module.
    source = f"tank_of_{kind['package']}.py"
    (folder / source).write_text(SOURCE.format(**kind))
    build = [sys.executable, "-m", kind["package"], "build", "-f", source]
    subprocess.run(build, cwd=folder, check=True, capture_output=True)
    return folder / "Tank.fmu"


def inflow(high=1.0, **arguments):
    return Input("inflow", 0.0, high, pieces=4, **arguments)


def stepped(values, drain):
    """The level by the equations of the FMU, which steps from sample to sample."""
    levels = [1.0]
    for value in values[:-1]:
        levels.append(levels[-1] + 0.1 * (value - 0.125 - drain * max(levels[-1], 0.0) ** 0.5))
    return levels


@pytest.mark.parametrize("interpolation", ["constant", "linear"])
def test_its_signals_are_those_of_its_equations(fmu_file, interpolation) -> None:
    given = inflow(interpolation=interpolation)
    fmu = Fmu(fmu_file, [given], ["level"], start_values={"drain": 0.25})
    columns = fmu.columns({"inflow": [1.0, 0.0, 0.5, 1.0]}, TIME)
    assert columns["inflow"][40] == pytest.approx(0.0 if interpolation == "constant" else 0.1)
    assert columns["level"] == pytest.approx(stepped(columns["inflow"], 0.25), abs=1e-12)


def test_equal_runs_are_equal_to_the_last_bit(fmu_file) -> None:
    fmu = Fmu(fmu_file, [inflow()], ["level"])
    first, other, again = (fmu.columns({"inflow": [u] * 4}, TIME)["level"] for u in (1.0, 0.0, 1.0))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_its_variables_may_have_other_names(fmu_file) -> None:
    fmu = Fmu(fmu_file, [Input("u", 0, 1)], ["h"], variables={"u": "inflow", "h": "level"})
    columns = fmu.columns({"u": 1.0}, TIME)
    assert columns["h"] == pytest.approx(stepped([1.0] * 101, 0.5), abs=1e-12)


@pytest.mark.parametrize(
    "flow, problem",
    [(3.0, "returned nan for 'level'"), (5.0, "Tank.fmu failed: .*the pump has tripped")],
)
def test_a_run_that_fails_says_why_and_the_next_one_runs(fmu_file, flow, problem) -> None:
    fmu = Fmu(fmu_file, [inflow(5.0)], ["level"])
    with pytest.raises((RuntimeError, ValueError), match=problem):
        fmu.columns({"inflow": [flow] * 4}, TIME)
    assert fmu.columns({"inflow": [1.0] * 4}, TIME)["level"][-1] > 1.0


def test_after_a_fatal_error_nothing_of_it_is_called(fmu_file, monkeypatch) -> None:
    """Not even to free it: that crashes the process, sometimes at its exit."""
    freed = []
    for kind in (FMU2Slave, FMU3Slave):
        free = kind.freeInstance

        def counted(instance, free=free):
            freed.append(instance)
            free(instance)

        monkeypatch.setattr(kind, "freeInstance", counted)
    fmu = Fmu(fmu_file, [inflow(5.0)], ["level"])
    with pytest.raises(RuntimeError, match="status 4"):
        fmu.columns({"inflow": [5.0] * 4}, TIME)
    assert not freed
    fmu.columns({"inflow": [1.0] * 4}, TIME)
    assert len(freed) == 1


@pytest.mark.parametrize(
    "arguments, problem",
    [
        ({"inputs": [Input("inflwo", 0, 1)]}, "no input 'inflwo'"),
        ({"inputs": [Input("drain", 0, 1)]}, "no input 'drain'"),
        ({"signals": ["height"]}, "no variable 'height'"),
        ({"start_values": {"area": 1.0}}, "no variable 'area'"),
    ],
)
def test_what_the_fmu_does_not_have_is_refused(fmu_file, arguments, problem) -> None:
    given = {"inputs": [inflow()], "signals": ["level"], **arguments}
    with pytest.raises(ConfigurationError, match=problem) as caught:
        Fmu(fmu_file, **given).check_scenario({})
    assert caught.value.file == str(fmu_file)


def test_what_is_no_fmu_is_refused(tmp_path) -> None:
    (tmp_path / "text.fmu").write_text("no archive")
    with zipfile.ZipFile(tmp_path / "empty.fmu", "w") as archive:
        archive.writestr("readme.txt", "")
    for name in ("text.fmu", "empty.fmu", "missing.fmu"):
        with pytest.raises(
            ConfigurationError, match=f"{name} is no FMU that can be read"
        ) as caught:
            Fmu(tmp_path / name, [inflow()], ["level"]).check_scenario({})
        assert name in str(caught.value.found)
        assert caught.value.key == "simulator"  # the place is that of a scenario, where it has one


def test_only_co_simulation_is_run(fmu_file, tmp_path) -> None:
    changed = tmp_path / "exchange.fmu"
    with zipfile.ZipFile(fmu_file) as old, zipfile.ZipFile(changed, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                kept = b'<ModelExchange modelIdentifier="Tank"/>'
                data = re.sub(rb"<CoSimulation[^>]*/>", kept, data)
            new.writestr(name, data)
    with pytest.raises(ConfigurationError, match="modelExchange"):
        Fmu(changed, [inflow()], ["level"]).check_scenario({})
