"""A guest of sessions: options, a line of the header and of the list, and a limit."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pytest_dura.guests import Guest, ListedCase
from pytest_dura.options import Option, OptionTable, whole_number


class LiftOptions(OptionTable):
    """Options of lifts."""

    title = "a lift as the plant"

    rides: Option[int | None] = Option(
        "--lift-rides",
        "rides after which the session ends as interrupted",
        whole_number(at_least=1),
        ini="lift_rides",
        metavar="N",
        example="5",
        repeated_in=("rerun",),
        same_in_shards=False,
    )


class LiftGuest(Guest):
    """Counts the rides of a session."""

    options = LiftOptions

    def begin(self) -> None:
        """Begin to count."""
        self.made = 0

    def header(self) -> Iterable[str]:
        """Name the limit."""
        return [] if self.given.rides is None else [f"at most {self.given.rides} rides"]

    def listed(self, cases: Iterable[ListedCase]) -> Iterable[str]:
        """Count the rides that would be made."""
        yield f"lift: {sum(case.episodes for case in cases)} rides"

    def used(self, spec: Any) -> None:
        """Count a ride."""
        del spec
        self.made += 1

    def take(self) -> Iterable[Any]:
        """Tell the record how many rides this process has made."""
        from pytest_dura.evidence.model import Fact

        return [Fact("rides", "all", 0, {"made": self.made}, self.session.worker_name)]

    def reason_to_end(self) -> str:
        """Name the limit once it is reached."""
        limit = self.given.rides
        reached = limit is not None and self.made >= limit
        return f"the limit of {limit} rides is reached (--lift-rides)" if reached else ""
