"""The goal on runtime monitors, which can be false.

The alarms of a monitor are held against the violations that it could have missed, in runs where
recovery did not act. A monitor that raises alarms as often without a violation as with one tells
nothing, and one that never raised any before a violation is of no use: both defeat their goals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from pytest_dura.evidence.text import counted, name
from pytest_dura.reports.gsn.element import Element, derived_id
from pytest_dura.reports.verdicts import part_text
from pytest_dura.requirements.comparison import compare_counts
from pytest_dura.requirements.monitoring.quality import FAULTS, MonitorQuality
from pytest_dura.requirements.rate_tests import lower_bound

MONITORS_ID = "GMonitors"
_CONFIDENCE = 0.95
_URL = "evidence.json#/monitors"


def monitor_elements(rows: Sequence[MonitorQuality]) -> Iterator[Element]:
    """The goal on all monitors, and below it one for each monitor and what it is to warn of."""
    groups: dict[tuple[str, str, str], list[MonitorQuality]] = {}
    for row in rows:
        groups.setdefault((row.component, row.monitor, row.target), []).append(row)
    if not groups:
        return
    several = len({component for component, _, _ in groups}) > 1
    below = [_elements_of(key, own, several=several) for key, own in groups.items()]
    challenges = [element.id for own in below for element in own if element.challenges]
    yield Element(
        MONITORS_ID,
        "Alarms of each runtime monitor tell runs with what it is to warn of from runs without, "
        "where recovery does not act. No verdict rests on this.",
        supported_by=tuple(own[0].id for own in below),
        defeated=bool(challenges),
        url=_URL,
        alias="monitors",
    )
    if challenges:
        failed = counted(len(challenges), "monitor and target", "monitors and targets")
        yield Element(
            "CGMonitors",
            f"{failed} of {len(below)} do not: see the counter goals below.",
            supported_by=tuple(challenges),
            challenges=MONITORS_ID,
            alias="challenge:monitors",
        )
    for own in below:
        yield from own


def _elements_of(
    key: tuple[str, str, str], rows: list[MonitorQuality], *, several: bool
) -> list[Element]:
    """The goal on a monitor, and the counts that support, refute or do not decide it."""
    component, monitor, target = key
    hits = sum(row.true_positives for row in rows)
    positives = hits + sum(row.false_negatives for row in rows)
    alarms = sum(row.false_positives for row in rows)
    negatives = alarms + sum(row.true_negatives for row in rows)
    what = "a manifested fault" if target == FAULTS else f"a violation of {name(target)}"
    warned = "detected" if target == FAULTS else "warned of"
    claim = f"Alarms of {name(monitor)} tell runs with {what} from runs without."
    counts = "; ".join(
        [
            *([f"{warned} {hits} of {positives}"] if positives else []),
            *([f"alarms in {alarms} of {negatives} runs without"] if negatives else []),
            f"{counted(len(rows), 'case')}",
        ]
    )
    status, why = _status(hits, positives, alarms, negatives)
    if status == "supported":
        least = lower_bound(hits, positives, _CONFIDENCE)
        claim += (
            f" It {warned} at least {part_text(least)} of these, with {part_text(_CONFIDENCE)} "
            "confidence."
        )
    elif status == "undecided":
        claim += f" Not shown: {why} ({counts})."

    def made(prefix: str, text: str, **more: Any) -> Element:
        id_ = derived_id(prefix, monitor, target, what="monitor", apart=apart)
        return Element(id_, text, url=_URL, layers={"monitor": status}, **more)

    apart = (component,) if several else ()
    brief = ("monitors", f"{hits} of {positives}", f"{alarms} of {negatives}")
    text = f"Table of monitors in evidence.json: {counts}."
    support = [made("Sn", text, brief=brief)] if status != "undecided" else []
    challenge = []
    if status == "violated":
        against = made("CSn", text, brief=brief)
        challenge = [
            made(
                "CG",
                f"{name(monitor)} {why} ({counts}).",
                supported_by=(against.id,),
                challenges=derived_id("G", monitor, target, what="monitor", apart=apart),
            ),
            against,
        ]
    goal = made(
        "G",
        claim,
        supported_by=tuple(element.id for element in support),
        undeveloped=status == "undecided",
        defeated=bool(challenge),
        alias=f"monitor:{name(monitor)}:{name(target)}",
    )
    return [goal, *support, *challenge]


def _status(hits: int, positives: int, alarms: int, negatives: int) -> tuple[str, str]:
    """Whether alarms tell runs apart, and if not, why."""
    if positives and not hits:
        return "violated", f"raised no alarm in time in any of {positives} runs"
    if not positives:
        return "undecided", "nothing happened that it could have missed"
    if not negatives:
        return "undecided", "without a run that has nothing to warn of, precision says nothing"
    if hits * negatives <= alarms * positives:
        return "violated", "raises alarms as often where there is nothing to warn of"
    if compare_counts(hits, positives, alarms, negatives, _CONFIDENCE).p_worse > 1 - _CONFIDENCE:
        return "undecided", "these are too few runs"
    return "supported", ""
