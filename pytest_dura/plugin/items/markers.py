"""The markers ``dura``, ``requirement`` and ``falsify``: what they mean, and refusals."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from typing import TYPE_CHECKING, Any, get_args

import pytest

from pytest_dura.core.errors import ConfigurationError, DuraError, did_you_mean, error_at
from pytest_dura.core.text import indent_if_reserved
from pytest_dura.guests import guests
from pytest_dura.plugin.messages import error_text, failure_text
from pytest_dura.plugin.options import LONG_NAMES

if TYPE_CHECKING:
    from pytest_dura.library.cases import Case
    from pytest_dura.library.scenario import Scenario
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.requirements.model import Requirement


def marked_requirements(context: SessionContext, node: pytest.Item) -> list[Requirement]:
    """Return the requirements that a test's markers name, the closest first.

    Raises:
        ConfigurationError: For a marker that cannot be used, and a requirement without a text.
    """
    return [_requirement(context, marker) for marker in markers_of(node, "requirement")]


def markers_of(node: pytest.Item, name: str) -> list[pytest.Mark]:
    """List the markers of a name, the closest first, as pytest does, at a third of the cost."""
    found: list[pytest.Mark] = []
    at: pytest.Item | pytest.Collector | None = node
    while at is not None:
        found += [marker for marker in at.own_markers if marker.name == name]
        at = at.parent
    return found


def _requirement(context: SessionContext, marker: pytest.Mark) -> Requirement:
    """Return the requirement of a marker, which the items of a test share."""
    known = context.by_marker.get(id(marker))
    if known is None:
        known = context.by_marker[id(marker)] = marker, _read_requirement(context, marker)
    return known[1]


def _read_requirement(context: SessionContext, marker: pytest.Mark) -> Requirement:
    from pytest_dura.requirements.model import Kind, Requirement

    given = _marker_arguments(marker, _requirement_marker)
    name = given["id"]
    if not isinstance(name, str) or not name:
        raise ConfigurationError(
            "the id of a requirement is a text",
            key="pytest.mark.requirement",
            found=name,
            expected='an id such as "SAF-1"',
            remedy="correct the id; several requirements take one marker each",
        )
    known = context.library().requirements
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
    mitigates = given["mitigates"] or ()
    _check_mitigates(context, mitigates)
    requirement = Requirement(name, str(given["text"]), kind, source, mitigates=tuple(mitigates))
    earlier = context.marked.setdefault(name, requirement)
    if earlier != requirement:
        raise _conflicting_meaning(name, "another marker", earlier.text, requirement.text)
    return requirement


def _check_same(known: Requirement, given: Mapping[str, Any]) -> None:
    """Refuse a marker that gives a requirement of the files another meaning."""
    for key in ("text", "kind", "source"):
        known_value, value = getattr(known, key), given[key]
        if value is not None and str(value).split() != known_value.split():
            raise _conflicting_meaning(known.id, "a requirement file", known_value, value)
    mitigates = given["mitigates"]
    if mitigates is not None and list(mitigates) != list(known.mitigates):
        expected = f"mitigates {', '.join(known.mitigates) or 'no hazard'}"
        raise _conflicting_meaning(known.id, "a requirement file", expected, mitigates)


def _check_mitigates(context: SessionContext, names: Any) -> None:
    """Refuse what is no list of ids of hazards.

    Raises:
        ConfigurationError: Also for a hazard that no file has.
    """
    from pytest_dura.library.hazards import mitigation_errors

    if not isinstance(names, (list, tuple)) or not all(isinstance(name, str) for name in names):
        raise ConfigurationError(
            "`mitigates` is a list of ids of hazards",
            key="pytest.mark.requirement",
            found=names,
            expected='a list such as ["H-1"]',
            remedy="put the id in brackets",
        )
    for _, error in mitigation_errors(names, context.library().hazards):
        raise ConfigurationError(
            error.problem,
            key="pytest.mark.requirement",
            found=error.found,
            expected=error.expected,
            remedy=error.remedy,
        )


def _conflicting_meaning(name: str, where: str, earlier: str, given: Any) -> ConfigurationError:
    return ConfigurationError(
        f"the marker gives the requirement {name!r} another meaning than {where}",
        key="pytest.mark.requirement",
        found=given,
        expected=earlier,
        remedy=f'name it alone, requirement("{name}"), or give the test an id of its own',
    )


def _requirement_marker(
    id: Any,  # noqa: A002 - the marker is written so
    text: Any = None,
    kind: Any = None,
    source: Any = None,
    mitigates: Any = None,
) -> None:
    """Signature of the marker ``requirement``."""


def _marker_arguments(marker: pytest.Mark, signature: Any) -> dict[str, Any]:
    """Return the marker's arguments by name, defaults filled in."""
    known = _signature(signature)
    try:
        bound = known.bind(*marker.args, **marker.kwargs)
    except TypeError as error:
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


