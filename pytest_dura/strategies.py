"""Hypothesis strategies for cases: what a scenario varies, and faults of the catalogue.

A property test needs ``@given(case=strategies.cases("intersection/congested"))`` and the
session-scoped fixture ``run_episode``. Names are looked up when values are first drawn, among the
scenarios of the pytest session, else among the built-in ones.

**How examples shrink.** Hypothesis prefers the shorter of two sequences of choices, and of two that
are as long the first in the order of choices. For a case, whole numbers whose simplest value is 0
are drawn, always equally many for the same scenario: a number without a meaning, such as a
parameter of a fault that is not there, is drawn from 0 to 0. So no choice moves another one, and
the order of the choices is the order of simplicity:

1. which faults there are: fewer; then which parts of the case are left out, its own faults and
   entries of its world such as vehicles: more; and which types the faults are of: earlier ones;
2. when each fault begins: later; how long it lasts: shorter;
3. the magnitudes of the faults: nearer to where they change nothing, on a coarse grid;
4. what the scenario varies: nearer to the scenario's own value, on a coarse grid;
5. all of these numbers again: fewer digits (see :class:`pytest_dura.search.drawing.NumberScale`);
6. the seed of the episode.

Importing this module loads the profile ``dura``; see :func:`load_profile`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from hypothesis import HealthCheck, Phase, event, reject, settings
from hypothesis import strategies as st
from hypothesis.errors import InvalidArgument

from pytest_dura.core.errors import ConfigurationError

if TYPE_CHECKING:
    from pytest_dura.library.cases import Case, SearchedCase
    from pytest_dura.library.fault_campaigns import FaultCampaign
    from pytest_dura.library.loading import Library
    from pytest_dura.library.scenario import Scenario
    from pytest_dura.search.drawing import CaseDrawing


__all__ = ["PROFILE", "cases", "fault_campaigns", "faults", "load_profile", "scenarios"]

PROFILE = "dura"

T = TypeVar("T")


def cases(
    name: str,
    faults: FaultCampaign | Sequence[FaultCampaign] = (),
    *,
    at_most: int = 1,
    leave_out: bool = True,
) -> st.SearchStrategy[SearchedCase]:
    """Draw cases in which everything is fixed, a seed for the episode included.

    Args:
        name: A scenario, a case such as ``intersection/nominal+ghost-obstacle``, or a glob.
        faults: Faults that may be added: names and globs of the catalogue, ``catalogue``, names of
            the scenario's own faults, and faults as data.
        at_most: How many of them may act together.
        leave_out: Whether faults and entries of the scenario itself may be left out, which happens
            once in eight times, and whenever the test fails without them as well.

    Raises:
        ConfigurationError: When a value is drawn: for a name or fault that is not known, and where
            nothing can differ.
    """

    def drawings(library: Library) -> list[CaseDrawing]:
        from pytest_dura.search.drawing import CaseDrawing

        return [
            CaseDrawing.of(case, _entries(faults), at_most=at_most, leave_out=leave_out)
            for case in _named(library, name)
        ]

    return _drawn_case(_once_per_library(drawings))


def scenarios(name: str = "*", *, leave_out: bool = True) -> st.SearchStrategy[Scenario]:
    """Draw scenarios without variation, each with a seed; no faults are added.

    Args:
        name: A scenario or a glob.
        leave_out: See :func:`cases`.

    Raises:
        ConfigurationError: When a value is drawn, for a name that is not known.
    """
    return cases(name, leave_out=leave_out).map(lambda case: case.scenario)


def faults(*types: FaultCampaign, scenario: str) -> st.SearchStrategy[dict[str, Any]]:
    """Draw faults as plain data, as in a scenario file.

    Args:
        types: Names and globs of the catalogue, and faults as data; by default all of the
            catalogue that fit.
        scenario: Gives the domain and the duration.

    Raises:
        ConfigurationError: When a value is drawn, for a name that is not known.
    """
    campaigns = fault_campaigns(scenario, types or ("catalogue",), at_least=1, at_most=1)
    return campaigns.map(lambda campaign: campaign[0])


def fault_campaigns(
    scenario: str,
    types: FaultCampaign | Sequence[FaultCampaign] = ("catalogue",),
    *,
    at_least: int = 0,
    at_most: int = 2,
) -> st.SearchStrategy[list[dict[str, Any]]]:
    """Draw faults that act together, each as plain data.

    Args:
        scenario: Gives the domain and the duration.
        types: Which faults; see :func:`faults`.
        at_least: Least number of faults.
        at_most: Greatest number of faults.

    Raises:
        ConfigurationError: When a value is drawn, for a name that is not known.
    """

    def drawings(library: Library) -> list[CaseDrawing]:
        from pytest_dura.search.drawing import CaseDrawing

        case = _named(library, scenario)[0].without_faults()
        numbers = {"at_least": at_least, "at_most": at_most}
        return [CaseDrawing.of(case, _entries(types), **numbers, leave_out=False)]

    return _drawn_case(_once_per_library(drawings)).map(_planned)


def _planned(case: SearchedCase) -> list[dict[str, Any]]:
    """Return the case's faults as in a scenario file, each with its id."""
    return [fault.in_file() for fault in case.faults]


