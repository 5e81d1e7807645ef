"""An episode comes back from bytes as it was; whatever else the bytes are, they are refused."""

from __future__ import annotations

import hashlib
import json
import pickle
import tracemalloc
import zlib
from dataclasses import replace

import numpy as np
import pytest
from handmade import SPEC, handmade
from hypothesis import given, settings
from hypothesis import strategies as st
from roads import run, spec_of_drive
from thermostat import Bias, Controller, HeatMonitor, JumpWatch, Meter, SwitchOff, Thermostat

from pytest_dura import DependabilityMetrics, Fault, FaultRecord
from pytest_dura.core import EpisodeSpec, Event, Orchestrator, RoleSpec, Tally, Termination
from pytest_dura.evidence import episode_record
from pytest_dura.execution import missing_episode, pack
from pytest_dura.execution.codec import DamagedEpisodeError, unpack
from pytest_dura.requirements import JudgedEpisode
from pytest_dura.requirements.episode_verdicts import EPISODE_STATUSES, CheckVerdict

SETTINGS = settings(derandomize=True, deadline=None, max_examples=60, database=None)
GHOST = {"type": "ghost-obstacle", "activation": {"at": 1.0}, "duration": 2.0}
SIMULATOR = RoleSpec("thermostat:Thermostat")
FAULT = Fault("bias", "bias", "thermometer", {"at": 0.3}, 0.4)


def fresh(episode):
    """The same without the digest that was taken before."""
    return replace(episode)


def check_equal(found, episode):
    assert fresh(found).digest == found.digest == fresh(episode).digest
    left, right = (json.dumps(episode_record(one, planned=True)) for one in (found, episode))
    assert left == right
    assert found.metrics == episode.metrics
    assert found.faults == episode.faults
    assert found.metrics.faults == {one.id: one for one in episode.faults}
    assert found.timeouts == episode.timeouts
    assert [one.wall_clock for one in found.events] == [one.wall_clock for one in episode.events]
    assert repr(plain(found.recording)) == repr(plain(episode.recording))
    for one in (found.time, *found.signals.values(), *found.decisions.values()):
        assert not one.flags.writeable
    for one in () if found.recording is None else found.recording.flags.values():
        assert one.flags.writeable


