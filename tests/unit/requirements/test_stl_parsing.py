"""What a text of signal temporal logic is read as."""

from __future__ import annotations

import subprocess
import sys

import pytest

from pytest_dura import ConfigurationError
from pytest_dura.requirements import (
    Arithmetic,
    Boolean,
    Comparison,
    Constant,
    Formula,
    Signal,
    Temporal,
    TemporalPair,
    Window,
    parse,
)
from pytest_dura.requirements.stl.formula import walk

A = Comparison(">", Signal("a"), Constant(1.0))
B = Comparison(">", Signal("b"), Constant(2.0))


@pytest.mark.parametrize(
    "text, canonical",
    [
        ("a > 1", "a > 1"),
        ("G(a>1)", "always (a > 1)"),
        ("F[0:2] a > 1", "eventually[0:2] (a > 1)"),
        ("H[1,2](a > 1)", "historically[1:2] (a > 1)"),
        ("O (a > 1)", "once (a > 1)"),
        ("a > 1 U[0:2] b > 2", "(a > 1) until[0:2] (b > 2)"),
        ("a > 1 S b > 2", "(a > 1) since (b > 2)"),
        ("a > 1 since[1:3] b > 2", "(a > 1) since[1:3] (b > 2)"),
        ("X a > 1", "next (a > 1)"),
        ("Y a > 1", "prev (a > 1)"),
        ("sX (a > 1)", "s_next (a > 1)"),
        ("s_prev (a > 1)", "s_prev (a > 1)"),
        ("rise(a > 1)", "rise (a > 1)"),
        ("fall(a > 1) & !(b > 2)", "(fall (a > 1)) and (not (b > 2))"),
        ("a > 1 | b > 2", "(a > 1) or (b > 2)"),
        ("a > 1 -> b > 2", "(a > 1) implies (b > 2)"),
        ("a > 1 <-> b > 2", "(a > 1) iff (b > 2)"),
        ("a > 1 xor b > 2", "(a > 1) xor (b > 2)"),
        ("a !== 1", "a != 1"),
        ("a != 1", "a != 1"),
        ("a == b", "a == b"),
        ("abs(a - 1) <= pow(b, 2)", "abs(a - (1)) <= pow(b, 2)"),
        ("pow(pow(a, 2), (pow(b, 3))) > 1", "pow(pow(a, 2), pow(b, 3)) > 1"),
        ("sqrt(exp(a)) < -.5e1", "sqrt(exp(a)) < -5"),
        ("a/b > 1", "a / b > 1"),
        ("((a)) > (1)", "a > 1"),
        (" \n always\t(a\n> 1) ", "always (a > 1)"),
    ],
)
def test_every_operator_in_its_long_and_its_short_form(text: str, canonical: str) -> None:
    assert str(parse(text)) == canonical
    assert parse(canonical) == parse(text)


@pytest.mark.parametrize(
    "text, same",
    [
        ("not a > 1", "not (a > 1)"),
        ("not a > 1 and b > 2", "(not (a > 1)) and (b > 2)"),
        ("a > 1 and b > 2 or c > 3", "((a > 1) and (b > 2)) or (c > 3)"),
        ("a > 1 or b > 2 and c > 3", "(a > 1) or ((b > 2) and (c > 3))"),
        ("a > 1 and b > 2 -> c > 3", "((a > 1) and (b > 2)) -> (c > 3)"),
        ("a > 1 iff b > 2 or c > 3", "(a > 1) iff ((b > 2) or (c > 3))"),
        ("a - b - c > 0", "(a - b) - c > 0"),
        ("a / b / c > 0", "(a / b) / c > 0"),
        ("a + b - c > 0", "(a + b) - c > 0"),
        ("a * b / c + 2 > 0", "((a * b) / c) + 2 > 0"),
        ("a - b * c > 0", "a - (b * c) > 0"),
        ("always a > 1", "always (a > 1)"),
        ("always (a > 1) and eventually (b > 2)", "(always (a > 1)) and (eventually (b > 2))"),
        ("a > 1 and always (b > 2)", "(a > 1) and (always (b > 2))"),
        ("a > 1 implies always b > 2", "(a > 1) implies (always (b > 2))"),
    ],
)
def test_what_needs_no_parentheses(text: str, same: str) -> None:
    assert parse(text) == parse(same)