@st.composite
def _drawn_case(draw: st.DrawFn, drawings: Callable[[], list[CaseDrawing]]) -> SearchedCase:
    """Draw a case from one of the drawings; contradictory values are rejected."""

    def pick(count: int) -> int:
        return draw(st.integers(0, count - 1))

    choices = drawings()
    drawing = choices[pick(len(choices))]
    try:
        return drawing.draw(pick)
    except ConfigurationError as error:
        event(f"values that contradict each other: {error.problem}")
        reject()


def _once_per_library(function: Callable[[Library], T]) -> Callable[[], T]:
    """Call the function with the library in use, again only once that is another one."""
    last: tuple[Library, T] | None = None

    def result() -> T:
        from pytest_dura.library.loading import current_library

        nonlocal last
        library = current_library()
        if last is None or last[0] is not library:
            last = library, function(library)
        return last[1]

    return result


def _named(library: Library, name: str) -> list[Case]:
    from pytest_dura.library.cases import expand_cases

    if name in library.scenarios:  # all cases of it, and not the one of that id alone
        return expand_cases([library.scenarios[name]], read=library.faults)
    return expand_cases(library.scenarios, select=[name], read=library.faults)


def _entries(faults: FaultCampaign | Sequence[FaultCampaign]) -> Sequence[FaultCampaign]:
    return [faults] if isinstance(faults, (str, Mapping)) else list(faults)


def load_profile() -> None:
    """Register the Hypothesis profile ``dura``, and load it in place of Hypothesis' own.

    It is derived from the loaded profile, ``default`` or ``ci``: no deadline, since an episode may
    take long; no ``explain`` phase, which traces every line of a simulation and runs more of them;
    the blob that repeats a failure is printed; and drawing may be slow, as the first draw reads the
    scenarios. Other settings stay, such as the ``derandomize`` of ``ci``.

    A profile of the user's own stays loaded, as do settings within which this module is imported.
    Such a profile can be derived from ``settings.get_profile("dura")``.
    """
    name = settings.get_current_profile_name()
    own = settings.get_profile(name)
    if name.partition("-with-")[0] not in ("default", "ci") or settings.default != own:
        return
    try:
        settings.get_profile(PROFILE)
    except InvalidArgument:  # no profile of this name is registered
        derived = settings(
            own,
            deadline=None,
            phases=[phase for phase in own.phases if phase is not Phase.explain],
            print_blob=True,
            suppress_health_check={*own.suppress_health_check, HealthCheck.too_slow},
        )
        settings.register_profile(PROFILE, derived)
    settings.load_profile(PROFILE)


load_profile()