@cache
def _signature(declared: Callable[..., None]) -> inspect.Signature:
    """Return the signature of a marker; guests add arguments to that of ``dura``."""
    own = inspect.signature(declared)
    if declared is not _dura_marker:
        return own
    added: dict[str, inspect.Parameter] = {}
    for guest_name, guest in guests().items():
        for name, default in guest.marker_arguments.items():
            if name in own.parameters or name in added:
                raise ConfigurationError(
                    f"the guest {guest_name} adds the argument {name!r} to the marker dura, which "
                    "has it already",
                    key=name,
                    found=guest_name,
                    expected="an argument of its own",
                    remedy="uninstall one of the packages, or rename the argument",
                )
            added[name] = inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default)
    return own.replace(parameters=[*own.parameters.values(), *added.values()])


_FALSIFY = "falsify"


def _check_falsify(context: SessionContext, definition: pytest.Item) -> None:
    """Refuse a marker that would search nothing, or cannot be read.

    Raises:
        ConfigurationError: For a test that has no campaign, several markers, and a formula that
            cannot be used.
    """
    markers = list(definition.iter_markers(_FALSIFY))
    if not markers:
        return
    fixtures = getattr(definition, "fixturenames", ())
    campaigns = [name for name in ("campaign", f"{LONG_NAMES}campaign") if name in fixtures]
    if definition.get_closest_marker("dura") is None or not campaigns:
        raise ConfigurationError(
            f"the marker {_FALSIFY} searches nothing, since the test looks at no campaign",
            key=f"pytest.mark.{_FALSIFY}",
            found="no marker `dura` with the fixture `campaign`",
            expected="both of them, which say what is searched",
            remedy='add @pytest.mark.dura(scenario="...") and the argument `campaign`',
        )
    if len(markers) > 1:
        raise ConfigurationError(
            f"the test has several markers {_FALSIFY}, of which one alone would count",
            key=f"pytest.mark.{_FALSIFY}",
            found=f"{len(markers)} markers",
            expected="one marker",
            remedy=f'name all requirements in one: {_FALSIFY}(["SAF-1", "SAF-2"])',
        )
    requirements = _marker_arguments(markers[0], _falsify_marker)["requirement"]
    for text in requirements if isinstance(requirements, (list, tuple)) else [requirements]:
        if isinstance(text, str) and text not in context.library().requirements:
            _check_formula(text)


def _check_formula(text: str) -> None:
    from pytest_dura.requirements.checks import read_formula
    from pytest_dura.search.falsify import is_formula

    if is_formula(text):
        read_formula(text)


def run_marked_search(item: pytest.Function) -> None:
    """Run the search of the test's marker, if it has one, and fail the test by its result."""
    __tracebackhide__ = True
    marker = item.get_closest_marker(_FALSIFY)
    if marker is None:
        return
    given = _marker_arguments(marker, _falsify_marker)
    campaign: Any = item.funcargs.get(f"{LONG_NAMES}campaign") or item.funcargs["campaign"]
    requirement = given.pop("requirement")
    try:
        campaign.falsify(
            requirement,
            **{key: value for key, value in given.items() if value is not None},
        )
    except DuraError as error:
        # No line of the test has run, so that there is none to show.
        pytest.fail(failure_text(error), pytrace=False)


