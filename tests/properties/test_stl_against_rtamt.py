"""rtamt as the judge of our formulas: its grammar, and its offline evaluation."""

from __future__ import annotations

from itertools import product
from random import Random
from typing import Any

import pytest
import rtamt_oracle
from formulas import formulas, traces
from hypothesis import given, settings
from hypothesis import strategies as st
from stl_oracle import robustness as by_the_textbook

from pytest_dura import ConfigurationError
from pytest_dura.requirements import Formula, robustness
from pytest_dura.requirements.stl.syntax import Tree, read_tree

STEP = 0.1
NAMES = ("gap", "percept.gap", "F", "s", "prev", "true")
WINDOWED = ("always", "G", "eventually", "F", "historically", "H", "once", "O")
PREFIXES = (*WINDOWED, "not", "!", "next", "X", "prev", "Y", "s_next", "sX", "s_prev", "sY")
PAIRS = ("until", "U", "unless", "W", "since", "S")
CONNECTIVES = (*PAIRS, "and", "&", "or", "|", "implies", "->", "iff", "<->", "xor")
COMPARISONS = (">", ">=", "<", "<=", "==", "!==")
BINARY = (
    *("xor", "iff", "implies", "or", "and", "since", "unless", "until"), *COMPARISONS, *"+-*/",
)  # fmt: skip
FUNCTIONS = ("abs", "sqrt", "exp", "rise", "fall")
PIECES = (*PREFIXES, *CONNECTIVES, *COMPARISONS, *FUNCTIONS, "pow", *"+-*/", *"ab12", *"(((),)))")


def sentences() -> st.SearchStrategy[str]:
    """Texts of rtamt's grammar with few parentheses: values and formulas are one to it."""
    operand = st.sampled_from(["a", "b", "gap", "1", "2.5", "-3"])

    def extend(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
        window = st.sampled_from(["", "", "[0:2]"])
        binary = st.sampled_from(BINARY) | st.builds(str.__add__, st.sampled_from(PAIRS), window)
        prefix = st.one_of(
            st.sampled_from(PREFIXES),
            st.builds(str.__add__, st.sampled_from(WINDOWED), window),
        )
        # `F - 3` has two readings and is refused; `F b` in a value would be a signal to us.
        return st.one_of(
            st.builds("{} {} {}".format, inner, binary, inner),
            st.builds("{} {} {}".format, inner, binary, inner),
            st.builds("{} (a) {} {}".format, prefix, binary, inner),
            st.builds("{} ({})".format, prefix, inner),
            st.builds("{}({})".format, st.sampled_from(FUNCTIONS), inner),
            st.builds("pow({}, {})".format, inner, inner),
            st.builds("({})".format, inner),
        )

    return st.recursive(operand, extend, max_leaves=12)


def plain(tree: Tree) -> Any:
    window = None if tree.window is None else tree.window.position
    return tree.kind, tree.start, window, tuple(map(plain, tree.operands))


@pytest.mark.parametrize("middle", ["", "not ", "always ", "s_next "])
def test_any_two_operators_bind_as_in_rtamt(middle: str) -> None:
    for first, second in product(BINARY, repeat=2):
        text = f"a {first} {middle}(b) {second} a"
        assert plain(read_tree(text, None)) == rtamt_oracle.syntax_tree(text)


@settings(derandomize=True, deadline=None, max_examples=500)
@given(sentences())
def test_a_text_has_rtamts_syntax_tree(text: str) -> None:
    assert plain(read_tree(text, None)) == rtamt_oracle.syntax_tree(text)


@settings(derandomize=True, deadline=None, max_examples=400)
@given(st.lists(st.sampled_from(PIECES), min_size=1, max_size=9).map(" ".join))
def test_any_words_are_rtamts_sentence_or_refused(text: str) -> None:
    try:
        tree = plain(read_tree(text, None))
    except ConfigurationError:
        return
    # A word that rtamt reserves is a signal where only a signal can stand.
    signals = [text[start:].split(maxsplit=1)[0] for start in columns(tree)]
    if set(signals) <= {"a", "b"}:
        assert tree == rtamt_oracle.syntax_tree(text)


def columns(tree: Any) -> list[int]:
    """Where the signals stand."""
    kind, start, _, operands = tree
    return [start] if kind == "signal" else [at for one in operands for at in columns(one)]


@settings(derandomize=True, deadline=None, max_examples=300)
@given(formulas(NAMES, time_step=STEP, max_leaves=8), st.integers(0, 2**32))
def test_rtamt_and_the_textbook_agree_at_every_sample(formula: Formula, seed: int) -> None:
    random = Random(seed)
    for size in (2, 5, 12, 12):
        trace = {name: [float(random.choice(range(-3, 4))) for _ in range(size)] for name in NAMES}
        expected = by_the_textbook(formula.root, trace, STEP)
        assert rtamt_oracle.robustness(formula, trace, STEP) == expected


@settings(derandomize=True, deadline=None, max_examples=120)
@given(formulas(("a", "b"), time_step=STEP), traces(("a", "b")))
def test_robustness_is_rtamts(formula: Formula, trace: dict[str, list[float]]) -> None:
    found = robustness(formula, trace, STEP).tolist()
    assert found == rtamt_oracle.robustness(formula, trace, STEP)
