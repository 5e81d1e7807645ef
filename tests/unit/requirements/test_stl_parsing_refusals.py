"""Texts that are refused, each with its column and what to write instead."""

from __future__ import annotations

import pytest

from pytest_dura import ConfigurationError
from pytest_dura.requirements import parse


def refused(text: str, signals: tuple[str, ...] | None = None) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as caught:
        parse(text, signals)
    return caught.value


@pytest.mark.parametrize(
    "text, place, problem",
    [
        ("", "", "it is empty"),
        (" \n ", "", "it is empty"),
        ("always (gap > 0)\nalways (x > 0)", "always (x", "found `always`"),
        ("always (gap > 0)\nnonsense", "nonsense", "found `nonsense`"),
        ("gap > 0 x > 0", "x > 0", "found `x`"),
        ("out = always (gap > 0)", "=", "found an assignment"),
        ("x = 3", "=", "found an assignment"),
        ("gap > 0; x > 0", ";", "found `;`"),
        ("float gap", "gap", "found `gap`"),
        ("specification safe gap > 0", "safe", "found `safe`"),
        ("gap > 0 // and x > 0", "//", "found a comment"),
        ("gap > 0 /* x */", "/*", "found a comment"),
        ("gap > 0 # x", "#", "found a comment"),
        ("always (gap)", "gap", "found a value"),
        ("always (gap - 3)", "gap", "found a value"),
        ("gap", "gap", "found a value"),
        ("3", "3", "found a value"),
        ("gap and x > 0", "gap", "found a value"),
        ("always", "always", "found a value"),
        ("(a > 1) + 2 > 3", "> 1", "a formula stands inside arithmetic"),
        ("abs(a > 1) > 3", "> 1", "a formula stands inside arithmetic"),
        ("a > always (b > 1)", "always", "a formula stands inside arithmetic"),
        ("a > not b > 1", "not", "a formula stands inside arithmetic"),
        ("(a > 1 and b > 1) > 2", "and", "a formula stands inside arithmetic"),
        ("a < b < c", "< c", "comparisons are compared"),
        ("(a > 1) == (b > 1)", "== ", "comparisons are compared"),
        ("always (true)", "true", "found the truth value `true`"),
        ("a == true", "true", "found the truth value `true`"),
        ("FALSE", "FALSE", "found the truth value `FALSE`"),
        ("1 > 2", "> 2", "a comparison of constants"),
        ("always (pow(2, 3) > 2)", "> 2", "a comparison of constants"),
        ("a / 0 > 1", "/", "division by zero"),
        ("a / (2 - 2) > 1", "/", "division by zero"),
        ("a / -0.0 > 1", "/", "division by zero"),
        ("pow(10, 400) > a", "pow", "this constant has no finite value"),
        ("sqrt(-1) > a", "sqrt", "this constant has no finite value"),
        ("1e300 * 1e300 > a", "1e300 *", "this constant has no finite value"),
        ("a > 1e999", "1e999", "this number is too large"),
        ("a > 1e-999", "1e-999", "this number is too small"),
        ("a > 1.2.3", ".3", "a number ends in `.3`"),
        ("a > 3s", "s", "a number ends in `s`"),
        ("a > 0x1F", "x1F", "a number ends in `x1F`"),
        ("a > 1_000", "_000", "a number ends in `_000`"),
        ("a > +2", "+2", "found `+`"),
        ("-a > 2", "-a", "`-` stands before no number"),
        ("a > --2", "--2", "`-` stands before no number"),
        ("tr\u00fcbe > 1", "\u00fc", "this does not belong here: `\u00fc`"),
        ("a \u2265 1", "\u2265", "this does not belong here"),
        ("a > 1 \x1b[31m", "\x1b", "this does not belong here: `\\x1b`"),
        ("percept. > 1", ". >", "this does not belong here: `.`"),
        ("a && b", "&&", "found `&&`"),
        ("a > 1 || b > 1", "||", "found `||`"),
        ("a > 1 => b > 1", "=>", "found `=>`"),
        ("a^2 > 1", "^", "found `^`"),
        ("a === 1", "===", "found `===`"),
        ("Always (a > 1)", "Always", "`Always` is no operator"),
        ("globally (a > 1)", "globally", "`globally` is no operator"),
        ("max(a, b) > 1", "max", "`max` is no operator"),
        ("a > 1 AND b > 1", "AND", "found `AND`"),
        ("a[0:1] > 2", "a[", "`a` is no operator"),
        ("abs(a, 2) > 1", ", 2", "found `,`"),
        ("pow(a) > 1", ") >", "found `)`"),
        ("pow(a, 2, 3) > 1", ", 3", "found `,`"),
        ("a > 1 and", "", "found the end"),
        ("always (a > 1", "", "found the end"),
        ("a > 1)", ")", "found `)`"),
        ("and a > 1", "and", "found `and`"),
        ("U (a > 1)", "U", "found `U`"),
        ("F - 3 > 0", "F", "`F - 3` can be read in two ways"),
        ("always -3 < a", "always", "`always - 3` can be read in two ways"),
    ],
)
def test_no_formula(text: str, place: str, problem: str) -> None:
    error = refused(text)
    column = text.rindex(place) if place else len(text.rstrip())
    if text.isspace():
        column = 0
    assert problem in error.problem
    assert f"at column {column + 1}\n" in error.problem
    formula, caret = error.problem.splitlines()[1:]
    assert caret == " " * (4 + column) + "^"
    assert formula.isprintable()
    assert error.expected
    assert error.remedy


