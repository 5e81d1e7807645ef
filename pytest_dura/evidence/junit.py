"""JUnit files: verdicts read back without the code that wrote them, compared with the record."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from pytest_dura.evidence import text
from pytest_dura.requirements.campaign_verdicts import CAMPAIGN_STATUSES
from pytest_dura.requirements.episode_verdicts import EPISODE_STATUSES

if TYPE_CHECKING:
    from pytest_dura.evidence.model import SessionRecord

JunitKey = tuple[str, str, str]
"""Case, requirement, and node id of the test; see :func:`junit_key`."""


def junit_key(case: str, requirement: str, item: str) -> JunitKey:
    """Make the key under which a verdict of the record is in a JUnit file."""
    return junit_name(case), junit_name(requirement), junit_name(item)


def junit_name(name: str) -> str:
    """Write a name as in the file: on one line, bounded, and unlike every other name."""
    return text.name(name, 400)


def junit_verdicts(
    xml: str, repeated: Mapping[str, str] = MappingProxyType({})
) -> dict[JunitKey, tuple[str, ...]]:
    """Read the statuses of all verdicts on campaigns, sorted; a test may have several.

    Args:
        xml: The file.
        repeated: First of the items that repeat one test, by the node ids of all of them; of what
            these came to, the worst counts.

    Raises:
        ValueError: If it is no JUnit file, has a document type, or an unknown verdict.
    """
    statuses: dict[JunitKey, dict[str, list[str]]] = {}
    for item, group in _requirement_groups(xml):
        verdict = group.get("verdict")
        if verdict is not None:
            key = _result_key(repeated.get(item, item), group)
            statuses.setdefault(key, {}).setdefault(item, []).append(
                _checked_status(CAMPAIGN_STATUSES, verdict, item)
            )
    worst = partial(min, key=("violated", "undecided", "supported").index)
    return {
        key: tuple(sorted(map(worst, zip(*by_item.values(), strict=False))))
        for key, by_item in statuses.items()
    }


def junit_outcomes(
    xml: str, repeated: Mapping[str, str] = MappingProxyType({})
) -> dict[JunitKey, Counter[str]]:
    """Count the statuses of tests on single episodes, by test function without parameters.

    Args:
        xml: The file.
        repeated: As for :func:`junit_verdicts`.

    Raises:
        ValueError: As :func:`junit_verdicts`.
    """
    statuses: dict[JunitKey, dict[str, str]] = {}
    for item, group in _requirement_groups(xml):
        episode_verdict = group.get("episode_verdict")
        if episode_verdict is not None:
            status = _checked_status(EPISODE_STATUSES, episode_verdict, item)
            known = statuses.setdefault(_result_key(item.partition("[")[0], group), {})
            first = repeated.get(item, item)
            known[first] = min(known.get(first, status), status, key=_WORST_FIRST.index)
    return {key: Counter(by_item.values()) for key, by_item in statuses.items()}


_WORST_FIRST = ("violated", "missing", "open", "invalid", "satisfied")


def _result_key(item: str, group: Mapping[str, str]) -> JunitKey:
    return group.get("case", ""), group["requirement"], item


def _checked_status(statuses: tuple[str, ...], status: str, item: str) -> str:
    if status not in statuses:
        raise ValueError(
            f"{item} has the verdict {status!r}, which is none of {', '.join(statuses)}"
        )
    return status


def _requirement_groups(xml: str) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield node id and properties for each requirement of each test."""
    groups_of: dict[str, list[dict[str, str]]] = {}
    for test in _parse_xml(xml).iter("testcase"):
        item, groups = "", []
        for entry in test.iterfind("properties/property"):
            name, value = entry.get("name", ""), entry.get("value", "")
            if name == "item":
                item = value
            elif name == "requirement":
                groups.append({name: value})  # a group begins with the requirement's id
            elif groups:
                groups[-1][name] = value
        groups_of[item] = groups  # the last attempt includes those before it
    for item, groups in groups_of.items():
        for group in groups:
            yield item, group


class _NoDoctype(ET.TreeBuilder):
    """Refuses a document type, without which there are no entities that expand or lead outside."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:  # noqa: ARG002 - the parser's call
        raise ValueError("the JUnit file has a document type, which none of pytest's has")


def _parse_xml(xml: str) -> ET.Element:
    parser = ET.XMLParser(target=_NoDoctype())  # noqa: S314 - see _NoDoctype
    try:
        parser.feed(xml.encode("utf-8"))
        root: ET.Element = parser.close()
    except (ET.ParseError, UnicodeEncodeError) as error:
        raise ValueError(f"the JUnit file is no XML: {error}") from None
    if root.tag not in ("testsuites", "testsuite"):
        raise ValueError(f"the root is <{root.tag}>, and a JUnit file has <testsuites>")
    return root


def junit_problems(record: SessionRecord, file: Path) -> Iterator[str]:
    """Yield the differences between the file and the record.

    An undecided verdict may be missing in the file, as the item of a worker that died reports
    nothing. It may be decided in the file: that two runs of an episode differ is known at the end.
    """
    try:
        xml = file.read_text(encoding="utf-8")
        repeated = {
            junit_name(judgement.item): junit_name(judgement.recorded_as)
            for judgement in record.head.judgements
            if judgement.recorded_as
        }
        stated, outcomes = junit_verdicts(xml, repeated), junit_outcomes(xml, repeated)
    except (OSError, ValueError, LookupError) as error:
        yield f"{file.name}: cannot be read back ({type(error).__name__}: {error})"
        return
    held: dict[JunitKey, list[str]] = defaultdict(list)
    for verdict in record.head.verdicts:
        key = junit_key(verdict.case, verdict.requirement, verdict.item)
        name = f"{file.name}: {verdict.requirement} on {verdict.case}"
        if key in outcomes:
            violated, run = outcomes[key]["violated"], outcomes[key].total()
            if (violated, run) != (verdict.violations, verdict.run):
                yield (
                    f"{name}: {violated} of {run} violated it, and the record says "
                    f"{verdict.violations} of {verdict.run}"
                )
        else:
            held[key].append(verdict.verdict)
    for key in sorted({*stated, *held}):
        in_file, recorded = stated.get(key, ()), sorted(held.get(key, []))
        decided = [status for status in recorded if status != "undecided"]
        unmatched = list(in_file)
        for status in decided:
            if status in unmatched:
                unmatched.remove(status)
            else:
                yield f"{file.name}: {key[1]} on {key[0]} is {status} in the record, and not here"
        if len(unmatched) > recorded.count("undecided"):
            yield f"{file.name}: {key[1]} on {key[0]} is {unmatched[0]}, and not in the record"
        elif "violated" in unmatched:
            yield f"{file.name}: {key[1]} on {key[0]} is violated, and undecided in the record"
