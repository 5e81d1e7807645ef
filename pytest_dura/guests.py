"""Guests: what a package adds to sessions, beside domains, roles, tables and plots.

A guest brings options, arguments of the marker ``dura``, scenarios, items, lines of the header and
of ``--dura-list``, inputs and objections of the evidence, what episodes depend on besides their
specs, and limits. The package's own, such as that of language
models, come through the same entry points as those of other packages. Every pytest run loads the
module of each guest: it imports what else it needs when that is used.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

from pytest_dura.options import OptionTable, unusable

if TYPE_CHECKING:
    from pytest_dura.core.episode import EpisodeSpec
    from pytest_dura.core.role_spec import RoleSpec

GROUP = "pytest_dura.guests"
"""Group of entry points of guests."""


class AtOnce(NamedTuple):
    """How many episodes that wait for the same thing are simulated at the same time.

    Args:
        number: How many at most, in each process.
        of: What is done at the same time, in the plural, for the header and the record.
    """

    number: int
    of: str


class Session(Protocol):
    """What a guest reads of its session."""

    is_worker: bool

    @property
    def worker_name(self) -> str:
        """Name of this process among the workers of pytest-xdist; ``main`` in the controller."""

    @property
    def root(self) -> Path:
        """Root directory of pytest."""

    @property
    def time_budgets(self) -> Sequence[float]:
        """Seconds that the session gives its component for one proposal, each once, sorted."""

    def redact(self, value: Any) -> Any:
        """Copy plain data without the secrets that this process knows of by now."""


@dataclass(frozen=True)
class ListedCase:
    """A case that a session would run, for ``--dura-list``.

    Args:
        episodes: How many episodes of it, those of pairs and fault-free twins included.
        component: Finds the class or factory of the component under test.
        task: Makes the task of its first run.
    """

    episodes: int
    component: Callable[[], Any]
    task: Callable[[], Any]


class JudgedCase(NamedTuple):
    """A case that a session judges, for the items that guests add.

    Args:
        case: The case.
        requirements: What judges it.
        marker: Arguments of the marker ``dura`` of the test that judges it; empty for a case of the
            plan.
    """

    case: Any
    requirements: Sequence[Any]
    marker: Mapping[str, Any]


class AddedItem(Protocol):
    """An item that a guest adds to the session, which runs episodes of its own.

    Its node id is the guest's name, ``::`` and its name.
    """

    @property
    def name(self) -> str:
        """Its name, which no other item of the guest has."""

    def waiting(self, problem: str) -> Any:
        """Return the line of the record that holds until the item has reported.

        Args:
            problem: Why it would not.
        """

    def run(self, runner: Any, later: Sequence[Any]) -> str:
        """Run its episodes, and emit what they come to.

        Args:
            runner: The session's runner of episodes.
            later: The guest's items from this one on that this process runs, as far as it knows.

        Returns:
            Why the item fails; empty if it does not.

        Raises:
            ConfigurationError: Which fails the item, too.
        """


class Guest:
    """What a package adds to a session; each method does nothing until it is overridden.

    The class methods are of a process: processes that simulate for a session call them as well.

    Args:
        session: The session.
        options: Its checked options.
        sent: What :meth:`to_worker` of the controller returned, in a worker of pytest-xdist.
    """

    options: ClassVar[type[OptionTable]] = OptionTable
    """Its table of options, which ``--help`` shows under its name."""
    marker_arguments: ClassVar[Mapping[str, Any]] = {}
    """Arguments that it adds to the marker ``dura``, with their defaults."""
    default_domain: ClassVar[str] = ""
    """Domain of the built-in scenarios, and of projects that name none, if this guest has it."""

    def __init__(self, session: Session, options: Any, sent: Mapping[str, Any]) -> None:
        self.session, self.given, self.sent = session, options, sent

    @classmethod
    def reason_to_stay(cls, role: RoleSpec) -> str:
        """Say why a resolved role has to run in the session's own process; empty if it need not.

        Args:
            role: A role or the simulator of an episode.

        Returns:
            What the role does, such as ``asks a server``.
        """
        del role
        return ""

    @classmethod
    def inputs_of(cls, roles: Iterable[RoleSpec]) -> Mapping[str, str]:
        """Return what an episode with these roles depends on besides its spec, in this process.

        Returns:
            A digest or a few words by what it is, in words; episodes with others are others.
        """
        del roles
        return {}

    @classmethod
    def reason_to_differ(cls, roles: Iterable[RoleSpec]) -> str:
        """Say why an equal episode may differ, and is not repeated; empty if it does not differ."""
        del roles
        return ""

    @classmethod
    def uses(cls) -> Mapping[str, int]:
        """Return how often roles of this process did what :meth:`reason_to_stay` names, by that."""
        return {}

    def begin(self) -> None:
        """Begin, before anything is planned.

        Raises:
            ConfigurationError: If the session cannot run.
        """

    def stop(self) -> None:
        """Let nothing that is still under way be noted any more: the evidence is written next."""

    def end(self) -> None:
        """Release what it holds; called at the end of each session."""

    def to_worker(self) -> Mapping[str, Any]:
        """Return what its part in a worker of pytest-xdist has to know, as plain data."""
        return {}

    def first_lines(self) -> Iterable[str]:
        """Yield lines of the header that stand before all others, without ``dura:``."""
        return ()

    def header(self) -> Iterable[str]:
        """Yield lines of the header, without ``dura:``."""
        return ()

    def scenarios(self) -> Iterable[Any]:
        """Return scenarios that its options name, and no file declares; they belong to the plan.

        An option of it that is a row with ``brings_cases`` has to be given.

        Raises:
            ConfigurationError: If they cannot be used.
        """
        return ()

    def judging(self) -> Iterable[Path]:
        """Return requirement files that judge scenarios of guests alone."""
        return ()

    def marked(self, given: Mapping[str, Any]) -> Iterable[Any] | None:
        """Return the scenarios that its arguments of a marker ``dura`` name.

        Args:
            given: All arguments of the marker, by name.

        Returns:
            ``None`` where they name none, and ``scenario`` counts.

        Raises:
            ConfigurationError: For an argument that cannot be used.
        """
        del given
        return None

    def items(
        self, planned: Iterable[JudgedCase], marked: Iterable[JudgedCase]
    ) -> Sequence[AddedItem]:
        """Return items that it adds to the session.

        Args:
            planned: Cases of the plan.
            marked: Cases of tests whose markers have an argument of this guest.

        Raises:
            ConfigurationError: If its options ask for items, and there is nothing to judge.
        """
        del planned, marked
        return ()

    def expected(self, planned: Iterable[JudgedCase]) -> Sequence[AddedItem]:
        """Return those of its items that the plan alone asks for, in any process of the session.

        Args:
            planned: Cases of the plan.
        """
        del planned
        return ()

    def objections(self, head: Any) -> Iterable[str]:
        """Yield why the gate fails, besides its verdicts.

        Args:
            head: The :class:`RecordHead` of the record at the session's end.
        """
        del head
        return ()

    def listed(self, cases: Iterable[ListedCase]) -> Iterable[str]:
        """Yield lines of ``--dura-list`` on the cases that would run."""
        del cases
        return ()

    def owner(self) -> str:
        """Say why this process alone may simulate, in words; empty if others may."""
        return ""

    def at_once(self) -> AtOnce | None:
        """Return how many episodes that :meth:`reason_to_stay` keeps are simulated at once."""
        return None

    def requests(self) -> int | None:
        """Return how many requests this process has made so far; ``None`` where it makes none."""
        return None

    def reason_to_end(self) -> str:
        """Say why the session ends as interrupted, such as a limit; empty to go on."""
        return ""

    def in_replay(self) -> Mapping[str, str | None]:
        """Return what the printed command of a replay gives for options of this session.

        Returns:
            Values by options; ``None`` leaves the option out.
        """
        return {}

    @classmethod
    def replayed(cls, values: Mapping[str, str]) -> Mapping[str, str]:
        """Return the options that the command of a replay in a report needs.

        Args:
            values: Its options that the recorded session's command names.
        """
        del values
        return {}

    def prepare(self, spec: EpisodeSpec) -> None:
        """Prepare for an episode of an earlier session, which is run again next.

        Raises:
            ConfigurationError: If it cannot be.
        """
        del spec

    def replay_warning(self) -> Iterable[str]:
        """Yield lines on why a replayed episode may differ."""
        return ()

    def used(self, spec: EpisodeSpec) -> None:
        """Note an episode that an item used."""
        del spec

    def take(self) -> Iterable[Any]:
        """Return lines for the record, which are new since the last call."""
        return ()

    def uncounted(self) -> AbstractContextManager[Any]:
        """Return a context of a repetition, which enters no count."""
        return nullcontext()

    def add_inputs(self, inputs: Any) -> None:
        """Add its files to the :class:`InputFiles` of the evidence."""
        del inputs

    def take_last(self, inputs: Any) -> Iterable[Any]:
        """Return lines for the record that are known at the session's end alone.

        Args:
            inputs: The :class:`InputFiles` of the evidence, for a file that the session changed.
        """
        del inputs
        return ()


def default_domain() -> str:
    """Return the domain of projects that name none; empty where no guest has one."""
    return next(filter(None, (guest.default_domain for guest in guests().values())), "")


@cache
def guests() -> Mapping[str, type[Guest]]:
    """Return the classes of all guests of installed packages, by their names.

    They are looked for once in a process: a session has their options from its beginning.

    Raises:
        ConfigurationError: For one that cannot be loaded, and two of one name.
    """
    points: dict[str, tuple[Any, Any]] = {}
    for distribution, point in _points():
        first, known = points.setdefault(point.name, (distribution, point))
        # Of two distributions of one name the first on the import path is the installed one.
        if known.value != point.value and _name(first) != _name(distribution):
            raise unusable(
                f"two packages register the guest {point.name!r}",
                key=GROUP,
                found=f"{known.value} and {point.value}",
                expected="a name of its own for each guest",
                remedy="uninstall one of them, or give it another name",
            )
    return {name: _loaded(point) for name, (_, point) in sorted(points.items())}


def _points() -> Iterator[tuple[Any, Any]]:
    """Yield the entry points of guests, each with its distribution.

    Every pytest run asks for them. So the text of a distribution is parsed only if it has some:
    with some 200 distributions, parsing all takes 8 ms, and reading them 3 ms.
    """
    from importlib.metadata import distributions

    for distribution in distributions():
        if f"[{GROUP}]" in (distribution.read_text("entry_points.txt") or ""):
            for point in distribution.entry_points:
                if point.group == GROUP:
                    yield distribution, point


def _name(distribution: Any) -> str:
    return str(distribution.metadata["Name"])


def _loaded(point: Any) -> type[Guest]:
    try:
        guest = point.load()
    except Exception as error:
        raise unusable(
            f"the guest {point.name!r} cannot be loaded: {type(error).__name__}: {error}",
            key=GROUP,
            found=point.value,
            expected="an entry point that can be imported",
            remedy="correct or uninstall the package that registers it",
        ) from error
    if not (isinstance(guest, type) and issubclass(guest, Guest)):
        raise unusable(
            f"the guest {point.name!r} is not a subclass of pytest_dura.guests.Guest",
            key=GROUP,
            found=point.value,
            expected="a subclass of pytest_dura.guests.Guest",
            remedy="correct or uninstall the package that registers it",
        )
    return guest


def reason_to_stay(role: RoleSpec) -> str:
    """Say why the session's own process simulates with a role; empty if it need not."""
    reasons = (guest.reason_to_stay(role) for guest in guests().values())
    return next(filter(None, reasons), "")


def inputs_of(roles: Iterable[RoleSpec]) -> Iterator[tuple[str, str]]:
    """Yield what an episode with these roles depends on besides its spec."""
    known = tuple(roles)
    for guest in guests().values():
        yield from guest.inputs_of(known).items()


def reason_to_differ(roles: Iterable[RoleSpec]) -> str:
    """Say why equal episodes with these roles may differ; empty if they do not."""
    known = tuple(roles)
    reasons = (guest.reason_to_differ(known) for guest in guests().values())
    return next(filter(None, reasons), "")


def uses() -> Mapping[str, int]:
    """Return how often this process did what needs the session's own process, by what it is."""
    counts: Counter[str] = Counter()
    for guest in guests().values():
        counts.update(guest.uses())
    return counts