@pytest.mark.parametrize(
    "window, place, problem",
    [
        ("[2:1]", "[", "the window is not ordered"),
        ("[2s:1000ms]", "[", "the window is not ordered"),
        ("[-1:1]", "-", "a bound of the window is negative"),
        ("[0:-1]", "-", "a bound of the window is negative"),
        ("[0:inf]", "inf", "found `inf` in a window"),
        ("[0:1e999]", "1e999", "this number is too large"),
        ("[0:1e7]", "[", "the window is absurdly long"),
        ("[0:2d]", "d", "`d` is no unit of time"),
        ("[0:2ps]", "ps", "`ps` is no unit of time"),
        ("[1:500ms]", "[", "only one bound of the window has a unit"),
        ("[1ms:5]", "[", "only one bound of the window has a unit"),
        ("[0:]", "]", "found `]` in a window"),
        ("[0]", "]", "found `]` in a window"),
        ("[0:1:2]", ":2", "found `:` in a window"),
        ("[a:2]", "a:", "found `a` in a window"),
        ("[0:1", "", "found the end in a window"),
    ],
)
def test_no_window(window: str, place: str, problem: str) -> None:
    text = f"always{window}" + (" (gap > 0)" if window.endswith("]") else "")
    error = refused(text)
    assert problem in error.problem
    column = len("always") + window.index(place) if place else len(text)
    assert f"at column {column + 1}\n" in error.problem


@pytest.mark.parametrize("operator", ["next", "prev", "not", "rise", "X", "and"])
def test_windows_belong_to_temporal_operators(operator: str) -> None:
    before = "a > 1 " if operator == "and" else ""
    error = refused(f"{before}{operator}[0:1] (b > 1)")
    assert f"`{operator}` takes no window at column {len(before + operator) + 1}" in error.problem
    assert "windows belong to always" in str(error.remedy)


@pytest.mark.parametrize(
    "text, place, remedy",
    [
        ("a - b + c > 0", "+", "(a - b) + c"),
        ("a - b + c - d > 0", "+", "(a - b) + c"),
        ("a / b * c > 0", "*", "(a / b) * c"),
        ("a + b / c * d > 0", "*", "(a / b) * c"),
        ("a > 1 -> b > 1 -> c > 1", "-> c", "(a ... b) ... c"),
        ("a > 1 until b > 1 until c > 1", "until c", "(a ... b) ... c"),
        ("a > 1 until b > 2 and c > 3", "and", "(a ... b) ... c"),
        ("a > 1 and b > 2 since c > 3", "since", "(a ... b) ... c"),
        ("a > 1 or b > 2 unless c > 3", "unless", "(a ... b) ... c"),
        ("a > 1 iff b > 1 xor c > 1", "xor", "(a ... b) ... c"),
        ("a > 1 iff b > 1 -> c > 1", "->", "(a ... b) ... c"),
        ("always (a > 0) implies b > 0", "implies", "always (a implies b)"),
        ("always (a > 0) -> (F[0:2] (b > 0))", "->", "always (a -> b)"),
        ("always a > 0 and b > 0", "and", "always (a and b)"),
        ("not always a > 0 and b > 0", "and", "always (a and b)"),
        ("next a > 0 or b > 0", "or", "next (a or b)"),
        ("always a > 0 until b > 0", "until", "always (a until b)"),
        ("once a > 0 and (G (a > 0) and b > 0)", "and b", "G (a and b)"),
        ("c > 0 and always (a > 0) implies b > 0", "implies", "always (a implies b)"),
        ("G (a > 0) and G (b > 0) and c > 0", "and c", "G (a and b)"),
    ],
)
def test_parentheses_are_asked_for_where_rtamts_reading_would_surprise(
    text: str, place: str, remedy: str
) -> None:
    error = refused(text)
    assert f"at column {text.index(place) + 1}\n" in error.problem
    assert error.expected == "parentheses"
    assert remedy in str(error.remedy)


def test_an_unknown_signal_is_marked_and_the_known_ones_are_listed() -> None:
    error = refused("always (speed > 0) and always (gapp > 0)", ("gap", "speed"))
    assert error.expected == "one of gap, speed"
    assert error.remedy == "did you mean 'gap'?"
    formula, caret = error.problem.splitlines()[1:]
    assert formula[caret.index("^") :].startswith("gapp")


def test_a_misspelt_operator_is_told() -> None:
    assert refused("alway (a > 1)").remedy == "did you mean `always`?"
    assert refused("Eventually[0:2] (a > 1)").remedy == "did you mean `eventually`?"


@pytest.mark.parametrize(
    "text",
    [
        "a > 1 and " * 1000,
        "not " * 500 + "a > 1",
        "not " * 150 + "a > 1",
        " and ".join(["a > 1"] * 101),
        "+".join(["a"] * 1900) + " > 1",
        "abs(" * 120 + "a" + ")" * 120 + " > 1",
    ],
)
def test_long_and_deep_texts_are_refused_and_quickly(text: str) -> None:
    error = refused(text)
    assert "too long" in error.problem or "nested too deeply" in error.problem
    assert error.remedy


def test_operators_are_counted_one_inside_the_other_and_parentheses_are_not() -> None:
    operators = "not (" * 99
    assert parse(operators + "(" * 500 + "a > 1" + ")" * 599)
    error = refused(operators + "not (a > 1" + ")" * 100)
    assert "at most 100 operators" in str(error.expected)
    assert f"at column {len(operators) + 10}\n" in error.problem
