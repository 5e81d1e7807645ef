"""Recorded logs: what is not known of them is never taken for known, whatever the formula is."""

from __future__ import annotations

from collections import Counter
from itertools import product

import numpy as np
import pytest
from formulas import formulas
from handmade import handmade
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura import read_log
from pytest_dura.evidence.mcap import write_trace
from pytest_dura.evidence.traces import Trace
from pytest_dura.logs.resampling import places, resample
from pytest_dura.requirements import (
    Boolean,
    Comparison,
    Constant,
    Formula,
    Not,
    Signal,
    Temporal,
    TemporalPair,
    node_text,
)
from pytest_dura.requirements.episode_verdicts import JudgedEpisode, evaluate_episode
from pytest_dura.requirements.stl.evaluation import evaluate

NAMES = ("a", "b", "c")


def test_judging_our_own_trace_is_judging_the_episode(tmp_path) -> None:
    random = np.random.default_rng(3)
    columns = {name: random.integers(-3, 4, 7) + 0.25 * random.random(7) for name in NAMES}
    episode = handmade(7, **columns)
    file = tmp_path / "trace.mcap"
    write_trace(file, Trace.of(JudgedEpisode.of(episode)))
    log = read_log(file)
    assert log.time.tolist() == episode.time.tolist()
    assert sorted(log.signals) == sorted(NAMES)
    statuses: Counter[str] = Counter()

    @settings(max_examples=1000, derandomize=True, deadline=None)
    @given(formulas(NAMES, time_step=0.1))
    def law(formula) -> None:
        ours, _ = evaluate_episode(formula, episode)
        again, _ = evaluate_episode(formula, log)
        assert again == ours
        statuses[ours.status] += 1

    law()
    assert len(statuses) == 3
    assert min(statuses["satisfied"], statuses["violated"]) > 300, statuses


def monotone(names):
    """Formulas in which each signal stands once, so that its bounds are those of the formula."""
    leaves = [
        st.builds(
            Comparison,
            st.sampled_from([">", ">=", "<", "<="]),
            st.just(Signal(name)),
            st.builds(Constant, st.integers(-3, 3).map(float)),
        )
        for name in names
    ]
    window = st.none()

    def over(node):
        unary = st.sampled_from(["always", "eventually", "once", "historically"])
        return st.one_of(node, st.builds(Temporal, unary, node, window), st.builds(Not, node))

    def join(left, right):
        both = st.sampled_from(["and", "or", "implies"])
        pairs = st.sampled_from(["until", "since"])
        return over(
            st.one_of(
                st.builds(Boolean, both, left, right),
                st.builds(TemporalPair, pairs, left, right, window),
            )
        )

    root = join(over(leaves[0]), join(over(leaves[1]), over(leaves[2])))
    return root.map(lambda node: Formula(node, node_text(node)))


SIZE = 8
KINDS = ["known", "known", "bounded", "unknown"]
cells = st.lists(st.sampled_from(KINDS), min_size=SIZE, max_size=SIZE)
FAR = 1e6


def test_the_interval_is_that_of_the_worst_and_the_best_completion() -> None:
    statuses: Counter[str] = Counter()

    @settings(max_examples=400, derandomize=True, deadline=None)
    @given(monotone(NAMES), st.lists(cells, min_size=3, max_size=3), st.integers(0, 2**31))
    def law(formula, kinds, seed) -> None:
        random = np.random.default_rng(seed)
        least, greatest = {}, {}
        columns = {}
        for name, kind in zip(NAMES, kinds, strict=True):
            value = random.integers(-3, 4, SIZE).astype(float)
            width = np.array([{"known": 0.0, "bounded": 2.0, "unknown": FAR}[k] for k in kind])
            least[name], greatest[name] = value - width, value + width
            unknown = width == FAR
            columns[name] = np.where(unknown, np.nan, value)
            if width.any():
                columns[f"least.{name}"] = np.where(unknown, np.nan, least[name])
                columns[f"greatest.{name}"] = np.where(unknown, np.nan, greatest[name])
        time = np.arange(SIZE) * 1.0
        said = evaluate(formula, time, columns)
        corners = [
            evaluate(formula, time, dict(zip(NAMES, chosen, strict=True)))
            for chosen in product(*((least[name], greatest[name]) for name in NAMES))
        ]
        inner = [
            evaluate(
                formula,
                time,
                {name: random.uniform(least[name], greatest[name]) for name in NAMES},
            )
            for _ in range(5)
        ]
        margins = [each.margin for each in corners]
        for mine, reached in ((said.lower, min(margins)), (said.upper, max(margins))):
            if np.isinf(mine):
                assert abs(reached) > FAR / 2
            else:
                assert mine == pytest.approx(reached)
        reached = {each.status for each in corners}
        assert said.status == (reached.pop() if len(reached) == 1 else "undecided")
        for each in inner:
            assert said.lower <= each.margin <= said.upper
            assert said.status in ("undecided", each.status)
        if said.status == "violated":
            assert all(each.time <= said.time for each in corners if each.time is not None)
        statuses[said.status] += 1

    law()
    assert min(statuses.values()) > 15, statuses


def test_no_completion_lies_outside_whatever_the_formula_is() -> None:
    statuses: Counter[str] = Counter()

    @settings(max_examples=1200, derandomize=True, deadline=None)
    @given(formulas(NAMES), cells, st.integers(0, 2**31))
    def law(formula, kinds, seed) -> None:
        random = np.random.default_rng(seed)
        known = {name: random.integers(-3, 4, SIZE).astype(float) for name in NAMES}
        kind = np.array(kinds)
        width = np.where(kind == "known", 0.0, np.where(kind == "bounded", 1.0, 30.0))
        unknown = kind == "unknown"
        a = known["a"]
        columns = {
            **known,
            "a": np.where(unknown, np.nan, a),
            "least.a": np.where(unknown, np.nan, a - width),
            "greatest.a": np.where(unknown, np.nan, a + width),
        }
        time = np.arange(SIZE) * 1.0
        said = evaluate(formula, time, columns)
        for _ in range(6):
            completed = known | {"a": random.uniform(a - width, a + width)}
            each = evaluate(formula, time, completed)
            assert said.lower <= each.upper + 1e-9
            assert each.lower - 1e-9 <= said.upper
            assert said.status in ("undecided", each.status)
            if said.status == "violated":
                assert each.time <= said.time
        statuses[said.status] += 1

    law()
    assert min(statuses.values()) > 50, statuses


def test_no_recorded_value_lies_outside_the_bounds_of_its_sample() -> None:
    ways: Counter[str] = Counter()

    @settings(max_examples=300, derandomize=True, deadline=None)
    @given(
        st.sampled_from(["hold", "linear", "nearest"]),
        st.lists(st.integers(1, 40), min_size=1, max_size=30),
        st.sampled_from([0.1, 0.25, 1.0]),
        st.integers(0, 2**31),
    )
    def law(method, steps, step, seed) -> None:
        time = np.cumsum([0, *steps]) * 0.05
        values = np.random.default_rng(seed).normal(size=len(time))
        place = places(time, step, method)
        made = resample(time, values, int(place[-1]) + 1, step, method=method, longest_gap=0.5)
        assert (made.least[place] <= values).all()
        assert (values <= made.greatest[place]).all()
        grid = np.arange(len(made.values)) * step
        distance = np.abs(grid[:, None] - time[None, :]).min(axis=1)
        assert np.isnan(made.values[distance > 0.5 + step]).all()
        ways[f"{method} {made.is_certain} {bool(np.isnan(made.values).any())}"] += 1

    law()
    assert len(ways) >= 9, ways
