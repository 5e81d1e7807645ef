"""A session of more cases than fit on a screen."""

from __future__ import annotations

import re

import pytest

SCENARIO = """\
name: scale/grid
simulator: driving
duration: 50.0
runs: 1
requirements: [SAF-1]
campaigns:
  - fault: {{type: ghost-obstacle, activation: {{at: 2.0}}, duration: 4.0}}
    grid: {{parameters.ahead: {values}}}
"""
NOTHING_RUNS = """\
def pytest_runtestloop(session):
    return True
"""


@pytest.mark.parametrize("verbose", [False, True])
def test_a_hundred_are_shown_and_the_others_counted(
    pytester: pytest.Pytester, fast_sessions: None, *, verbose: bool
) -> None:
    scenarios = pytester.mkdir("scenarios")
    values = [5.0 + number / 10 for number in range(103)]
    (scenarios / "grid.yaml").write_text(SCENARIO.format(values=values), encoding="utf-8")
    pytester.makeconftest(NOTHING_RUNS)
    arguments = ["-v"] if verbose else []
    result = pytester.runpytest("--dura-scenarios", "--dura-select=scale/*", *arguments)
    text = result.stdout.str()
    shown = re.findall(r"^SAF-1 on (\S+)\s+undecided", text, re.MULTILINE)
    assert len(set(shown)) == (103 if verbose else 0)
    assert "(the worst of 103 cases)" in " ".join(text.split())
    assert ("and 3 cases more: " in text) is not verbose
    assert "gate: failed, 103 undecided" in text
    assert result.ret == 1
