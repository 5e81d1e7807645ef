"""Earlier looks: verdicts on a rate that earlier sessions came to, on the same component and case.

The confidence of a bound holds for one look. A new plan on a fresh seed is another one, and the
more there are, the likelier one of them supports a rate that does not hold. So a session notes
those of the evidence that it replaces, which has noted the ones before, and those of its baseline.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pytest_dura.evidence.files import read_head
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.verdict_model import LookEntry

MAX_LOOKS = 1000
"""Looks that a record keeps, the latest ones."""


def earlier_looks(files: Iterable[Path]) -> list[LookEntry]:
    """List the looks of earlier records: the one that is to be replaced, and that of a baseline.

    A record that cannot be read, or is of another version, has none; the session that replaces it
    says so where that matters.
    """
    looks = [look for file in files for look in _read_looks(file)]
    distinct = {json.dumps(look.to_json(exclude={"created"})): look for look in looks}
    return list(distinct.values())[-MAX_LOOKS:]


def _read_looks(file: Path) -> list[LookEntry]:
    try:
        return list(_looks_of(read_head(file)))
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return []


def _looks_of(head: Mapping[str, Any]) -> Iterator[LookEntry]:
    """Yield the looks of a recorded session, those that it knows of first."""
    yield from map(LookEntry.from_data, head.get("looks", ()))
    first = head["component_under_test"]
    components = (first, *(first.get("others") or ()))
    identities = {component["name"]: _identity(component) for component in components}
    counts = ("requirement", "case", "component", "check", "planned", "episodes", "violations")
    for verdict in head["verdicts"]:
        if verdict["bound"]["at_most"] is not None and verdict["run"]:
            yield LookEntry.from_data(
                {key: head[key] for key in ("created", "base_seed")}
                | {key: verdict[key] for key in counts}
                | {"identity": identities.get(verdict["component"], "")}
            )


def _identity(component: Mapping[str, Any]) -> str:
    """What makes a component another one: the digest of its code, and its parameters."""
    known = [component.get("digest"), component.get("params")]
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()


def further_looks(record: SessionRecord) -> Iterator[tuple[ItemVerdict, list[LookEntry]]]:
    """Yield each verdict on a rate before which others looked at the same question.

    That is the same requirement with the same check on a case of the same name, for a component of
    the same code and parameters. The same seed with as many planned runs is the same look.
    """
    if not record.head.looks:
        return
    by_question: dict[tuple[str, ...], list[LookEntry]] = {}
    for look in record.head.looks:
        question = look.requirement, look.case, look.component, look.check, look.identity
        by_question.setdefault(question, []).append(look)
    first = record.head.component_under_test
    identities = {
        str(component.name): _identity(component.to_json())
        for component in (first, *(first.others or ()))
    }
    for verdict in record.head.verdicts:
        if verdict.bound.at_most is None:
            continue
        identity = identities.get(verdict.component, "")
        asked = verdict.requirement, verdict.case, verdict.component, verdict.check, identity
        this = record.head.base_seed, verdict.planned
        earlier = [
            look for look in by_question.get(asked, ()) if (look.base_seed, look.planned) != this
        ]
        if earlier:
            yield verdict, earlier
