"""A guest of sessions: options, scenarios, an item, lines of header and list, and a limit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar

from pytest_dura.guests import AddedItem, Guest, JudgedCase, ListedCase
from pytest_dura.options import Option, OptionTable, switch, whole_number


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
    floor: Option[int | None] = Option(
        "--lift-floor",
        "run a ride to the floor at this height in m",
        whole_number(at_least=1),
        metavar="N",
        example="3",
        activates=True,
        brings_cases=True,
        repeated_in=("rerun", "replay"),
    )
    inspects: Option[bool] = Option(
        "--lift-inspect", "ride each planned case once more, as an item", switch, activates=True
    )


def _rides(floor: int) -> list[Any]:
    """Return the ride to a floor; no lift goes above 30 m."""
    if floor > 30:
        return []
    from pytest_dura.library.scenario import Scenario

    described = {"name": f"asked/floor-{floor}", "simulator": "lift", "duration": 20.0}
    return [Scenario.model_validate({**described, "world": {"floor": float(floor)}})]


class Inspection:
    """Item that rides each case once, at a seed of its own."""

    name = "inspection"

    def __init__(self, cases: Sequence[Any]) -> None:
        self.cases = cases

    def waiting(self, problem: str) -> Any:
        """Return the fact that no ride was made."""
        from pytest_dura.evidence.model import Fact

        return Fact("rides", self.name, 1, {"made": 0, "problem": problem})

    def run(self, runner: Any, later: Sequence[Any]) -> str:
        """Ride, and fail where a ride is too high."""
        from pytest_dura.campaign.events import FactEstablished

        del later
        heights = [
            float(runner.episode(case, seed=99).signals["height"].max()) for case in self.cases
        ]
        runner.events.emit(FactEstablished("rides", self.name, 1, {"made": len(heights)}))
        return "" if max(heights) < 6.0 else f"the cabin is at {max(heights):g} m"


class LiftGuest(Guest):
    """Counts the rides of a session."""

    options = LiftOptions
    marker_arguments: ClassVar[Mapping[str, Any]] = {"floor": None}

    def scenarios(self) -> Iterable[Any]:
        """Return the ride of the option."""
        return [] if self.given.floor is None else _rides(self.given.floor)

    def marked(self, given: Mapping[str, Any]) -> Iterable[Any] | None:
        """Return the ride of a marker."""
        return None if given["floor"] is None else _rides(given["floor"])

    def items(
        self, planned: Iterable[JudgedCase], marked: Iterable[JudgedCase]
    ) -> Sequence[AddedItem]:
        """Return an item for all cases."""
        del marked
        return self.expected(planned)

    def expected(self, planned: Iterable[JudgedCase]) -> Sequence[AddedItem]:
        """Return the same item."""
        return [Inspection([each.case for each in planned])] if self.given.inspects else []

    def objections(self, head: Any) -> Iterable[str]:
        """Object to an inspection without a ride."""
        facts = [fact for fact in head.facts or () if fact.about == Inspection.name]
        return [f"lift: no ride was made: {fact.data['problem']}"
                for fact in facts if not fact.data["made"]]  # fmt: skip

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