def _falsify_marker(
    requirement: Any = None,
    *,
    budget: Any = None,
    faults: Any = None,
    at_most: Any = None,
    shrink: Any = None,
    seed: Any = None,
    at_least: Any = None,
    all: Any = None,  # noqa: A002 - as Campaign.falsify
    region_runs: Any = None,
    surrogate: Any = None,
) -> None:
    """Signature of the marker ``falsify``."""


_OUR_MARKERS = ("dura", "falsify", "requirement")


@dataclass(frozen=True, slots=True)
class Target:
    """Case that a parametrized test looks at, and the run where it looks at one episode."""

    case: Case
    run: int
    planned: int
    requirement: Requirement | None
    until_decided: bool = False
    declared: int = 0
    """Runs of the marker or the scenario, whatever ``--dura-runs`` says."""

    def __repr__(self) -> str:
        """Return the episode's id, which reports show and by which Allure tells tests apart."""
        return f"{self.case.id}#{self.run}"


_LOOKED_AT = ("episode", "campaign", f"{LONG_NAMES}episode", f"{LONG_NAMES}campaign")
"""Fixtures that give a test what its marker names."""


def parametrize(context: SessionContext, metafunc: pytest.Metafunc, marker: pytest.Mark) -> None:
    """Parametrize a test with the marker ``dura``.

    Raises:
        RefusedMarkerError: For a marker that cannot be used, at the test's place.
        pytest.Collector.CollectError: For files that cannot be used, which are not the test's.
    """
    looked_at = [name for name in _LOOKED_AT if name in metafunc.fixturenames]
    each_run = any(name.endswith("episode") for name in looked_at)
    definition = metafunc.definition
    with _errors_at(definition):
        _check_use(definition, looked_at)
        _check_falsify(context, definition)
        requirements = marked_requirements(context, definition)
        _check_decidable(requirements, each_run=each_run)
        if not looked_at and names_no_scenario(marker):
            return
        targets = _targets(context, marker, requirements, each_run=each_run)
    if looked_at:
        metafunc.parametrize(
            ",".join(looked_at),
            [(target,) * len(looked_at) if len(looked_at) > 1 else target for target, _ in targets],
            ids=[name for _, name in targets],
            indirect=True,
        )


def check_parameter_sets(definition: pytest.Item) -> None:
    """Refuse a marker ``dura`` on a set of parameters: pytest applies it after tests are made.

    Raises:
        pytest.Collector.CollectError: For one that names what to run.
    """
    for marker in definition.iter_markers("parametrize"):
        values = marker.args[1] if len(marker.args) > 1 else marker.kwargs.get("argvalues")
        if not isinstance(values, Collection):
            continue  # pytest reads it once; see `unread_marker`
        marks = [mark for each in values if isinstance(each, _PARAMETER_SET) for mark in each.marks]
        error = unread_marker(definition, marks)
        if error:
            raise pytest.Collector.CollectError(error)


_PARAMETER_SET = type(pytest.param())


def unread_marker(test: pytest.Item, marks: Iterable[Any]) -> str | None:
    """Return the error of a marker ``dura`` among the marks of parameters, at the test's place."""
    for mark in (getattr(decorated, "mark", decorated) for decorated in marks):
        if mark.name == "dura" and not names_no_scenario(mark):
            file, line, _ = test.location
            error = ConfigurationError(
                "a dura marker on a parameter of parametrize is not read",
                file=file,
                line=None if line is None else line + 1,
                key="pytest.mark.parametrize",
                found="pytest.param(..., marks=pytest.mark.dura(...))",
                expected="the marker dura on the test function",
                remedy='name all scenarios there, dura(scenario=["...", "..."]), and choose by '
                "`episode.spec.case` what differs between them; or write a test for each",
            )
            return error_text(error)
    return None


def check_markers(context: SessionContext, definition: pytest.Item) -> None:
    """Check the markers of a test that chooses its episodes itself.

    Raises:
        RefusedMarkerError: For one that names what does not exist, at the test's place.
        pytest.Collector.CollectError: For files that cannot be used, which are not the test's.
    """
    with _errors_at(definition):
        _check_falsify(context, definition)
        marked_requirements(context, definition)


