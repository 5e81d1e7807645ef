"""The marker ``falsify``: a search runs before the test's own body, and fails the test."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError, DuraError
from pytest_dura.plugin.requirement_markers import marker_arguments

if TYPE_CHECKING:
    from pytest_dura.plugin.session import DuraSession

NAME = "falsify"


def check_falsify(session: DuraSession, definition: pytest.Item) -> None:
    """Refuse a marker that would search nothing, or cannot be read.

    Raises:
        ConfigurationError: For a test that has no campaign, several markers, and a formula that
            cannot be used.
    """
    markers = list(definition.iter_markers(NAME))
    if not markers:
        return
    fixtures = getattr(definition, "fixturenames", ())
    if definition.get_closest_marker("dura") is None or "campaign" not in fixtures:
        raise ConfigurationError(
            f"the marker {NAME} searches nothing, since the test looks at no campaign",
            key=f"pytest.mark.{NAME}",
            found="no marker `dura` with the fixture `campaign`",
            expected="both of them, which say what is searched",
            remedy='add @pytest.mark.dura(scenario="...") and the argument `campaign`',
        )
    if len(markers) > 1:
        raise ConfigurationError(
            f"the test has several markers {NAME}, of which one alone would count",
            key=f"pytest.mark.{NAME}",
            found=f"{len(markers)} markers",
            expected="one marker",
            remedy=f'name all requirements in one: {NAME}(["SAF-1", "SAF-2"])',
        )
    wanted = marker_arguments(markers[0], _falsify_marker)["requirement"]
    for text in wanted if isinstance(wanted, (list, tuple)) else [wanted]:
        if isinstance(text, str) and text not in session.library().requirements:
            _check_formula(text)


def _check_formula(text: str) -> None:
    from pytest_dura.campaign.search.campaigns import is_formula
    from pytest_dura.requirements.checks import read_formula

    if is_formula(text):
        read_formula(text)


def run_marked_search(item: pytest.Function) -> None:
    """Search as the test's marker says, if it has one, and fail the test by what is found."""
    __tracebackhide__ = True
    marker = item.get_closest_marker(NAME)
    if marker is None:
        return
    given = marker_arguments(marker, _falsify_marker)
    campaign: Any = item.funcargs["campaign"]
    wanted = given.pop("requirement")
    try:
        campaign.falsify(wanted, **{key: one for key, one in given.items() if one is not None})
    except DuraError as error:
        # No line of the test has run, so that there is none to show.
        pytest.fail(str(error), pytrace=False)


def _falsify_marker(
    requirement: Any = None,
    *,
    budget: Any = None,
    faults: Any = None,
    at_most: Any = None,
    shrink: Any = None,
    seed: Any = None,
) -> None:
    """The signature of the marker ``falsify``."""