@pytest.mark.parametrize(
    "text, signals, canonical",
    [
        ("F (F > 2)", ("F",), "eventually (F > 2)"),
        ("F F > 2", ("F",), "eventually (F > 2)"),
        ("F U > 2", ("U",), "eventually (U > 2)"),
        ("x > F U x < 2", ("F", "x"), "(x > F) until (x < 2)"),
        ("G F X > 2", ("X",), "always (eventually (X > 2))"),
        ("U > 1 U U < 2", ("U",), "(U > 1) until (U < 2)"),
        ("s > 2 S S > s", ("S", "s"), "(s > 2) since (S > s)"),
        ("H - O > 0 and Y * X < G", ("G", "H", "O", "X", "Y"), "(H - O > 0) and (Y * X < G)"),
        ("once > prev", ("once", "prev"), "once > prev"),
        ("1 < next", ("next",), "1 < next"),
        ("(F) - 3 > 0", ("F",), "F - (3) > 0"),
        ("x - F - 3 > 0", ("F", "x"), "(x - F) - (3) > 0"),
        ("abs > 1 and abs(rise) > 1", ("abs", "rise"), "(abs > 1) and (abs(rise) > 1)"),
        ("ms > us + time", ("ms", "time", "us"), "ms > us + time"),
        ("true > 0.5", ("true",), "true > 0.5"),
        ("always[0:2s] (s > 2)", ("s",), "always[0:2] (s > 2)"),
        ("percept.gap > percept.s.F", ("percept.gap", "percept.s.F"), "percept.gap > percept.s.F"),
        ("out > 1 and topic < float", ("float", "out", "topic"), "(out > 1) and (topic < float)"),
    ],
)
def test_a_signal_may_have_the_name_of_an_operator(
    text: str, signals: tuple[str, ...], canonical: str
) -> None:
    formula = parse(text, signals)
    assert formula.signals == signals
    assert str(formula) == canonical
    assert parse(canonical, signals) == formula


@pytest.mark.parametrize(
    "text, start, end",
    [
        ("[0:2]", 0.0, 2.0),
        ("[0.5,1.5]", 0.5, 1.5),
        ("[0:500ms]", 0.0, 0.5),
        ("[0s:2]", None, None),
        ("[500ms:2s]", 0.5, 2.0),
        ("[100us:0.2ms]", 1e-4, 2e-4),
        ("[7ns:0.3 s]", 7e-9, 0.3),
        ("[1min:1.5h]", 60.0, 5400.0),
        ("[0:90 min]", 0.0, 5400.0),
        ("[1e-1:.2e1]", 0.1, 2.0),
        ("[2:2]", 2.0, 2.0),
    ],
)
def test_windows_are_in_seconds(text: str, start: float | None, end: float | None) -> None:
    whole = f"always{text} (a > 1)"
    if start is None or end is None:
        with pytest.raises(ConfigurationError, match="only one bound of the window has a unit"):
            parse(whole)
        return
    assert parse(whole).root == Temporal("always", A, Window(start, end))
    assert parse(str(parse(whole))).root == parse(whole).root


def test_unless_is_always_or_until() -> None:
    within = Boolean(
        "or",
        Temporal("always", A, Window(0.0, 3.0)),
        TemporalPair("until", A, B, Window(1.0, 3.0)),
    )
    assert parse("a > 1 unless[1:3] b > 2").root == within
    unbounded = Boolean("or", Temporal("always", A), TemporalPair("until", A, B))
    assert parse("(a > 1) W (b > 2)").root == unbounded


