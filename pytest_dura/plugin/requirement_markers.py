"""The marker ``requirement``: which requirements a test names."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, get_args

import pytest

from pytest_dura.core.errors import ConfigurationError

if TYPE_CHECKING:
    from pytest_dura.plugin.session import DuraSession
    from pytest_dura.requirements.model import Requirement


def marked_requirements(session: DuraSession, node: pytest.Item) -> list[Requirement]:
    """The requirements that a test's markers name, the closest first.

    Raises:
        ConfigurationError: For a marker that cannot be used, and a requirement without a text.
    """
    return [_requirement(session, marker) for marker in node.iter_markers("requirement")]


def _requirement(session: DuraSession, marker: pytest.Mark) -> Requirement:
    from pytest_dura.campaign.problems import did_you_mean
    from pytest_dura.requirements.model import Kind, Requirement

    given = marker_arguments(marker, _requirement_marker)
    name = given["id"]
    if not isinstance(name, str) or not name:
        raise ConfigurationError(
            "the id of a requirement is a text",
            key="pytest.mark.requirement",
            found=name,
            expected='an id such as "SAF-1"',
            remedy="correct the id; several requirements take one marker each",
        )
    known = session.library().requirements
    if name in known:
        _check_same(known[name], given)
        return known[name]
    if given["text"] is None:
        raise ConfigurationError(
            f"the requirement {name!r} has no text",
            key="pytest.mark.requirement",
            found=name,
            expected="a requirement of the files, or a text in the marker",
            remedy=did_you_mean(name, known)
            + f' Or say what it asks for: requirement("{name}", text="...")',
        )
    kind: Any = "safety" if given["kind"] is None else given["kind"]
    if kind not in get_args(Kind):
        raise ConfigurationError(
            f"there is no kind of requirement {kind!r}",
            key="pytest.mark.requirement",
            found=kind,
            expected="one of " + ", ".join(get_args(Kind)),
            remedy="correct the kind",
        )
    source = "" if given["source"] is None else str(given["source"])
    requirement = Requirement(name, str(given["text"]), kind, source)
    before = session.marked.setdefault(name, requirement)
    if before != requirement:
        raise _said_twice(name, "another marker", before.text, requirement.text)
    return requirement


def _check_same(known: Requirement, given: Mapping[str, Any]) -> None:
    """Refuse a marker that gives a requirement of the files another meaning."""
    for key in ("text", "kind", "source"):
        own, value = getattr(known, key), given[key]
        if value is not None and str(value).split() != own.split():
            raise _said_twice(known.id, "a requirement file", own, value)


def _said_twice(name: str, where: str, before: str, found: Any) -> ConfigurationError:
    return ConfigurationError(
        f"the marker gives the requirement {name!r} another meaning than {where}",
        key="pytest.mark.requirement",
        found=found,
        expected=before,
        remedy=f'name it alone, requirement("{name}"), or give the test an id of its own',
    )


def _requirement_marker(
    id: Any,  # noqa: A002 - the marker is written so
    text: Any = None,
    kind: Any = None,
    source: Any = None,
) -> None:
    """The signature of the marker ``requirement``."""


def marker_arguments(marker: pytest.Mark, signature: Any) -> dict[str, Any]:
    """The marker's arguments by name, defaults filled in."""
    known = inspect.signature(signature)
    try:
        bound = known.bind(*marker.args, **marker.kwargs)
    except TypeError as error:
        from pytest_dura.campaign.problems import did_you_mean

        wrong = sorted(set(marker.kwargs) - set(known.parameters))
        remedy = did_you_mean(wrong[0], known.parameters) if wrong else "add what is missing"
        raise ConfigurationError(
            f"the marker {marker.name} cannot be used: {error}",
            key=f"pytest.mark.{marker.name}",
            found=", ".join([*map(repr, marker.args), *sorted(marker.kwargs)]) or "nothing",
            expected=f"{marker.name}({', '.join(known.parameters)})",
            remedy=remedy,
        ) from None
    bound.apply_defaults()
    return dict(bound.arguments)