def check_spelling(definition: pytest.Item) -> None:
    """Refuse a marker that nearly has the name of ours, and would have no effect.

    Raises:
        RefusedMarkerError: For one that no ini file registers, at the test's place.
    """
    registered = {
        re.split(r"[(:]", line)[0].strip() for line in definition.config.getini("markers")
    }
    for marker in definition.iter_markers():
        near = get_close_matches(marker.name, _OUR_MARKERS, n=1, cutoff=0.75)
        if not near or marker.name in registered:
            continue
        with _errors_at(definition):
            raise ConfigurationError(
                f"there is no marker {marker.name!r}, so that it would do nothing",
                key=f"pytest.mark.{marker.name}",
                found=marker.name,
                expected="one of " + ", ".join(_OUR_MARKERS),
                remedy=f"did you mean {near[0]!r}? A marker of your own is registered in the ini "
                "setting `markers`",
            )


class RefusedMarkerError(Exception):
    """Marker that cannot be used; its test alone fails by it, with ``str(error)`` as message."""


@contextmanager
def _errors_at(definition: pytest.Item) -> Iterator[None]:
    """Context that reports errors at a test's place, unless another file is at fault."""
    try:
        yield
    except ConfigurationError as error:
        if error.file is not None:
            raise pytest.Collector.CollectError(error_text(error)) from None
        file, line, _ = definition.location
        located = error_at(error, file=file, line=None if line is None else line + 1)
        lines = error_text(located).split("\n")
        raise RefusedMarkerError("\n".join(map(indent_if_reserved, lines))) from None


def _check_use(definition: pytest.Item, looked_at: Sequence[str]) -> None:
    """Refuse a marker that would run nothing, which must not read as a pass."""
    markers = [marker for marker in definition.own_markers if marker.name == "dura"]
    declared = [
        marker.kwargs["verdict"]
        for marker in markers
        if marker.kwargs.get("verdict", True) is not True
    ]
    if declared and declared[0] is not False:
        raise _unusable("verdict", declared[0], "False, for a test that decides nothing")
    if declared and looked_at and definition.get_closest_marker("requirement") is not None:
        raise ConfigurationError(
            "the test names a requirement, and says that it decides nothing",
            key="pytest.mark.dura(verdict=)",
            found="verdict=False beside the marker requirement",
            expected="one of them",
            remedy="remove the one that is not meant",
        )
    if len(markers) > 1:
        raise ConfigurationError(
            "the test has several markers dura, of which one alone would count",
            key="pytest.mark.dura",
            found=f"{len(markers)} markers",
            expected="one marker",
            remedy='name all scenarios in one: dura(scenario=["...", "..."])',
        )
    if markers and not looked_at and not names_no_scenario(markers[0]):
        raise ConfigurationError(
            "the marker dura runs nothing, since the test looks at no episode",
            key="pytest.mark.dura",
            found="neither `episode` nor `campaign` among the test's arguments",
            expected="one of these fixtures",
            remedy="add `episode` or `campaign` to the arguments, or remove the marker",
        )


def _check_decidable(requirements: Sequence[Requirement], *, each_run: bool) -> None:
    """Refuse requirements that the test cannot decide, which must not read as decided."""
    names = list(dict.fromkeys(requirement.id for requirement in requirements))
    if each_run:
        paired = [requirement.id for requirement in requirements if requirement.paired is not None]
        if paired:
            raise ConfigurationError(
                f"the requirement {paired[0]!r} is about pairs of runs, and the test looks at one",
                key="pytest.mark.requirement",
                found="episode",
                expected="campaign",
                remedy="take the fixture `campaign`, and call campaign.require()",
            )
    elif len(names) > 1:
        raise ConfigurationError(
            "a test on a campaign decides one requirement, and its markers name several",
            key="pytest.mark.requirement",
            found=", ".join(names),
            expected="one requirement",
            remedy="write a test for each",
        )


