"""SessionGuests: the guests of one session, which it asks one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.guests import AtOnce, Guest, ListedCase, Session, guests
from pytest_dura.options import OptionTable

if TYPE_CHECKING:
    from pytest_dura.core.episode import EpisodeSpec
    from pytest_dura.evidence.files import InputFiles
    from pytest_dura.evidence.model import RecordHead
    from pytest_dura.library.scenario import Scenario

_WORKER_KEY = "dura_guests"


def _unusable_marker(problem: str, expected: str) -> ConfigurationError:
    return ConfigurationError(
        f"the marker dura cannot be used: {problem}",
        key="pytest.mark.dura",
        expected=expected,
        remedy="change its arguments",
    )


class SessionGuests:
    """Guests of the session of this process.

    Args:
        session: The session.
        options: Returns the checked options of the guests, by their names.
        worker_input: Returns what the controller sent to this worker of pytest-xdist.
    """

    def __init__(
        self,
        session: Session,
        options: Callable[[], Mapping[str, OptionTable]],
        worker_input: Callable[[], Mapping[str, Any]],
    ) -> None:
        self._session, self._options, self._worker_input = session, options, worker_input

    @cached_property
    def _guests(self) -> Mapping[str, Guest]:
        sent, options = self._worker_input().get(_WORKER_KEY, {}), self._options()
        return {
            name: guest(self._session, options[name], sent.get(name, {}))
            for name, guest in guests().items()
        }

    def __iter__(self) -> Iterator[Guest]:
        return iter(self._guests.values())

    def __enter__(self) -> None:
        """See :meth:`begin`."""
        self.begin()

    def __exit__(self, *_: object) -> None:
        """See :meth:`end`."""
        self.end()

    def begin(self) -> None:
        """Begin with each.

        Raises:
            ConfigurationError: If the session cannot run.
        """
        for guest in self:
            guest.begin()

    def stop(self) -> None:
        """Let nothing that is still under way be noted any more."""
        for guest in self:
            guest.stop()

    def end(self) -> None:
        """Release what they hold."""
        for guest in self:
            guest.end()

    def send_to_worker(self, workerinput: dict[str, Any]) -> None:
        """Add what workers have to know to their input."""
        workerinput[_WORKER_KEY] = {
            name: dict(guest.to_worker()) for name, guest in self._guests.items()
        }

    def first_lines(self) -> list[str]:
        """List the lines of the header that stand before all others."""
        return [f"dura: {line}" for guest in self for line in guest.first_lines()]

    def header(self) -> list[str]:
        """List their lines of the header."""
        return [f"dura: {line}" for guest in self for line in guest.header()]

    @cached_property
    def scenarios(self) -> Mapping[str, Sequence[Scenario]]:
        """The scenarios that their options name, by the names of guests.

        Raises:
            ConfigurationError: If they cannot be used.
        """
        return {name: list(guest.scenarios()) for name, guest in self.named()}

    def judging(self) -> list[Path]:
        """List the requirement files that judge these scenarios."""
        return [file for guest in self for file in guest.judging()]

    def marked(self, given: Mapping[str, Any]) -> list[Scenario] | None:
        """List the scenarios that their arguments of a marker name; ``None`` for none.

        Raises:
            ConfigurationError: For an argument that cannot be used, one that names no scenario, and
                arguments of two guests.
        """
        answers = ((name, guest, guest.marked(given)) for name, guest in self.named())
        named = [(name, guest, list(each)) for name, guest, each in answers if each is not None]
        if len(named) > 1:
            raise _unusable_marker(
                f"the guests {' and '.join(name for name, _, _ in named)} both name scenarios",
                "the arguments of one guest",
            )
        for name, guest, scenarios in named:
            if not scenarios:
                asked = {key: given[key] for key in guest.marker_arguments if key in given}
                raise _unusable_marker(
                    f"the guest {name} has no scenario for {asked}", "one scenario or more"
                )
        return named[0][2] if named else None

    def named(self) -> Iterator[tuple[str, Guest]]:
        """Yield each guest with its name."""
        yield from self._guests.items()

    def objections(self, head: RecordHead) -> list[str]:
        """List why the gate fails, besides its verdicts."""
        return [text for guest in self for text in guest.objections(head)]

    def listed(self, cases: Sequence[ListedCase]) -> Iterator[str]:
        """Yield their lines of ``--dura-list``."""
        for guest in self:
            yield from guest.listed(cases)

    def owner(self) -> str:
        """Say why this process alone may simulate; empty if others may."""
        return next(filter(None, (guest.owner() for guest in self)), "")

    def at_once(self) -> list[AtOnce]:
        """List what is done for several episodes at once."""
        limits = (guest.at_once() for guest in self)
        return [limit for limit in limits if limit is not None and limit.number > 1]

    def requests(self) -> int | None:
        """Return how many requests this process has made so far; ``None`` where it makes none."""
        made = [made for guest in self if (made := guest.requests()) is not None]
        return sum(made) if made else None

    def reason_to_end(self) -> str:
        """Say why the session ends as interrupted; empty to go on."""
        return next(filter(None, (guest.reason_to_end() for guest in self)), "")

    def in_replay(self) -> dict[str, str | None]:
        """Return what the printed command of a replay gives for options of this session."""
        return {option: text for guest in self for option, text in guest.in_replay().items()}

    def prepare(self, spec: EpisodeSpec) -> None:
        """Prepare for an episode of an earlier session.

        Raises:
            ConfigurationError: If it cannot be.
        """
        for guest in self:
            guest.prepare(spec)

    def replay_warning(self) -> list[str]:
        """List why a replayed episode may differ."""
        return [line for guest in self for line in guest.replay_warning()]

    def used(self, spec: EpisodeSpec) -> None:
        """Note an episode that an item used."""
        for guest in self:
            guest.used(spec)

    def take(self) -> list[Any]:
        """Return lines for the record, which are new since the last call."""
        return [line for guest in self for line in guest.take()]

    @contextmanager
    def uncounted(self) -> Iterator[None]:
        """Context of a repetition, which enters no count."""
        with ExitStack() as stack:
            for guest in self:
                stack.enter_context(guest.uncounted())
            yield

    def add_inputs(self, inputs: InputFiles) -> None:
        """Add their files to the inputs of the evidence."""
        for guest in self:
            guest.add_inputs(inputs)

    def take_last(self, inputs: InputFiles) -> list[Any]:
        """Return lines for the record that are known at the session's end alone."""
        return [line for guest in self for line in (*guest.take(), *guest.take_last(inputs))]
