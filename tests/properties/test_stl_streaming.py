"""A formula judged block by block: the evaluation is that of the whole trace, whatever it is."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict

import numpy as np
import pytest
from formulas import nodes
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura import ConfigurationError
from pytest_dura.requirements import Boolean, Formula, Temporal, TemporalPair, node_text
from pytest_dura.requirements.stl import streaming
from pytest_dura.requirements.stl.evaluation import evaluate
from pytest_dura.requirements.stl.streaming import StreamedFormula

NAMES = ("a", "b", "c")
SIZE = 24
INNER = nodes(NAMES, max_window=3)
BACK = nodes(NAMES, max_window=3, max_leaves=3, future=False)
CARRIED = st.one_of(
    st.builds(Temporal, st.sampled_from(["once", "historically"]), BACK, st.none()),
    st.builds(TemporalPair, st.just("since"), BACK, BACK, st.none()),
)
PARTS = st.one_of(
    st.builds(
        Temporal, st.sampled_from(["always", "eventually"]), st.one_of(INNER, CARRIED), st.none()
    ),
    INNER,
)
ROOTS = st.one_of(PARTS, st.builds(Boolean, st.just("and"), PARTS, PARTS))


def judged_in_blocks(formula, columns, sizes, *, at_once=False):
    stream = StreamedFormula(formula, 1.0, at_once=at_once)
    start = 0
    while start < SIZE:
        size = sizes[start % len(sizes)]
        stream.take({name: column[start : start + size] for name, column in columns.items()})
        start += size
    return stream.finish()


def same(ours, theirs) -> bool:
    """Equal, bit for bit; what is NaN in both is equal."""
    return all(
        mine == other or bool(np.isnan(mine) and np.isnan(other))
        for mine, other in zip(asdict(ours).values(), asdict(theirs).values(), strict=True)
    )


KINDS = ["known"] * 6 + ["bounded", "unknown"]


@pytest.mark.parametrize("lacking", [(), ("a",), ("a", "b")])
def test_judging_block_by_block_is_judging_the_whole(lacking, monkeypatch) -> None:
    monkeypatch.setattr(streaming, "BLOCK", 1)
    statuses: Counter[str] = Counter()
    refused = 0

    @settings(max_examples=1000, derandomize=True, deadline=None)
    @given(
        ROOTS,
        st.lists(st.integers(1, 9), min_size=1, max_size=5),
        st.lists(st.sampled_from(KINDS), min_size=SIZE, max_size=SIZE),
        st.integers(0, 2**31),
        st.integers(0, SIZE),
    )
    def law(root, sizes, kinds, seed, known) -> None:
        nonlocal refused
        formula = Formula(root, node_text(root))
        random = np.random.default_rng(seed)
        columns = {name: random.integers(-3, 4, SIZE).astype(float) for name in NAMES}
        kind = np.where(np.arange(SIZE) < known, "known", np.array(kinds))
        for name in lacking:
            value = columns[name]
            bounds = {"least.": value - 1, "greatest.": value + 1}
            for prefix, bound in bounds.items():
                known_or_bound = np.where(kind == "known", value, bound)
                columns[prefix + name] = np.where(kind == "unknown", np.nan, known_or_bound)
            columns[name] = np.where(kind == "known", value, np.nan)
        if (kind == "known").all():
            columns = {name: columns[name] for name in NAMES}
        try:
            ours = judged_in_blocks(formula, columns, sizes, at_once=bool(seed % 2))
        except ConfigurationError as error:
            refused += 1
            if "needs the whole trace" not in str(error) and "not finite" not in str(error):
                raise
            return
        whole = evaluate(formula, np.arange(SIZE) * 1.0, columns, time_step=1.0)
        assert same(ours, whole), (ours, whole)
        statuses[f"{ours.status} {ours.vacuous}"] += 1

    law()
    assert min(statuses[f"{status} False"] for status in ("satisfied", "violated")) > 100, statuses
    assert statuses["satisfied True"] > 5, statuses
    assert refused < 400
