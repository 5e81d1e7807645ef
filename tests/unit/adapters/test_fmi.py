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
MIXER = """
import numpy as np
import {package} as fmi

kinds, discrete = fmi.{prefix}Causality, fmi.{prefix}Variability.discrete


class Mixer(fmi.{prefix}Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time, self.flow, self.mode, self.open, self.recipe = 0.0, 0.5, 1, True, "soup"
        self.speed, self.weights, self.level, self.word = 2, np.array([1.0, 1.0]), 0.0, "on"
        continuous = fmi.{prefix}Variability.continuous
        given = {{"causality": kinds.input, "variability": discrete}}
        self.register_variable(fmi.{real}("flow", causality=kinds.input, variability=continuous))
        self.register_variable(fmi.{integer}("mode", **given))
        self.register_variable(fmi.Boolean("open", **given))
        self.register_variable(fmi.String("recipe", **given))
        self.register_variable(fmi.{real}("level", causality=kinds.output, variability=continuous))
        self.register_variable(fmi.String("word", causality=kinds.output, variability=discrete))
        self.register_variable(fmi.{long}("speed", **given))
        {more}

    def do_step(self, current_time, step_size):
        rate = {{"soup": 1.0, "stew": 10.0}}[self.recipe] * sum(self.weights)
        self.level += step_size * rate * self.open * self.speed * self.flow * self.mode
        return True
"""
MORE = """
        time = fmi.Float64("time", causality=kinds.independent, variability=continuous)
        self.register_variable(time)
        pair = [fmi.Dimension(start="2")]
        self.register_variable(fmi.Float64("weights", dimensions=pair, **given))
"""
KINDS = {
    "FMI 2": {
        "package": "pythonfmu",
        "prefix": "Fmi2",
        "real": "Real",
        "independent": "",
        "integer": "Integer",
        "long": "Integer",
        "more": "",
        "types": '<TypeDefinitions><SimpleType name="Speed"><Enumeration>'
        '<Item name="slow" value="1"/><Item name="quick" value="2"/>'
        "</Enumeration></SimpleType></TypeDefinitions>",
        "speed": (r'(name="speed"[^>]*>\s*)<Integer ', r'\1<Enumeration declaredType="Speed" '),
    },
    "FMI 3": {
        "package": "pythonfmu3",
        "prefix": "Fmi3",
        "real": "Float64",
        "independent": INDEPENDENT,
        "integer": "Int32",
        "long": "Int64",
        "more": MORE,
        "types": '<TypeDefinitions><EnumerationType name="Speed">'
        '<Item name="slow" value="1"/><Item name="quick" value="2"/>'
        "</EnumerationType></TypeDefinitions>",
        "speed": (r'<Int64 ([^>]*name="speed")', r'<Enumeration declaredType="Speed" \1'),
    },
}


def rewritten(file, target, *changes):
    """A copy of an FMU with another model description."""
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                for pattern, text in changes:
                    data, count = re.subn(pattern, text, data.decode())
                    assert count == 1, pattern
                    data = data.encode()
            new.writestr(name, data)
    return target


def built(request, tmp_path_factory, name, source):
    kind = KINDS[request.param]
    folder = tmp_path_factory.mktemp(kind["package"])
    # Slaves written in Python run in this process, where a module's name stands for one module.
    file = f"{name.lower()}_of_{kind['package']}.py"
    (folder / file).write_text(source.format(**kind))
    build = [sys.executable, "-m", kind["package"], "build", "-f", file]
    subprocess.run(build, cwd=folder, check=True, capture_output=True)
    return folder / f"{name}.fmu"


@pytest.fixture(scope="session", params=list(KINDS))
def fmu_file(request, tmp_path_factory):
    return built(request, tmp_path_factory, "Tank", SOURCE)


@pytest.fixture(scope="session", params=list(KINDS))
def mixer_file(request, tmp_path_factory):
    """An FMU with inputs of every kind."""
    file = built(request, tmp_path_factory, "Mixer", MIXER)
    types = ("<LogCategories>", f"{KINDS[request.param]['types']}<LogCategories>")
    return rewritten(file, file.with_name("Speeds.fmu"), types, KINDS[request.param]["speed"])


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
    kept = '<ModelExchange modelIdentifier="Tank"/>'
    changed = rewritten(fmu_file, tmp_path / "exchange.fmu", ("<CoSimulation[^>]*/>", kept))
    with pytest.raises(ConfigurationError, match="modelExchange"):
        Fmu(changed, [inflow()], ["level"]).check_scenario({})


def level(file, world, *inputs, **arguments):
    return Fmu(file, inputs, ["level"], **arguments).columns(world, TIME)["level"]


