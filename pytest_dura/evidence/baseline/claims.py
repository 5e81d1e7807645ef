"""Claims: what an evidence record says of each requirement on each case, ready to be compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pytest_dura.evidence.baseline.conditions import Conditions
from pytest_dura.evidence.record.session_record import SessionRecord

Data = Mapping[str, Any]
TOO_MANY = 10**9
"""Runs that no session has; the tests on counts work in floating point."""


@dataclass(frozen=True)
class Claim:
    """The counts of one verdict, and what they were counted on.

    Args:
        requirement: Id of the requirement.
        case: Id of the case.
        component: Name of the component under test.
        item: Node id of the test that asked.
        check: What was judged, a comparison of pairs included: the same text, the same question.
        method: How it was decided.
        confidence: One-sided confidence of the requirement.
        planned: Episodes that were planned.
        run: Episodes that were run.
        saved: Planned episodes that were not run because the verdict stood without them.
        episodes: Valid episodes.
        violations: Those that violated the requirement; an open one is not known to.
        violating: Numbers of the runs that violated it.
        conditions: Of the case's planned runs, by number.
    """

    requirement: str
    case: str
    component: str
    item: str
    check: str
    method: str
    confidence: float
    planned: int
    run: int
    saved: int
    episodes: int
    violations: int
    violating: frozenset[int]
    conditions: Mapping[int, Conditions]

    @property
    def seeds(self) -> list[int] | None:
        """The seeds of its runs, if all of them are valid: then each run's outcome is known."""
        runs = range(self.run)
        known = all(run in self.conditions for run in runs) and self.violating <= set(runs)
        if not known or self.run != self.episodes or len(self.violating) != self.violations:
            return None
        return [self.conditions[run].seed for run in runs]


def claims_of(record: SessionRecord) -> list[Claim]:
    """The claims of a record, in its order.

    Raises:
        AttributeError: For a damaged record, as those below.
        KeyError: See above.
        TypeError: See above.
        ValueError: See above.
    """
    requirements = {one["id"]: one for one in record["requirements"]}
    conditions: dict[tuple[str, str], dict[int, Conditions]] = {}
    for one in record.episodes():
        if one["planned"]:
            runs = conditions.setdefault((one["case"], one["component"]), {})
            runs.setdefault(_count(one["spec"]["run"]), Conditions.of(one["spec"]))
    return [_claim(one, requirements, conditions) for one in record["verdicts"]]


def _claim(
    verdict: Data,
    requirements: Mapping[str, Data],
    conditions: Mapping[tuple[str, str], Mapping[int, Conditions]],
) -> Claim:
    run, episodes, violations = (_count(verdict[key]) for key in ("run", "episodes", "violations"))
    if not violations <= episodes <= run:
        raise ValueError(f"{violations} violations, {episodes} valid and {run} run contradict")
    confidence = verdict["bound"]["confidence"]
    if not 0.5 < confidence < 1.0:
        raise ValueError(f"{confidence!r} is no confidence")
    requirement, case, component = (
        _text(verdict[key]) for key in ("requirement", "case", "component")
    )
    return Claim(
        requirement=requirement,
        case=case,
        component=component,
        item=_text(verdict["item"]),
        check=_check(verdict, requirements.get(requirement, {})),
        method=_text(verdict["method"]),
        confidence=confidence,
        planned=_count(verdict["planned"]),
        run=run,
        saved=_count(verdict["saved"]),
        episodes=episodes,
        violations=violations,
        violating=frozenset(
            _run(one["episode"]) for one in verdict["counterexamples"] if one["valid"]
        ),
        conditions=conditions.get((case, component), {}),
    )


def _check(verdict: Data, requirement: Data) -> str:
    """What was judged, in words. Of a test on single episodes it is the test's own code."""
    check = _text(verdict["check"])
    if not check:
        check = f"{_text(requirement.get('check', ''))} in {_text(verdict['item'])}".lstrip()
    if verdict["pairs"] is None:
        return check
    paired = verdict["paired"] or {}
    told = {key: paired.get(key) for key in ("measure", "change_at_most")}
    rest = [f"{key} {value}" for key, value in told.items() if value not in (None, "")]
    return ", ".join([check, f"pairs without {_text(verdict['pairs']['without'])}", *rest])


def _run(episode: Any) -> int:
    return int(_text(episode).rpartition("#")[2])


def _count(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < TOO_MANY:
        raise TypeError(f"{value!r} is no count")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is no text")
    return value
