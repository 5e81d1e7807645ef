"""Labels and links of our items for Allure, as the markers that allure-pytest reads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import pytest

from pytest_dura.evidence.text import name
from pytest_dura.plugin.item_results import target_of

if TYPE_CHECKING:
    from pytest_dura.campaign.cases import Case
    from pytest_dura.plugin.session import DuraSession
    from pytest_dura.requirements.model import Requirement

EPIC = "dependability"
LINK_TYPE = "requirement"
"""``--allure-link-pattern=requirement:https://example.org/{}`` makes links of ids."""
SEVERITIES = {
    "safety": "blocker",
    "security": "critical",
    "recovery": "critical",
    "performance": "normal",
}
_WORST_FIRST = ("blocker", "critical", "normal")
_SELECTIONS = ("epics", "features", "stories", "ids", "severities", "labels")
_OWN_CHOICE = ("epic", "feature", "story", "severity")


def wanted(config: pytest.Config) -> bool:
    """Whether Allure reports this session, or selects tests by their labels."""
    options = ("allure_report_dir", *(f"allure_{name}" for name in _SELECTIONS))
    return any(config.getoption(one, None) for one in options)


def mark_item(session: DuraSession, item: pytest.Item) -> None:
    """Give an item that uses the bench its labels and links; the test's own ones come first."""
    from pytest_dura.plugin.requirement_markers import marked_requirements

    own = {one.kwargs.get("label_type") for one in item.iter_markers("allure_label")}
    requirements = list({one.id: one for one in marked_requirements(session, item)}.values())
    target = target_of(item)
    for kind, value in _labels(requirements, None if target is None else target.case):
        if not (kind in _OWN_CHOICE and kind in own):
            item.add_marker(pytest.mark.allure_label(value, label_type=kind))
    for one in requirements:
        url = _url(session.config, one.id)
        item.add_marker(pytest.mark.allure_link(url, link_type=LINK_TYPE, name=name(one.id)))


def _labels(requirements: Sequence[Requirement], case: Case | None) -> Iterator[tuple[str, str]]:
    yield "epic", EPIC
    if case is not None:
        yield "feature", name(case.scenario.name)
        yield "story", name(story_of(case))
    kinds = list(dict.fromkeys(one.kind for one in requirements))
    if kinds:
        yield "severity", min(map(SEVERITIES.__getitem__, kinds), key=_WORST_FIRST.index)
    for kind in kinds:
        yield "tag", kind
    for one in requirements:
        yield "requirement", name(one.id)


def story_of(case: Case) -> str:
    """The fault campaign, and the roles that are switched off."""
    faults = " + ".join(str(fault["id"]) for fault in case.faults) or "no faults"
    return ", ".join([faults, *(f"without {role}" for role in case.without)])


def _url(config: pytest.Config, requirement: str) -> str:
    """The address by the user's pattern; an id is never an address or a scheme by itself."""
    quoted = quote(requirement, safe="", errors="replace")
    patterns: dict[str, Any] = dict(config.getoption("allure_link_pattern", None) or [])
    return str(patterns.get(LINK_TYPE, "{}")).replace("{}", quoted)