def test_inputs_that_no_scenario_gives_keep_their_start_values(mixer_file, capfd) -> None:
    flow = Input("flow", 0.0, 1.0)
    assert level(mixer_file, {"flow": 1.0}, flow)[-1] == pytest.approx(10.0 * 2 * 2)
    assert level(mixer_file, {})[-1] == pytest.approx(5.0 * 2 * 2)
    given = {"recipe": "stew", "mode": 3}
    assert level(mixer_file, {"flow": 1.0}, flow, start_values=given)[-1] == pytest.approx(1200.0)
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize(
    "name, high, values, rate",
    [
        ("mode", 4, [0, 4, 1, 3], 0.5 * 4),
        ("mode", 4, [0.0, 3.6, 1.2, 2.7], 0.5 * 4),
        ("open", 1, [0, 1, 1, 0], 0.5 * 4),
        ("open", 1, [0.0, 0.9, 0.51, 0.1], 0.5 * 4),
        ("speed", 2, [1, 2, 2, 1], 0.5 * 2),
        ("speed", 2, [1.3, 1.6, 2.0, 1.0], 0.5 * 2),
    ],
)
def test_a_whole_number_is_given_to_what_takes_one(mixer_file, name, high, values, rate) -> None:
    fmu = Fmu(mixer_file, [Input(name, min(values), high, pieces=4)], ["level"])
    columns = fmu.columns({name: values}, TIME)
    whole = [float(round(value)) for value in values]
    assert set(columns[name]) == set(whole)
    assert fmu.check_scenario({name: values}) == {name: whole}
    assert columns["level"][-1] == pytest.approx(2.5 * sum(whole) * rate)
    assert np.diff(columns["level"]) == pytest.approx(0.1 * rate * columns[name][:-1])


@pytest.mark.parametrize(
    "arguments, problem",
    [
        ({"inputs": [Input("recipe", 0, 1)]}, "'recipe' is not a number(.|\n)*type String"),
        ({"signals": ["level", "word"]}, "'word' is not a number(.|\n)*type String"),
        ({"inputs": [Input("open", 0, 2)]}, "'open' of type Boolean takes(.|\n)*from 0 to 1"),
        ({"inputs": [Input("mode", 0, 1.5)]}, "'mode' of type Int(eger|32) takes whole numbers"),
        ({"inputs": [Input("mode", 0, 2**40)]}, "from -2147483648 to 2147483647"),
        ({"inputs": [Input("mode", 0, 1, 2, "linear")]}, "constant in pieces"),
        ({"inputs": [Input("mode", 0, 1, nominal=0.5)]}, "takes whole numbers"),
        ({"inputs": [Input("speed", 0, 2)]}, "'speed' of type Enumeration takes(.|\n)*from 1 to 2"),
    ],
)
def test_what_no_number_gives_is_refused_with_its_type(mixer_file, arguments, problem) -> None:
    with pytest.raises(ConfigurationError, match=problem) as caught:
        Fmu(mixer_file, **{"inputs": [], "signals": ["level"], **arguments}).check_scenario({})
    assert (caught.value.file, caught.value.key) == (str(mixer_file), next(iter(arguments)))


@pytest.mark.parametrize("mixer_file", ["FMI 3"], indirect=True)
def test_an_array_is_neither_given_nor_judged(mixer_file) -> None:
    for arguments in ({"inputs": [Input("weights", 0, 1)]}, {"signals": ["weights"]}):
        with pytest.raises(ConfigurationError, match="an array of Float64"):
            Fmu(mixer_file, **{"inputs": [], "signals": ["level"], **arguments}).check_scenario({})


def test_a_file_that_fmpy_does_not_validate_runs_where_it_is_asked_for(fmu_file, tmp_path) -> None:
    change = ("<LogCategories>", '<LogCategories vendor="x">')
    odd = rewritten(fmu_file, tmp_path / "odd.fmu", change)
    with pytest.raises(ConfigurationError, match="is no FMU that can be read") as caught:
        Fmu(odd, [inflow()], ["level"]).check_scenario({})
    assert "validate=False" in str(caught.value)
    plain = Fmu(fmu_file, [inflow()], ["level"])
    taken = Fmu(odd, [inflow()], ["level"], validate=False)
    world = {"inflow": [1.0, 0.0, 0.5, 1.0]}
    assert np.array_equal(plain.columns(world, TIME)["level"], taken.columns(world, TIME)["level"])
    assert "validate" not in plain.resolve_parameters({})
    resolved = taken.resolve_parameters({})
    assert resolved["validate"] is False
    assert taken.resolve_parameters(resolved) == resolved
    assert taken(component=True, **resolved)
