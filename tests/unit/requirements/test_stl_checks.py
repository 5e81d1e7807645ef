"""Windows on samples, and formulas that a monitor cannot follow."""

from __future__ import annotations

import math

import pytest

from pytest_dura import ConfigurationError
from pytest_dura.requirements import Window, check_time_step, in_samples, parse
from pytest_dura.requirements.stl.formula import past_only_or_refuse, ranging_or_refuse


@pytest.mark.parametrize(
    "window, step",
    [
        ("[0:0.3]", 0.1),
        ("[0.7:1.1]", 0.1),
        ("[0:1000]", 0.1),
        ("[0:1]", 1 / 15),
        ("[0:2]", 0.0666666667),
        ("[500ms:2s]", 0.5),
        ("[0:0]", 0.3),
        ("[1us:3us]", 1e-6),
    ],
)
def test_bounds_on_samples_pass(window: str, step: float) -> None:
    check_time_step(parse(f"(a > 1) until{window} (always{window} (a > 1))"), step)


@pytest.mark.parametrize(
    "window, step, found, remedy",
    [
        ("[0:0.25]", 0.1, "0.25 s with a sample every 0.1 s", "write 0.2 or 0.3 for 0.25"),
        ("[0.05:1]", 0.1, "0.05 s with a sample every 0.1 s", "write 0 or 0.1 for 0.05"),
        ("[0:1]", 0.3, "1 s with a sample every 0.3 s", "write 0.9 or 1.2 for 1"),
        ("[0:0.99999]", 1.0, "0.99999 s with a sample every 1 s", "write 0 or 1 for 0.99999"),
        ("[0:1]", 0.0667, "1 s with a sample every 0.0667 s", "write 0.9338 or 1.0005 for 1"),
        ("[0:500ns]", 1e-6, "5e-07 s with a sample every 1e-06 s", "write 0 or 1e-06 for 5e-07"),
    ],
)
def test_a_bound_between_two_samples_is_refused(
    window: str, step: float, found: str, remedy: str
) -> None:
    text = f"once[0:0] (a > 1) and historically{window} (a > 1)"
    with pytest.raises(ConfigurationError, match="falls between two samples") as caught:
        check_time_step(parse(text), step)
    error = caught.value
    assert (error.found, error.remedy) == (found, remedy)
    formula, caret = error.problem.splitlines()[1:]
    assert formula[caret.index("^") :].startswith(window)


@pytest.mark.parametrize("step", [0.0, -0.1, math.nan, math.inf])
def test_a_time_step_is_a_positive_number(step: float) -> None:
    with pytest.raises(ConfigurationError, match="no positive number"):
        check_time_step(parse("always[0:1] (a > 1)"), step)


def test_windows_in_samples() -> None:
    assert in_samples(Window(0.3, 1.1), 0.1) == (3, 11)
    assert in_samples(Window(0.0, 1.0), 1 / 15) == (0, 15)


def test_a_past_formula_is_for_a_monitor() -> None:
    past_only_or_refuse(parse("historically[0:2] (a > 1 since prev (b > 1))"), "the monitor")


@pytest.mark.parametrize(
    "text, found, column",
    [
        ("a > 1 and (G (b > 1))", "G", 11),
        ("once (eventually[0:2] (a > 1) and always (a > 1))", "eventually", 6),
        ("a > 1 unless[0:2] b > 1", "unless", 6),
        ("(X a > 1) until (b > 1)", "X", 1),
        ("s_next (a > 1)", "s_next", 0),
    ],
)
def test_a_formula_that_looks_ahead_is_not(text: str, found: str, column: int) -> None:
    with pytest.raises(ConfigurationError) as caught:
        past_only_or_refuse(parse(text), "the monitor 'gap'")
    error = caught.value
    assert error.problem.startswith(
        f"the monitor 'gap' cannot know the future: `{found}` looks ahead at column {column + 1}\n"
    )
    assert error.problem.splitlines()[-1] == " " * (4 + column) + "^"
    assert "measured to flip verdicts" in str(error.expected)
    assert "give the formula to a requirement" in str(error.remedy)


@pytest.mark.parametrize(
    "text",
    [
        "always (gap > 0)",
        "not always (gap > 0)",
        "always (gap > 0) and eventually (x > 1)",
        "(always (gap > 0)) implies (not eventually (x > 1))",
        "(gap > 1) until (x > 1)",
        "always (historically[0:2] (gap > 0))",
        "next (always (gap > 0))",
        "historically (always (gap > 0))",
    ],
)
def test_a_formula_over_the_whole_episode_passes(text: str) -> None:
    ranging_or_refuse(parse(text))


@pytest.mark.parametrize(
    "text, part",
    [
        ("gap > 0", "gap > 0"),
        ("not gap > 0", "not (gap > 0)"),
        ("gap > 0 or x > 1", "(gap > 0) or (x > 1)"),
        ("(gap > 0) and (always (x < 1))", "gap > 0"),
        ("(x < 1) implies (always (gap > 0))", "x < 1"),
        ("(always (x < 1)) and (not (gap > 0 or x > 2))", "not ((gap > 0) or (x > 2))"),
        ("historically (gap > 0)", "historically (gap > 0)"),
        ("(gap > 0) since (x > 1)", "(gap > 0) since (x > 1)"),
        ("once ((gap > 0) and (always (x < 1)))", "once ((gap > 0) and (always (x < 1)))"),
        ("next (gap > 0)", "next (gap > 0)"),
        ("rise (gap > 0)", "rise (gap > 0)"),
    ],
)
def test_a_part_that_reads_the_beginning_alone_is_refused_by_name(text: str, part: str) -> None:
    with pytest.raises(ConfigurationError, match="judged at the beginning of the episode") as found:
        ranging_or_refuse(parse(text))
    assert found.value.found == part
    assert f"write `always ({part})`" in str(found.value.remedy)
