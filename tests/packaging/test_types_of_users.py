"""What a type checker finds in a user's project, with type parameters and without."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from suites import REPOSITORY

from pytest_dura.driving import MEASURES, DrivingEpisode
from pytest_dura.new_project import write_project

TYPED = """
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypedDict

import numpy as np
from numpy.typing import NDArray

from pytest_dura import Generator, GeneratorView, JudgedEpisode, Proposal, Runner, Simulator, Tick
from pytest_dura.driving import DrivingEpisode


class Pump(NamedTuple):
    inflow: float


class Gauge(NamedTuple):
    level: float


class Truth(TypedDict):
    level: float


class Readings(TypedDict):
    gauge: Gauge


class Tank(Simulator[Truth, Pump]):
    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick[Truth]:
        return Tick(0, 0.0, {"level": 1.0}, {"gauge": Gauge(1.0)})

    def step(self, action: Pump) -> Tick[Truth]:
        return Tick(1, action.inflow, {"level": 1.0}, {"gauge": Gauge(1.0)})

    def signals(self, ticks: Sequence[Tick[Truth]]) -> dict[str, NDArray[np.float64]]:
        return {"level": np.array([tick.truth["level"] for tick in ticks])}

    def fallback_action(self) -> Pump:
        return Pump(0.0)


class Controller(Generator[Readings, Pump]):
    def propose(self, view: GeneratorView[Readings]) -> Proposal[Pump]:
        return Proposal(Pump(2.0 - view.percept["gauge"].level))


def test_tank(episode: JudgedEpisode) -> None:
    assert episode.robustness("always (level < 2)") > 0


def test_crossing(episode: DrivingEpisode) -> None:
    assert not episode.collided


Runner.of(generator=Controller, base_seed=1).run("tank/filling").margins("always (level < 2)")
"""
BARE = """
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura import Generator, GeneratorView, Proposal, Simulator, Tick


class Tank(Simulator):
    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        return Tick(0, 0.0, {"level": 1.0}, {"gauge": 1.0})

    def step(self, action: float) -> Tick:
        return Tick(1, action, {"level": 1.0}, {"gauge": 1.0})

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        return {"level": np.array([tick.truth["level"] for tick in ticks])}

    def fallback_action(self) -> float:
        return 0.0


class Controller(Generator):
    def propose(self, view: GeneratorView) -> Proposal:
        return Proposal(2.0 - view.percept["gauge"])
"""
SLIPS = {
    '["gauge"].level)': ('["gauge"].levle)', '"Gauge" has no attribute "levle"'),
    'tick.truth["level"]': ('tick.truth["levle"]', 'TypedDict "Truth" has no key "levle"'),
    'percept["gauge"]': ('percept["gage"]', 'TypedDict "Readings" has no key "gage"'),
    "Proposal(Pump(2.0": ("Proposal(float(2.0", 'expected "Pump"'),
    "action.inflow": ("action.outflow", '"Pump" has no attribute "outflow"'),
    "episode.collided": ("episode.colided", '"DrivingEpisode" has no attribute "colided"'),
    "episode.robustness": ("episode.robustnes", '"JudgedEpisode" has no attribute "robustnes"'),
    "base_seed=1": ("base_sed=1", 'Unexpected keyword argument "base_sed"'),
    ".margins(": (".margin(", '"JudgedEpisode" has no attribute "margin"'),
}
"""What is written, what may stand in its place, and what mypy says of that."""


@pytest.fixture(scope="module")
def checked(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """The errors of each file, by its name: all are checked at once."""
    folder = tmp_path_factory.mktemp("typed")
    made = write_project(folder, own_domain=True)
    files = {file.stem: (folder / file).read_text() for file in made if file.suffix == ".py"}
    files |= {"typed": TYPED, "bare": BARE}
    for number, (written, (slip, _)) in enumerate(SLIPS.items()):
        assert TYPED.count(written) >= 1
        files[f"slip_{number}"] = TYPED.replace(written, slip)
    for name, text in files.items():
        Path(folder, f"{name}.py").write_text(text)
    names = [f"{name}.py" for name in files]
    settings = ["--strict", "--config-file", "", "--ignore-missing-imports", "--cache-dir"]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *settings, str(REPOSITORY / ".mypy_cache"), *names],
        cwd=folder, capture_output=True, text=True, check=False, timeout=600,
        env={**os.environ, "MYPYPATH": str(REPOSITORY)},
    )  # fmt: skip
    assert not done.stderr, done.stderr
    return {
        name: [line for line in done.stdout.splitlines() if line.startswith(f"{name}.py:")]
        for name in files
    }


def test_a_project_with_and_without_type_parameters_has_no_errors(checked) -> None:
    assert (checked["typed"], checked["bare"]) == ([], [])


def test_a_new_project_of_a_system_of_one_s_own_has_no_errors(checked) -> None:
    new = {name: checked[name] for name in ("tank", "controller", "conftest", "test_tank")}
    assert not any(new.values()), new


@pytest.mark.parametrize("number", range(len(SLIPS)))
def test_a_misspelt_name_is_found(checked, number) -> None:
    _, said = [*SLIPS.values()][number]
    assert any(said in line for line in checked[f"slip_{number}"]), checked[f"slip_{number}"]


def test_the_episode_of_driving_has_the_measures_of_driving() -> None:
    assert [measure.name for measure in MEASURES] == [*vars(DrivingEpisode)["__annotations__"]]