def plain(value):
    """Nested dicts of whatever a recording is made of, arrays with their kind and bytes."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, dict):
        return [(name, plain(one)) for name, one in sorted(value.items())]
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    return value


def room(**scenario):
    """An episode of the heated room with all six roles, a fault and what a viewer shows."""
    spec = EpisodeSpec(
        "room", 3, 7, SIMULATOR, {"generator": RoleSpec("a:Planner")},
        scenario=scenario, faults=(FAULT,), termination=Termination(2.0),
    )  # fmt: skip
    roles = {
        "generator": Controller(), "safety_monitor": HeatMonitor(), "fault_injector": Bias(),
        "security_assessor": JumpWatch(), "performance_oracle": Meter(),
        "recovery_planner": SwitchOff(),
    }  # fmt: skip
    metrics = {"warmest": lambda episode: float(episode.signal("temperature").max())}
    return Orchestrator(Thermostat(), roles, metrics=metrics, recorded=True).run(spec)


numbers = st.floats(width=64)
names = st.text(min_size=1, max_size=6).filter(lambda text: text.isprintable())
whole = st.integers(-(2**70), 2**70)
plain_data = st.recursive(
    st.none() | st.booleans() | whole | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names, inner, max_size=3),
    max_leaves=6,
)
events = st.builds(
    Event, st.integers(0, 9), st.floats(0, 9), names, names, st.text(max_size=9),
    st.dictionaries(names, plain_data, max_size=2), st.booleans(),
)  # fmt: skip
times = st.none() | st.floats(0, 100)
faults = st.builds(
    FaultRecord, names, names, planned_at=times, activated_at=times, manifested_at=times,
    detected_by=st.none() | names, by_chance=st.booleans(), activations=st.integers(0, 5),
)  # fmt: skip
series = st.dictionaries(
    names, st.tuples(st.lists(st.integers(0, 99)), st.lists(numbers | whole)), max_size=2
)


@st.composite
def episodes(draw):
    ticks = draw(st.integers(0, 12))
    columns = st.lists(numbers, min_size=ticks, max_size=ticks)
    made = handmade(
        ticks,
        faults=tuple(draw(st.lists(faults, max_size=2, unique_by=lambda one: one.id))),
        failure=draw(st.none() | st.just("infrastructure: simulator at tick 0: \ud800 gone")),
        metrics=DependabilityMetrics(
            performance=draw(series), robustness=draw(series), wall_clock=draw(series),
            tallies=draw(st.dictionaries(names, st.builds(Tally, *[st.integers(0, 9)] * 4))),
            user=draw(st.dictionaries(names, numbers, max_size=2)),
        ),
    )  # fmt: skip
    made.signals = draw(st.dictionaries(names, columns.map(np.array), max_size=3))
    made.signals = {name: np.asarray(one, float) for name, one in made.signals.items()}
    words = st.lists(st.text(max_size=3), min_size=ticks, max_size=ticks)
    made.decisions = {
        "verdict": np.zeros(ticks, np.int8), "proposed": np.array(draw(words), np.str_),
    }  # fmt: skip
    made.events = tuple(draw(st.lists(events, max_size=3)))
    made.timeouts = tuple(draw(st.lists(st.integers(-1, 9), max_size=3)))
    made.metrics.faults = {one.id: one for one in made.faults}
    return made


@SETTINGS
@given(episodes())
def test_any_episode_comes_back_as_it_was(episode):
    found = unpack(pack(episode), episode.spec)
    assert fresh(found).digest == found.digest == fresh(episode).digest
    for name, column in {**episode.signals, **episode.decisions}.items():
        again = {**found.signals, **found.decisions}[name]
        assert (again.dtype, again.tobytes()) == (column.dtype, column.tobytes())
    assert repr(found.metrics) == repr(episode.metrics)
    assert (found.events, found.faults) == (episode.events, episode.faults)
    assert (found.failure, found.timeouts) == (episode.failure, episode.timeouts)


@pytest.mark.parametrize(
    "made",
    [
        room,
        lambda: room(world={"fuse": 16.0}),
        lambda: run(spec_of_drive({}, faults=[GHOST], duration=3.0)),
        lambda: missing_episode(
            replace(SPEC, simulator=SIMULATOR, faults=(FAULT,)), "its process died"
        ),
    ],
    ids=["room", "critical", "driving", "missing"],
)
def test_real_episodes_come_back_as_they_were(made):
    episode = made()
    check_equal(unpack(pack(episode), episode.spec), episode)


EPISODE = room()
PACKED = pack(EPISODE)


finite = st.none() | st.floats(allow_nan=False, allow_infinity=False)
check_verdicts = st.builds(
    CheckVerdict, st.sampled_from(EPISODE_STATUSES), finite, finite, st.text(), st.booleans()
)


@SETTINGS
@given(st.dictionaries(st.text(), check_verdicts, max_size=4))
def test_what_checks_say_of_an_episode_comes_back_with_it(said):
    episode = JudgedEpisode.of(EPISODE)
    episode.check_verdicts.update(said)
    found = unpack(pack(episode), episode.spec)
    assert found.check_verdicts == said
    assert found.digest == EPISODE.digest


def sealed(inner):
    return hashlib.sha256(inner).digest() + inner


def folded(head, rest=b""):
    text = head if isinstance(head, bytes) else json.dumps(head).encode()
    return sealed(zlib.compress(b"%d\n" % len(text) + text + rest))


def head_of(packed=PACKED):
    size, _, rest = zlib.decompress(packed[32:]).partition(b"\n")
    return json.loads(rest[: int(size)]), rest[int(size) :]


@SETTINGS
@given(st.integers(0, len(PACKED) - 1), st.integers(1, 255))
def test_a_changed_byte_is_found(place, change):
    data = bytearray(PACKED)
    data[place] ^= change
    with pytest.raises(DamagedEpisodeError):
        unpack(bytes(data), EPISODE.spec)


@SETTINGS
@given(st.integers(0, len(PACKED) - 1))
def test_a_torn_file_is_found(size):
    with pytest.raises(DamagedEpisodeError):
        unpack(PACKED[:size], EPISODE.spec)


@SETTINGS
@given(st.binary(max_size=200))
def test_bytes_of_anybody_are_refused(data):
    for one in (data, sealed(data), sealed(zlib.compress(data)), folded(data)):
        with pytest.raises(DamagedEpisodeError):
            unpack(one, EPISODE.spec)


PATHS = sorted(head_of()[0])


@SETTINGS
@given(st.sampled_from(PATHS), plain_data)
def test_a_head_of_somebody_else_is_an_episode_or_refused(key, value):
    """With a seal that fits: nothing but an episode or the one error comes of it."""
    head, rest = head_of()
    head[key] = value
    try:
        found = unpack(folded(head, rest), EPISODE.spec)
    except DamagedEpisodeError:
        return
    assert found.validity in ("valid", "invalid", "missing")
    assert isinstance(found.digest, str)


@pytest.mark.parametrize(
    "columns",
    [
        [["|O", [1]]], [["V8", [1]]], [["i4,i4", [1]]], [[{"names": ["a"]}, [1]]], [[None, [1]]],
        [["(1,)<f8", [1]]], [["<f8", [-1]]], [["<f8", [True]]], [["<f8", [1.0]]],
        [["<f8", [2**62]]], [["<f8", [0] * 80]], [["<U999999999", [1]]], [["<M8", [1]]], "x",
    ],
)  # fmt: skip
def test_columns_of_other_kinds_are_refused(columns):
    head, _ = head_of()
    with pytest.raises(DamagedEpisodeError):
        unpack(folded({**head, "columns": columns}, b"12345678"), EPISODE.spec)


def test_what_would_unfold_without_end_is_refused_in_bounded_memory(monkeypatch):
    monkeypatch.setattr("pytest_dura.execution.codec.MAX_UNPACKED_BYTES", 1 << 20)
    bomb = sealed(zlib.compress(b"2\n{}" + bytes(64 << 20), 9))
    assert len(bomb) < 100_000
    tracemalloc.start()
    try:
        with pytest.raises(DamagedEpisodeError):
            unpack(bomb, EPISODE.spec)
        assert tracemalloc.get_traced_memory()[1] < 8 << 20
    finally:
        tracemalloc.stop()
    monkeypatch.setattr("pytest_dura.execution.codec.MAX_UNPACKED_BYTES", 100)
    with pytest.raises(ValueError, match="at most 100 are read"):
        pack(EPISODE)


def test_nobodys_code_is_run():
    """What pickle would do with these bytes, this does not."""

    class Runs:
        def __reduce__(self):
            return (pytest.fail, ("it was run",))

    evil = pickle.dumps(Runs())
    for one in (evil, sealed(evil), sealed(zlib.compress(evil)), folded(evil)):
        with pytest.raises(DamagedEpisodeError):
            unpack(one, EPISODE.spec)


def test_the_episode_of_another_spec_is_refused():
    with pytest.raises(DamagedEpisodeError, match="another spec"):
        unpack(PACKED, replace(EPISODE.spec, seed=8))


def test_an_object_of_the_users_is_told_and_not_guessed_at():
    episode = handmade(2)
    episode.events = (Event(0, 0.0, "kind", "subject", data={"it": object()}),)
    with pytest.raises(TypeError, match="object is not plain data"):
        pack(episode)
