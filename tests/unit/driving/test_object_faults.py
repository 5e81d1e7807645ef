"""The domain's faults in the closed loop: they change the percept from their time on, nothing else.

What each does to a value is in ``tests/properties/test_driving_fault_laws.py``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from roads import run, spec_of_drive, truth_of

from pytest_dura import Episode, RoleSpec
from pytest_dura.core import ConfigurationError, Proposal
from pytest_dura.driving import Aggressive
from pytest_dura.faults import FAULT_TYPES, default_fault, fault_class, parse_fault

OWN = [name for name in FAULT_TYPES if FAULT_TYPES.path(name).startswith("pytest_dura.driving")]
WORLD: dict[str, Any] = {
    "ego": {"distance": 50.0, "speed": 8.0},
    "traffic": {"headway": 8.0},
    "vehicles": [{"id": "E", "arm": "east", "distance": 60.0}],
    "pedestrians": [{"id": "P1", "arm": "north", "start": 1.0}],
}
AT, TICK = 1.0, 10
IDLE: dict[str, dict[str, Any]] = {
    "trajectory-spoof": {"magnitude": 0.0},
    "object-miss": {"probability": 0.0},
    "position-noise": {"sigma": 0.0},
    "range-cut": {"reach": 80.0},
    "class-change": {"probability": 0.0},
    "moved-obstacle": {"dx": 0.0, "dy": 0.0},
    "gnss-jump": {},
    "gnss-drag-off": {"rate": 0.0},
    "prompt-text": {"text": ""},
}
"""Parameters of no magnitude; ghosts, id switches and jammers have no such thing."""
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


@pytest.mark.parametrize("name", sorted(IDLE))
def test_a_fault_of_no_magnitude_is_none_and_counts_as_not_manifested(
    name: str, clean: Any
) -> None:
    idle, shown = episode({**planned(name), "parameters": IDLE[name]})
    without, expected = clean
    assert shown == expected
    for signal, column in without.signals.items():
        assert column.tobytes() == idle.signals[signal].tobytes()
    (record,) = idle.faults
    assert record.activated_at is not None
    assert not record.success
    assert idle.invalid_reason == f"never manifested: {name}"


def test_all_at_once_leave_the_truth_alone(clean: Any) -> None:
    attacked, _ = episode(*(planned(name) for name in OWN))
    assert truth_of(attacked) == truth_of(clean[0])


def test_another_fault_shifts_no_draws(clean: Any) -> None:
    noise, miss = planned("position-noise"), planned("object-miss")
    _, alone = episode(noise)
    _, both = episode(noise, miss)
    kept = [
        (body, other["lidar"].get(body.id))
        for one, other in zip(alone, both, strict=True)
        for body in one["lidar"]
    ]
    assert any(other is None for _, other in kept), "some are missed"
    assert all(other in (None, body) for body, other in kept), "the others scatter as before"
    _, jumped = episode(noise, planned("gnss-jump"))
    assert [one["lidar"] for one in jumped] == [one["lidar"] for one in alone]


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


@pytest.mark.parametrize(
    "name, parameters, key",
    [
        ("object-miss", {"probability": 1.5}, "parameters.probability"),
        ("object-miss", {"nearest": 0}, "parameters.nearest"),
        ("position-noise", {"sigma": -0.1}, "parameters.sigma"),
        ("range-cut", {"reach": float("inf")}, "parameters.reach"),
        ("class-change", {"becomes": "lorry"}, "parameters.becomes"),
        ("id-switch", {"ids": ["V1"]}, "parameters"),
        ("id-switch", {"ids": ["V1", "V1"]}, "parameters"),
        ("moved-obstacle", {"dx": float("nan")}, "parameters.dx"),
        ("moved-obstacle", {"frame": "world"}, "parameters.frame"),
        ("gnss-jump", {"up": 3.0}, "parameters.up"),
        ("gnss-drag-off", {"rate": -1.0}, "parameters.rate"),
        ("gnss-drag-off", {"direction": "up"}, "parameters.direction"),
        ("gnss-jam", {"power": 3.0}, "parameters.power"),
        ("prompt-text", {"ahead": 0.0}, "parameters.ahead"),
        ("prompt-text", {"text": 3}, "parameters.text"),
        ("ghost-obstacle", {"speed": -1.0}, "parameters.speed"),
        ("trajectory-spoof", {"velocity": [1.0]}, "parameters.velocity"),
    ],
)
def test_a_value_out_of_range_is_refused_at_its_key(
    name: str, parameters: dict[str, Any], key: str
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_fault({"type": name, "activation": {"at": 1.0}, "parameters": parameters})
    assert str(caught.value.key).startswith(key)
