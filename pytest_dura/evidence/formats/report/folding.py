"""Folding: of many cases that passed the report shows some, and counts the rest."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

from pytest_dura.evidence.record.session_record import SessionRecord

Data = Mapping[str, Any]
Key = tuple[str, str]
"""Id of a case, and the component's name."""

MOST = 1000
"""Cases of which there is nothing to tell that have rows of their own."""


def folded_cases(record: SessionRecord) -> frozenset[Key]:
    """The cases that have no rows of their own, by id and component: the last of too many.

    Those alone of which there is nothing to tell: each of their requirements is judged, and
    supported at the first attempt without a waiver or any violation; every planned episode was run
    and is valid, and none collided. Whatever else is there is shown, however much it is.
    """
    judged: dict[Key, list[Data]] = defaultdict(list)
    for verdict in record["verdicts"]:
        judged[verdict["case"], verdict["component"]].append(verdict)
    plain = [
        key
        for case in record["cases"]
        if _is_plain(case, judged.get(key := (case["id"], case["component"]), []))
    ]
    return frozenset(plain[MOST:])


def apart(rows: Iterable[Data], folded: frozenset[Key], case: str = "case") -> tuple[Any, Any]:
    """Rows that are shown, and those of folded cases.

    Args:
        rows: Each with its component, and its case under the key ``case``.
        folded: Of :func:`folded_cases`.
        case: That key.
    """
    shown: list[Data] = []
    rest: list[Data] = []
    for row in rows:
        (rest if (row[case], row["component"]) in folded else shown).append(row)
    return shown, rest


def _is_plain(case: Data, verdicts: list[Data]) -> bool:
    metrics = case["metrics"]
    collided = metrics["collided"]
    told = case["missing_runs_total"] or metrics["invalid"] or metrics["missing"]
    if told or (collided and collided["run"]):
        return False
    if case["without"]:  # a reference arm, the verdicts stand on the case it belongs to
        return not verdicts
    names = {one["requirement"] for one in verdicts}
    return bool(verdicts) and names.issuperset(case["requirements"]) and all(map(_passed, verdicts))


def _passed(verdict: Data) -> bool:
    against = (
        "violations", "open", "without_effect", "invalid", "missing", "waiver", "attempts",
        "counterexamples",
    )  # fmt: skip
    return verdict["verdict"] == "supported" and not any(verdict[key] for key in against)