def _targets(
    context: SessionContext, marker: pytest.Mark, requirements: list[Requirement], *, each_run: bool
) -> list[tuple[Target, str]]:
    given = _marker_arguments(marker, _dura_marker)
    of_guests = context.guests.marked(given)
    if of_guests is None:
        cases = _cases(context, given["scenario"], given["faults"])
    else:
        from pytest_dura.library.cases import expand_cases

        named = [_judged_alike(context, scenario) for scenario in of_guests]
        cases = expand_cases(named, _campaigns(given["faults"]))
    requirement = requirements[0] if requirements else None
    targets = []
    for case in cases:
        context.register_case(case)
        declared, until_decided = _runs(given["runs"], case)
        planned = context.options.runs or declared
        if each_run and until_decided:
            raise _unusable(
                "runs", given["runs"] or case.scenario.runs, "a number of runs, for one test a run"
            )
        for run in range(planned) if each_run else [0]:
            name = f"{case.id}#{run}" if each_run else case.id
            target = Target(case, run, planned, requirement, until_decided, declared)
            targets.append((target, name))
    return targets


def _judged_alike(context: SessionContext, scenario: Scenario) -> Scenario:
    """Return a scenario of a marker with the requirements that an option's of its name has.

    They are one case of the record, whose runs carry a verdict on each of its requirements.
    """
    by_options = (each for named in context.guests.scenarios.values() for each in named)
    if all(scenario.name != each.name for each in by_options):
        return scenario
    declared = context.library().scenarios[scenario.name].requirements
    return scenario.model_copy(update={"requirements": declared})


def _cases(context: SessionContext, scenario: Any, faults: Any) -> list[Case]:
    from pytest_dura.library.cases import expand_cases
    from pytest_dura.library.loading import select_names

    names = [scenario] if isinstance(scenario, str) else scenario
    if not isinstance(names, Sequence) or not names or not all(isinstance(n, str) for n in names):
        raise _unusable("scenario", scenario, "a scenario's name or glob, or a list of them")
    faults = _campaigns(faults)
    library = context.library()
    chosen = {name: library.scenarios[name] for name in select_names(library.scenarios, names)}
    return expand_cases(chosen, faults, read=library.faults)


def _campaigns(faults: Any) -> Any:
    """Return the fault campaigns that a marker names, checked."""
    if isinstance(faults, str):
        faults = [faults]
    if faults is not None and not _are_campaigns(faults):
        raise _unusable("faults", faults, 'a list such as ["none", "ghost-obstacle"]')
    return faults


def _are_campaigns(faults: Any) -> bool:
    """Whether each entry is a fault or a list of faults, and there is at least one."""
    if not isinstance(faults, Sequence) or not faults:
        return False
    return all(
        isinstance(campaign, (str, Mapping))
        or (
            isinstance(campaign, Sequence)
            and all(isinstance(fault, (str, Mapping)) for fault in campaign)
        )
        for campaign in faults
    )


def _runs(value: Any, case: Case) -> tuple[int, bool]:
    """Return the number of runs at most, and whether they end once the requirement is decided."""
    if value is None:
        return case.scenario.planned, case.scenario.until_decided
    budget = isinstance(value, Mapping)
    number = value.get("at_most") if budget else value
    fits = isinstance(number, int) and not isinstance(number, bool) and number >= 1
    if not fits or (budget and dict(value) != {"until": "decided", "at_most": number}):
        expected = 'a whole number of at least 1, or {"until": "decided", "at_most": 400}'
        raise _unusable("runs", value, expected)
    return number, budget


def _unusable(key: str, value: Any, expected: str) -> ConfigurationError:
    return ConfigurationError(
        f"the marker dura cannot be used: wrong `{key}`",
        key=f"pytest.mark.dura({key}=)",
        found=value,
        expected=expected,
        remedy=f"correct `{key}`",
    )


def _dura_marker(
    scenario: Any = None,
    faults: Any = None,
    runs: Any = None,
    verdict: Any = True,
) -> None:
    """Signature of the marker ``dura``, without the arguments of guests."""


def names_no_scenario(marker: pytest.Mark) -> bool:
    """Whether a marker ``dura`` says no more than that the test decides nothing."""
    return not marker.args and set(marker.kwargs) == {"verdict"}


def decides_nothing(node: pytest.Item) -> bool:
    """Whether a test says that no verdict is to come of it: ``dura(verdict=False)``."""
    marker = node.get_closest_marker("dura")
    return marker is not None and marker.kwargs.get("verdict") is False
