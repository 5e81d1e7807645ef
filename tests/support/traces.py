"""Traces made by hand, and any trace at all for Hypothesis."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pytest_dura.core import Line, Recording, Scene, Tracks
from pytest_dura.evidence import Trace

TEXTS = st.text(st.characters(), max_size=8) | st.sampled_from(
    ["", "<script>alert(1)</script>", "../../x", "\ud800", "\x00\x1b[31m", "\u202e", "%s %d {0}"]
)
NAMES = st.text(st.characters(exclude_characters="\x00"), min_size=1, max_size=8)
DTYPES = st.sampled_from([np.int8, np.int16, np.int64, np.uint8, np.float32, np.float64, np.bool_])
ACCOUNTS = st.dictionaries(
    TEXTS, st.recursive(
        st.none() | st.booleans() | st.integers() | TEXTS
        | st.floats(allow_nan=False, allow_infinity=False),
        lambda inner: st.lists(inner, max_size=2) | st.dictionaries(TEXTS, inner, max_size=2),
        max_leaves=3,
    ), max_size=3,
)  # fmt: skip
ABOUT = {
    "id": "a/clear#0", "case": "a/clear", "component": "C", "seed": 7, "digest": "d" * 64,
    "validity": "valid", "termination": "time", "failure": None,
}  # fmt: skip


def simple_trace(ticks=4, **changes):
    """A car that drives to the right past a standing one, and sees a ghost from tick 2 on."""
    poses = np.full((ticks, 2, 6), np.nan, np.float32)
    poses[:, :, 4:] = 5.0, 2.0
    poses[:, 0, :4] = [(tick, 1.0, np.pi / 2, 10.0) for tick in range(ticks)]
    poses[:, 1, :4] = 20.0, 0.0, 0.0, 0.0
    ghost = np.full((ticks, 1, 6), np.nan, np.float32)
    ghost[2:] = 8.0, 3.0, 0.0, 0.0, 4.0, 1.8
    lines = (Line("edge", np.array([[-5.0, 2.0], [30.0, 2.0]], np.float32)),)
    scene = Scene(
        lines,
        Tracks(("EGO", "V1"), poses),
        Tracks(("EGO", "V1", "ghost"), np.concatenate([poses, ghost], axis=1)),
        "EGO",
    )
    many = ticks - 1
    recording = Recording(
        explanations=tuple(f"keep going {tick}" for tick in range(many)),
        reasons=("",) * (many - 1) + ("too near",),
        recoveries=("",) * (many - 1) + ("brake: too near",),
        flags={"safety_monitor": np.array([0] * (many - 1) + [2], np.int8)},
        scene=scene,
    )
    told = {
        "about": ABOUT,
        "time": np.arange(ticks) * 0.1,
        "signals": {
            "gap": np.linspace(20.0, 1.0, ticks),
            "percept.gap": np.array([np.nan, -0.0, *[3.5] * (ticks - 2)]),
        },
        "decisions": {
            "verdict": np.array([0] * (many - 1) + [2], np.int8),
            "source": np.array(["proposal"] * (many - 1) + ["recovery"], np.str_),
            "proposed": np.array(["drive"] * many, np.str_),
            "executed": np.array(["drive"] * (many - 1) + ["brake"], np.str_),
            "attempts": np.zeros(many, np.int16),
        },
        "events": [
            {"tick": 2, "time": 0.2, "kind": "alert", "subject": "V1", "detail": "", "data": {}}
        ],
        "recording": recording,
    }
    return Trace(**(told | changes))


def _floats(shape, dtype=np.float64):
    """Any floats: with NaN, infinities and zeros of both signs."""
    return arrays.arrays(dtype, shape, elements=arrays.from_dtype(np.dtype(dtype)))


@st.composite
def _tracks(draw, ticks):
    ids = draw(st.lists(NAMES, unique=True, max_size=3))
    return Tracks(tuple(ids), draw(_floats((ticks, len(ids), 6), np.float32)))


@st.composite
def _scenes(draw, ticks):
    lines = draw(st.lists(st.tuples(NAMES, st.integers(0, 3)), max_size=3))
    return Scene(
        tuple(Line(kind, draw(_floats((count, 2), np.float32))) for kind, count in lines),
        draw(_tracks(ticks)),
        draw(_tracks(ticks)),
        draw(NAMES),
    )


@st.composite
def traces(draw):
    """Any trace, also one of an episode that failed before its first tick."""
    ticks = draw(st.integers(0, 5))
    many = max(ticks - 1, 0)
    said = st.lists(TEXTS, min_size=many, max_size=many).map(tuple)
    columns = DTYPES.flatmap(lambda dtype: arrays.arrays(dtype, many)) | said.map(
        lambda texts: np.array(texts, np.str_)
    )
    events = st.fixed_dictionaries(
        {
            "tick": st.integers(0, 5), "time": st.floats(0, 1e6), "kind": TEXTS, "subject": TEXTS,
            "detail": TEXTS, "data": st.dictionaries(TEXTS, st.none() | st.integers() | TEXTS),
        }
    )  # fmt: skip
    recording = Recording(
        draw(said),
        draw(said),
        draw(said),
        draw(st.dictionaries(NAMES, arrays.arrays(np.int8, many), max_size=2)),
        draw(st.none() | _scenes(ticks)),
        draw(st.none() | TEXTS),
        draw(st.just(()) | st.lists(ACCOUNTS, min_size=many, max_size=many).map(tuple)),
    )
    return Trace(
        ABOUT | {"id": draw(TEXTS), "seed": draw(st.integers(0, 2**64 - 1))},
        draw(arrays.arrays(np.float64, ticks, elements=st.floats(0, 1e9))),
        draw(st.dictionaries(NAMES, _floats(ticks), max_size=3)),
        draw(st.dictionaries(NAMES, columns, max_size=3)),
        draw(st.lists(events, max_size=2)),
        recording,
    )


def same(left, right):
    """Whether two values are the same, bit by bit and type by type."""
    if isinstance(left, np.ndarray):
        return (
            isinstance(right, np.ndarray)
            and (left.dtype, left.shape) == (right.dtype, right.shape)
            and left.tobytes() == right.tobytes()
        )
    if isinstance(left, dict):
        return list(left) == list(right) and all(same(left[key], right[key]) for key in left)
    if isinstance(left, (list, tuple)):
        return len(left) == len(right) and all(map(same, left, right))
    if hasattr(left, "__dataclass_fields__"):
        return type(left) is type(right) and same(vars(left), vars(right))
    return type(left) is type(right) and left == right