def test_nodes_know_their_columns() -> None:
    formula = parse("a > 1 and always[0:2] (\nbb > 2 U[1:2] c - d > 3)")
    places = {
        getattr(node, "name", getattr(node, "operator", "")): node.position
        for node in walk(formula.root)
        if hasattr(node, "position")
    }
    text = formula.text
    assert places == {name: text.rindex(name) for name in ("bb", "c", "d", "always")} | {
        "a": 0,
        "until": text.index("U"),
    }
    windows = [node.window for node in walk(formula.root) if getattr(node, "window", None)]
    assert [window.position for window in windows if window] == [16, text.index("[1:2]")]


def test_what_a_formula_says_of_itself() -> None:
    formula = parse("G[0:3] (b > 0 -> F[0:500ms] percept.a < 1) and once[0:9] (b < 9)")
    assert formula.signals == ("b", "percept.a")
    assert formula.percept_signals == ("percept.a",)
    assert formula.horizon == 3.5
    assert formula.future_operators == (("always", 0), ("eventually", 17))
    assert not formula.past_only


@pytest.mark.parametrize(
    "text, horizon",
    [
        ("always (a > 1)", None),
        ("once[0:5] (a > 1)", None),
        ("next (a > 1)", None),
        ("always (eventually[0:2] (a > 1))", 2.0),
        ("next (always[1:4] (a > 1))", 4.0),
        ("(always[0:9] (a > 1)) until[1:2] (eventually[0:3] (b > 1))", 11.0),
        ("(always[0:1] (a > 1)) or (eventually[0:3] (b > 1))", 3.0),
        ("(a > 1) until (eventually[0:3] (b > 1))", 3.0),
        ("always[0:0] (a > 1)", 0.0),
    ],
)
def test_the_horizon_adds_nested_windows(text: str, horizon: float | None) -> None:
    assert parse(text).horizon == horizon


@pytest.mark.parametrize(
    "text", ["once[0:2] (a > 1)", "(a > 1) since (fall (b > 2))", "prev a > 1"]
)
def test_formulas_of_the_past(text: str) -> None:
    assert parse(text).past_only


@pytest.mark.parametrize("text", ["X a > 1", "sX a > 1", "a > 1 U b > 2", "once (G (a > 1))"])
def test_formulas_that_look_ahead(text: str) -> None:
    assert not parse(text).past_only


def test_formulas_are_equal_by_meaning_and_can_be_keys() -> None:
    one, two = parse("G (a > 1.0)"), parse("always (a > 1)")
    assert one == two
    assert len({one, two}) == 1
    assert one != parse("always (a >= 1)")


def test_numbers_are_kept_exactly() -> None:
    number = 0.1 + 0.2
    formula = Formula(
        Comparison(">", Signal("a"), Arithmetic("*", Signal("b"), Constant(number))), ""
    )
    assert parse(str(formula)) == formula
    assert repr(number) in str(formula)


def test_a_long_chain_and_deep_nesting_within_the_bounds_are_read() -> None:
    chain = parse(" and ".join(["a > 1"] * 98))
    assert parse(str(chain)) == chain
    deep = parse("not (" * 95 + "a > 1" + ")" * 95)
    assert parse(str(deep)) == deep
    assert parse("(" * 1900 + "a > 1" + ")" * 1900) == parse("a > 1")


def test_formulas_are_judged_without_rtamt() -> None:
    code = """
import sys
sys.modules["rtamt"] = sys.modules["antlr4"] = None  # as if it were not installed
from pytest_dura.requirements.stl.parser import parse
from pytest_dura.requirements.stl.evaluation import evaluate
formula = parse("always (gap > 1 -> F[0:2] speed - 5 > 2)")
assert evaluate(formula, [0.0, 1.0], {"gap": [0, 0], "speed": [0, 0]}).status == "satisfied"
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
