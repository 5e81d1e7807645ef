"""The domain's faults in the closed loop: they change the percept from their time on, nothing else.

What each does to a value is in ``tests/properties/test_driving_fault_laws.py``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from roads import run, spec_of_drive, truth_of

from pytest_dura import Episode, RoleSpec
from pytest_dura.core import Proposal
from pytest_dura.driving import Aggressive
from pytest_dura.faults import FAULT_TYPES, default_fault, fault_class

OWN = [name for name in FAULT_TYPES if FAULT_TYPES.path(name).startswith("pytest_dura.driving")]
WORLD: dict[str, Any] = {
    "ego": {"distance": 50.0, "speed": 8.0},
    "traffic": {"headway": 8.0},
    "vehicles": [{"id": "E", "arm": "east", "distance": 60.0}],
    "pedestrians": [{"id": "P1", "arm": "north", "start": 1.0}],
}
AT, TICK = 1.0, 10
SEEN: list[dict[str, Any]] = []
"""What the Generator of the latest episode was shown, tick by tick."""


class Watcher(Aggressive):
    """Drives the same whatever it is shown, and keeps it: a fault must reach it to manifest."""

    def reset(self, context: Any) -> None:
        SEEN.clear()

    def propose(self, view: Any) -> Proposal:
        SEEN.append({name: view.percept[name] for name in ("lidar", "localisation", "controls")})
        return super().propose(view)


def episode(*faults: dict[str, Any]) -> tuple[Episode, list[dict[str, Any]]]:
    found = run(
        spec_of_drive(
            WORLD,
            faults=faults,
            generator=RoleSpec("test_object_faults:Watcher"),
            duration=4.0,
        )
    )
    assert found.failure is None
    return found, [*SEEN]


@pytest.fixture(scope="module")
def clean() -> tuple[Episode, list[dict[str, Any]]]:
    return episode()


def planned(name: str, **parameters: Any) -> dict[str, Any]:
    plan = {**default_fault(name).plain(), "activation": {"at": AT}, "duration": 1.0}
    return {**plan, "parameters": {**plan["parameters"], **parameters}}


@pytest.mark.parametrize("name", OWN)
def test_the_truth_is_bit_identical_and_the_percept_is_not(name: str, clean: Any) -> None:
    attacked, shown = episode(planned(name))
    without, expected = clean
    assert truth_of(attacked) == truth_of(without)
    (record,) = attacked.faults
    late = 1 if name == "gnss-drag-off" else 0  # it is nothing at its first tick
    assert record.manifested_at == pytest.approx(AT + 0.1 * late)
    assert attacked.validity == "valid"
    channel = fault_class(name).default_target
    for tick, (one, other) in enumerate(zip(shown, expected, strict=True)):
        changed = [key for key in one if one[key] != other[key]]
        assert changed in ([], [channel]), tick
        if not TICK <= tick < TICK + 10:
            assert not changed, tick
    assert any(one[channel] != other[channel] for one, other in zip(shown, expected, strict=True))


def test_all_at_once_leave_the_truth_alone(clean: Any) -> None:
    attacked, _ = episode(*(planned(name) for name in OWN))
    assert truth_of(attacked) == truth_of(clean[0])


def test_a_jammed_receiver_shows_the_pose_of_the_tick_before(clean: Any) -> None:
    _, shown = episode(planned("gnss-jam"))
    poses = [one["localisation"] for one in shown]
    expected = [one["localisation"] for one in clean[1]]
    assert poses[:TICK] == expected[:TICK]
    assert poses[TICK : TICK + 10] == [expected[TICK - 1]] * 10
    assert poses[TICK + 10 :] == expected[TICK + 10 :]


def test_an_id_switch_is_seen_by_who_follows_objects_by_their_ids() -> None:
    attacked, _ = episode(planned("id-switch"))
    assert attacked.faults[0].detected_at == pytest.approx(AT)
    first = [event for event in attacked.events if event.kind == "alert"][:2]
    assert [event.time for event in first] == pytest.approx([AT, AT])
    assert len({event.subject for event in first}) == 2


def test_misses_are_counted_per_tick_and_object(clean: Any) -> None:
    _, shown = episode(planned("object-miss", probability=1.0))
    during = shown[TICK : TICK + 10]
    assert [len(one["lidar"]) for one in during] == [0] * 10
    _, some = episode(planned("object-miss", probability=0.5))
    sizes = [len(one["lidar"]) for one in some[TICK : TICK + 10]]
    full = [len(one["lidar"]) for one in clean[1][TICK : TICK + 10]]
    assert len({whole - size for whole, size in zip(full, sizes, strict=True)}) > 1
    assert np.all(np.array(sizes) <= full)
