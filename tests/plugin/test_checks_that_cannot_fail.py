"""What would pass whatever the component does is refused, or named where the gate stands."""

from __future__ import annotations

import pytest
from corridors import requirement, scenario
from outputs import output

REFUSED = "`gap > 0` is judged at the beginning of the episode alone"


def a_test(body, fixtures="episode", marks=(), **dura):
    given = {"scenario": "corridor/free", "runs": 2} | dura
    told = ", ".join(f"{key}={value!r}" for key, value in given.items())
    lines = [
        "import pytest",
        f"@pytest.mark.dura({told})",
        *(f"@pytest.mark.{one}" for one in marks),
    ]
    return "\n".join([*lines, f"def test_it({fixtures}):", *(f"    {one}" for one in body)]) + "\n"


def test_a_requirement_that_reads_one_sample_is_refused_at_its_line(project):
    requirement(project, "gap > 0")
    scenario(project, requirements="[R-1]")
    result = project.scenarios()
    assert result.ret == 4
    told = output(result)
    assert REFUSED in told
    assert "remedy:   write `always (gap > 0)`" in told
    assert "scenarios/requirements_R-1.yaml:2: `gap" in told
    assert "Traceback" not in told


@pytest.mark.parametrize(
    "fixture, body",
    [
        ("campaign", "campaign.require('(gap > 0) and (always (x < 99))')"),
        ("episode", "assert episode.robustness('gap > 0') > 0"),
        ("episode", "assert episode.satisfies('gap > 0')"),
    ],
)
def test_a_formula_of_a_test_that_reads_one_sample_is_refused(project, fixture, body):
    project.write("test_it.py", a_test([body], fixture))
    result = project.run("test_it.py")
    assert result.ret == 1
    assert REFUSED in output(result)
    assert "passed" not in result.parseoutcomes()


def test_a_marker_that_reads_one_sample_is_refused_at_collection(project):
    project.write("test_it.py", a_test(["pass"], "campaign", ["falsify('gap > 0')"]))
    result = project.run("test_it.py", "--collect-only")
    assert result.ret == 2
    assert REFUSED in output(result)


def test_a_check_that_returns_a_number_of_things_decides_nothing(project):
    project.write(
        "counting.py", "def hits(episode):\n    return int((episode.signals['gap'] <= 0).sum())\n"
    )
    requirement(project, "counting:hits")
    scenario(project, requirements="[R-1]")
    result = project.scenarios("--dura-generator=corridor:Careful")
    assert result.ret == 1
    assert project.verdict("R-1")["verdict"] == "undecided"
    assert "returned the int 0, not a truth value" in output(result)
    assert "compare it, as in `count == 0`" in output(result)
