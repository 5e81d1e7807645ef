"""Panels of the page on what lies beside it: the assurance case as a tree, and the files."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from pytest_dura.evidence.bundle import FORMATS, RECORD_FILE, default_files
from pytest_dura.evidence.files import MANIFEST_FILE, REVIEW_FILE
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.reports.contents import EpisodeLinks, ReportContents, requirement_anchor
from pytest_dura.reports.gsn.argument import generated_argument
from pytest_dura.reports.gsn.element import Element, root_ids

Data = Mapping[str, Any]

# The assurance case.

_MAX_ELEMENTS = 2000
"""Elements of the tree; the files have all."""
_MAX_DEPTH = 24
_PAGE = "report.html"


@dataclass
class Branch:
    """An element with what supports and challenges it, as far as it is drawn.

    Args:
        element: The element.
        branches: Below it.
        contexts: Contexts, assumptions and justifications that it stands in.
        left_out: How many further elements support it.
    """

    element: Element
    branches: list[Branch] = field(default_factory=list)
    contexts: list[Element] = field(default_factory=list)
    left_out: int = 0

    @property
    def weight(self) -> int:
        """Rank among those beside it: counter-evidence first, then what is undeveloped."""
        kind = self.element.kind
        return 0 if kind.startswith("Counter") else 1 if self.element.undeveloped else 2


def argument_section(
    record: SessionRecord, _contents: ReportContents, _links: EpisodeLinks
) -> Data:
    """The tree of the argument, from the same elements as the files."""
    argument = generated_argument(record)
    # Elements on verdicts of folded cases lead to their requirement, since they have no row.
    requirements = {f"{_PAGE}#{requirement_anchor(each.id)}" for each in record.head.requirements}
    challenges: dict[str, list[str]] = {}
    for id_, element in argument.items():
        if element.challenges:
            challenged = element.challenges.partition(" -> ")[0].strip()
            challenges.setdefault(challenged, []).append(id_)
    nodes = {id_: element.to_yaml() for id_, element in argument.items()}
    tops = [id_ for id_ in root_ids(nodes) if not argument[id_].challenges] or list(argument)[:1]
    roots = [Branch(argument[id_]) for id_ in tops]
    seen = set(tops)
    left, left_out = _MAX_ELEMENTS, 0
    waiting = deque((root, 1) for root in roots)
    while waiting:  # level by level: what is left out lies deepest
        branch, depth = waiting.popleft()
        element = branch.element
        below = [
            id_ for id_ in (*challenges.get(element.id, ()), *element.supported_by)
            if id_ in argument and id_ not in seen
        ]  # fmt: skip
        taken = [id_ for id_ in below if not _is_folded(argument[id_], requirements)]
        taken = taken[: left if depth < _MAX_DEPTH else 0]
        left -= len(taken)
        seen.update(taken)
        branch.left_out = len(below) - len(taken)
        left_out += branch.left_out
        branch.contexts = [argument[id_] for id_ in element.in_context_of if id_ in argument]
        branch.branches = sorted((Branch(argument[id_]) for id_ in taken), key=lambda b: b.weight)
        waiting.extend((each, depth + 1) for each in branch.branches)
    return {"roots": roots, "left_out": left_out}


def _is_folded(element: Element, requirements: Collection[str]) -> bool:
    return "verdict" in element.layers and element.layers.get("report") in requirements


# The files of the bundle.

_PURPOSES: Mapping[str, str] = {
    RECORD_FILE: "the record: every figure of all other files follows from it",
    MANIFEST_FILE: "size and SHA-256 of each file; `python -m pytest_dura verify DIR` checks them",
    _PAGE: "this page",
    "summary.md": "the session in Markdown, for the page of a CI job or a pull request",
    "assurance-case.svg": "the argument as a picture in Goal Structuring Notation",
    "assurance-case.gsn.yaml": "the argument as data, for gsn2x and other tools",
    REVIEW_FILE: "the signed decision of a reviewer",
}


def files_section(record: SessionRecord, _contents: ReportContents, _links: EpisodeLinks) -> Data:
    """Every file of the bundle and what it is for; its own row of the list names each trace."""
    # Formats of other packages are not on every machine that renders the page again.
    names = [RECORD_FILE, *(name for name in default_files() if FORMATS.is_ours(name))]
    names += [MANIFEST_FILE, *([REVIEW_FILE] if record.review else [])]
    sizes = [each.trace.bytes for each in record.episodes() if each.trace is not None]
    return {
        "files": [(name, _PURPOSES.get(name, "")) for name in names],
        "traces": len(sizes),
        "bytes": sum(sizes),
    }
