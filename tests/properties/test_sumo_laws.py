"""Laws of driving's junction with SUMO's drivers: what SUMO is handed. Skipped without libsumo."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

libsumo = pytest.importorskip("libsumo")

from pytest_dura.adapters.sumo import SumoSimulator  # noqa: E402 - it is of use only with the library


@pytest.fixture
def simulator() -> Iterator[SumoSimulator]:
    made = SumoSimulator()
    yield made
    made.close()


def test_sumo_gets_another_seed_for_each_seed_of_an_episode(simulator: SumoSimulator) -> None:
    """The types of drivers draw no number so far: SUMO itself is asked for its seed."""

    def seed_of_sumo(seed: int) -> str:
        simulator.reset({"world": {}, "duration": 5.0}, seed)
        return str(libsumo.simulation.getOption("seed"))

    seeds = [0, 1, 2, 3, 2**31, 2**53 - 1]
    known = [seed_of_sumo(seed) for seed in seeds]
    assert len(set(known)) == len(seeds)
    assert [seed_of_sumo(seed) for seed in reversed(seeds)] == known[::-1]


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("arm", ["south", "east", "north", "west"])
def test_a_pedestrian_faces_the_way_it_walks_in_sumo_too(
    simulator: SumoSimulator, arm: str, side: str
) -> None:
    person = {"id": "P1", "arm": arm, "side": side, "offset": 8.0, "start": 0.0, "speed": 1.3}
    world = {"ego": {"distance": 60.0, "speed": 0.0}, "pedestrians": [person]}
    simulator.reset({"world": world, "duration": 10.0}, 1)
    places, angles = [], []
    for _ in range(8):
        simulator.step(simulator.check_action("wait"))
        places.append(libsumo.person.getPosition("P1"))
        angles.append(libsumo.person.getAngle("P1"))
    (x, y), (later_x, later_y) = places[2], places[-1]
    assert math.hypot(later_x - x, later_y - y) > 0.5
    towards = math.degrees(math.atan2(later_x - x, later_y - y))  # SUMO's: clockwise from the north
    for angle in angles[2:]:
        assert abs((angle - towards + 180.0) % 360.0 - 180.0) < 1.0
