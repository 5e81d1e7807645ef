"""Earlier looks: verdicts on a rate that earlier sessions came to, on the same component and case.

The confidence of a bound holds for one look. A new plan on a fresh seed is another one, and the
more there are, the likelier one of them supports a rate that does not hold. So a session notes
those of the evidence that it replaces, which has noted the ones before, and those of its baseline.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.evidence.bundle import RECORD_FILE
from pytest_dura.evidence.files import read_head
from pytest_dura.evidence.model import RecordHead, SessionRecord
from pytest_dura.evidence.verdict_model import LookEntry, VerdictEntry

if TYPE_CHECKING:
    from pytest_dura.evidence.baseline import Baseline

MAX_LOOKS = 1000
"""Looks that a record keeps, the latest ones."""


def earlier_looks(directory: Path, baseline: Baseline | None) -> list[LookEntry]:
    """List the looks of the evidence in a directory, which is to be replaced, and of a baseline.

    Evidence that cannot be read, or is of another version, has none; the session that replaces it
    says so where that matters.
    """
    try:
        looks = list(_looks_of(read_head(directory / RECORD_FILE)))
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        looks = []
    if baseline is not None:
        about = {"created": baseline.created, "base_seed": baseline.base_seed}
        digests = {baseline.component.get("name"): baseline.component.get("digest")}
        looks += [_look(about, vars(claim), digests) for claim in baseline.claims if claim.run]
    distinct = {look.to_json(exclude={"created"}).__repr__(): look for look in looks}
    return list(distinct.values())[-MAX_LOOKS:]


def _looks_of(head: Mapping[str, Any]) -> Iterator[LookEntry]:
    """Yield the looks of a recorded session, those that it knows of first."""
    yield from map(LookEntry.model_validate, head.get("looks", ()))
    first = head["component_under_test"]
    components = (first, *(first.get("others") or ()))
    digests = {component["name"]: component["digest"] for component in components}
    for verdict in head["verdicts"]:
        if verdict["bound"]["at_most"] is not None and verdict["run"]:
            yield _look(head, verdict, digests)


def _look(
    session: Mapping[str, Any], verdict: Mapping[str, Any], digests: Mapping[Any, Any]
) -> LookEntry:
    counts = ("requirement", "case", "component", "planned", "episodes", "violations")
    return LookEntry.model_validate(
        {key: session[key] for key in ("created", "base_seed")}
        | {key: verdict[key] for key in counts}
        | {"digest": digests.get(verdict["component"])}
    )


def further_looks(record: SessionRecord) -> Iterator[tuple[VerdictEntry, list[LookEntry]]]:
    """Yield each verdict on a rate before which others looked at the same component and case.

    The same seed with as many planned runs is the same look.
    """
    digests, by_question = _digests(record.head), dict[tuple[str | None, ...], list[LookEntry]]()
    for look in record.head.looks or ():
        question = look.requirement, look.case, look.component, look.digest
        by_question.setdefault(question, []).append(look)
    for verdict in record.head.verdicts:
        if verdict.bound.at_most is None:
            continue
        digest = digests.get(verdict.component)
        asked = verdict.requirement, verdict.case, verdict.component, digest
        this = record.head.base_seed, verdict.planned
        earlier = [
            look for look in by_question.get(asked, ()) if (look.base_seed, look.planned) != this
        ]
        if earlier:
            yield verdict, earlier


def _digests(head: RecordHead) -> Mapping[str, str | None]:
    """Digests of the components under test, by name."""
    first = head.component_under_test
    return {str(component.name): component.digest for component in (first, *(first.others or ()))}
