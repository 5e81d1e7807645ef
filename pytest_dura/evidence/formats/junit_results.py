"""What a JUnit file says of requirements, read back without the code that wrote it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from xml.etree import ElementTree as ET

from pytest_dura.evidence import text
from pytest_dura.requirements.verdicts.campaigns import CAMPAIGN_STATUSES
from pytest_dura.requirements.verdicts.episodes import EPISODE_STATUSES

Key = tuple[str, str, str]
"""Case, requirement, and node id of the test; see :func:`junit_key`."""


def junit_key(case: str, requirement: str, item: str) -> Key:
    """The key under which a verdict of the record stands in a JUnit file, whatever the names."""
    return junit_name(case), junit_name(requirement), junit_name(item)


def junit_name(name: str) -> str:
    """A name as it stands in the file: on one line, bounded, and unlike every other name."""
    return text.name(name, 400)


def junit_verdicts(xml: str) -> dict[Key, tuple[str, ...]]:
    """The words of all verdicts on campaigns, sorted; a test may ask several questions.

    Raises:
        ValueError: If it is no JUnit file, has a document type, or a verdict of another word.
    """
    found: dict[Key, list[str]] = {}
    for item, group in _groups(xml):
        word = group.get("verdict")
        if word is not None:
            found.setdefault(_key(item, group), []).append(_one_of(CAMPAIGN_STATUSES, word, item))
    return {key: tuple(sorted(words)) for key, words in found.items()}


def junit_outcomes(xml: str) -> dict[Key, Counter[str]]:
    """How many tests on one episode came to which word, by test function without parameters.

    Raises:
        ValueError: As :func:`junit_verdicts`.
    """
    found: dict[Key, Counter[str]] = {}
    for item, group in _groups(xml):
        word = group.get("episode_verdict")
        if word is not None:
            key = _key(item.partition("[")[0], group)
            found.setdefault(key, Counter())[_one_of(EPISODE_STATUSES, word, item)] += 1
    return found


def _key(item: str, group: Mapping[str, str]) -> Key:
    return group.get("case", ""), group["requirement"], item


def _one_of(words: tuple[str, ...], word: str, item: str) -> str:
    if word not in words:
        raise ValueError(f"{item} has the verdict {word!r}, which is none of {', '.join(words)}")
    return word


def _groups(xml: str) -> Iterator[tuple[str, dict[str, str]]]:
    """Node id and properties for each requirement of each test; a group begins with its id."""
    found: dict[str, list[dict[str, str]]] = {}
    for test in _parsed(xml).iter("testcase"):
        item, groups = "", []
        for one in test.iterfind("properties/property"):
            name, value = one.get("name", ""), one.get("value", "")
            if name == "item":
                item = value
            elif name == "requirement":
                groups.append({name: value})
            elif groups:
                groups[-1][name] = value
        found[item] = groups  # the last attempt knows of those before it
    for item, groups in found.items():
        for group in groups:
            yield item, group


class _NoDoctype(ET.TreeBuilder):
    """Refuses a document type, without which there are no entities that expand or lead outside."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:  # noqa: ARG002 - the parser's call
        raise ValueError("the JUnit file has a document type, which none of pytest's has")


def _parsed(xml: str) -> ET.Element:
    parser = ET.XMLParser(target=_NoDoctype())  # noqa: S314 - see _NoDoctype
    try:
        parser.feed(xml.encode("utf-8"))
        root: ET.Element = parser.close()
    except (ET.ParseError, UnicodeEncodeError) as error:
        raise ValueError(f"the JUnit file is no XML: {error}") from None
    if root.tag not in ("testsuites", "testsuite"):
        raise ValueError(f"the root is <{root.tag}>, and a JUnit file has <testsuites>")
    return root
