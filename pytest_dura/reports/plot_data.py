"""Numbers that the plots show, gathered in one pass over a record's episodes.

Of an episode a few numbers stay, in arrays; everything is of valid planned episodes.
"""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from pytest_dura.core.metrics import TracedFault
from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.reports.plots import Step

ArmKey = tuple[str, str]
"""Id of a case, and the component's name."""
Form = Literal["plain", "filled", "dashed"]


@dataclass(frozen=True)
class Arm:
    """A case among those of its scenario, with which it shares its seeds.

    Args:
        case: Id of the case.
        component: The component under test.
        scenario: Its scenario.
        faults: Ids of its faults.
        without: Roles that are switched off.
    """

    case: str
    component: str
    scenario: str
    faults: tuple[str, ...]
    without: tuple[str, ...]

    @classmethod
    def of(cls, case: CaseEntry) -> Arm:
        """Make the arm of a case."""
        faults = tuple(str(fault.id) for fault in case.faults)
        return cls(case.id, case.component, case.scenario, faults, tuple(case.without))

    @property
    def key(self) -> ArmKey:
        """Case and component."""
        return self.case, self.component

    @property
    def label(self) -> str:
        """What distinguishes it within its scenario."""
        faults = "+".join(self.faults) or "no fault"
        lacking = " and ".join(role.replace("_", " ") for role in self.without)
        return f"{faults}, without {lacking}" if lacking else faults

    @property
    def form(self) -> Form:
        """How its box is drawn."""
        return "dashed" if self.without else "filled" if self.faults else "plain"


MAX_RUNS = 5000
"""Runs of an arm whose numbers are kept."""
MAX_LATENCIES = 5000
"""Latencies of a fault and a role that are kept."""


@dataclass
class Numbers:
    """A measure's numbers in the runs of an arm.

    Args:
        of_seed: Number by seed; a seed has one run in a case.
        seeds: Seeds of the runs without a number.
        left_out: Further runs, after the first :data:`MAX_RUNS`.
    """

    of_seed: dict[int, float] = field(default_factory=dict)
    seeds: set[int] = field(default_factory=set)
    left_out: int = 0

    def add(self, seed: int, value: float | None) -> None:
        """Add a run."""
        if len(self.of_seed) + len(self.seeds) >= MAX_RUNS:
            self.left_out += 1
        elif value is None:
            self.seeds.add(seed)
        else:
            self.of_seed[seed] = value


@dataclass(frozen=True)
class Differences:
    """The same measure in two arms, pair by pair of equal seeds.

    Args:
        arm: The arm whose numbers are taken.
        twin: The arm whose numbers are taken from them.
        change: What the arm has, and the twin has not.
        numbers: With less without, of pairs in which both runs have a number.
        lost: Pairs in which the twin alone has a number.
        gained: Pairs in which the arm alone has one.
        neither: Pairs without any.
    """

    arm: Arm
    twin: Arm
    change: str
    numbers: Sequence[float]
    lost: int
    gained: int
    neither: int


@dataclass
class Detections:
    """Alerts on one fault, over the runs in which it manifested.

    Args:
        latencies: From activation to alert in s, by the role that raised it.
        manifested: Runs in which it manifested.
        undetected: Those without an alert.
    """

    latencies: dict[str, array[float]] = field(default_factory=lambda: defaultdict(_doubles))
    manifested: int = 0
    undetected: int = 0


def _doubles() -> array[float]:
    return array("d")


CHAIN = ("Planned", "Percept changed", "Proposal changed", "Alert", "Recovery", "Outcome")
"""Steps of a fault's chain."""
PLANNED = "planned"
NO_EFFECT = "no effect"
CHANGED, UNCHANGED, UNKNOWN = "changed", "unchanged", "not known"
ALERT, NO_ALERT = "alert", "no alert"
ACTED, NOT_ACTED = "acted", "did not act"
NOT_FOLLOWED = "not followed"
VIOLATED = "violated"


def chain_of(fault: TracedFault) -> Step:
    """Return the way of a fault in one run; it ends where the fault had no effect on a percept."""
    if fault.manifested_at is None:
        return PLANNED, NO_EFFECT
    proposal = {"propagated": CHANGED, "contained": UNCHANGED}.get(fault.propagation or "", UNKNOWN)
    return (
        PLANNED,
        CHANGED,
        proposal,
        NO_ALERT if fault.detected_at is None else ALERT,
        NOT_ACTED if fault.recovery_at is None else ACTED,
        fault.outcome or NOT_FOLLOWED,
    )


class PlotData:
    """Numbers of valid planned episodes, by case, fault and seed.

    Args:
        arms: The cases.
        measures: Names of the measures whose numbers are kept.
        drawn: The arms of which they are.
    """

    def __init__(
        self, arms: Iterable[Arm], measures: Iterable[str], drawn: Iterable[ArmKey]
    ) -> None:
        self.arms = {arm.key: arm for arm in arms}
        self._drawn = frozenset(drawn)
        self.measures: dict[str, dict[ArmKey, Numbers]] = {measure: {} for measure in measures}
        self.detections: dict[str, Detections] = defaultdict(Detections)
        """By fault, over arms that lack no role."""
        self.chains: dict[str, Counter[Step]] = defaultdict(Counter)
        """By fault, over arms that lack no role: how many runs went which way."""

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode, if it is a planned one of a case of the record."""
        arm = self.arms.get((episode.case, episode.component))
        if arm is None or not episode.planned:
            return
        if not arm.without and episode.validity != "missing":
            for fault in episode.faults:
                self._add_fault(fault)
        if episode.validity != "valid" or arm.key not in self._drawn:
            return
        for measure, arms in self.measures.items():
            value = episode.outcome.measures.get(measure, False)
            if isinstance(value, bool):  # the simulator lacks what it needs
                continue
            arms.setdefault(arm.key, Numbers()).add(episode.seed, value)

    def _add_fault(self, fault: TracedFault) -> None:
        self.chains[fault.id][chain_of(fault)] += 1
        if fault.manifested_at is None:
            return
        detections = self.detections[fault.id]
        detections.manifested += 1
        if fault.detected_at is None:
            detections.undetected += 1
        elif fault.detection_latency is not None:
            latencies = detections.latencies[fault.detected_by or ""]
            if len(latencies) < MAX_LATENCIES:
                latencies.append(fault.detection_latency)

    def differences(self, measure: str) -> Iterator[Differences]:
        """Yield what faults change, then what each role changes that an arm lacks."""
        by_scenario: dict[tuple[str, str], list[Arm]] = defaultdict(list)
        for arm in self.arms.values():
            if arm.key not in self.measures[measure]:
                continue
            by_scenario[arm.scenario, arm.component].append(arm)
        for arms in by_scenario.values():
            known = {(arm.faults, arm.without): arm for arm in arms}
            for arm in arms:
                plain = known.get(((), ()))
                if not arm.without and arm.faults and plain is not None:
                    yield self._difference(measure, arm, plain, "+".join(arm.faults))
            for twin in arms:
                whole = known.get((twin.faults, ()))
                if twin.without and whole is not None:
                    change = " and ".join(role.replace("_", " ") for role in twin.without)
                    yield self._difference(measure, whole, twin, change)

    def _difference(self, measure: str, arm: Arm, twin: Arm, change: str) -> Differences:
        ours, theirs = self.measures[measure][arm.key], self.measures[measure][twin.key]
        both = sorted(ours.of_seed.keys() & theirs.of_seed.keys())
        return Differences(
            arm,
            twin,
            change,
            [ours.of_seed[seed] - theirs.of_seed[seed] for seed in both],
            lost=len(ours.seeds & theirs.of_seed.keys()),
            gained=len(ours.of_seed.keys() & theirs.seeds),
            neither=len(ours.seeds & theirs.seeds),
        )


def arms_in_order(arms: Iterable[Arm]) -> list[Arm]:
    """Put the arms of a scenario side by side, in the order in which its first one stands.

    Those without a fault come first, those that lack a role last.
    """
    known = list(arms)
    place: Mapping[tuple[str, str], int] = {
        key: i for i, key in reversed(list(enumerate((a.scenario, a.component) for a in known)))
    }
    return sorted(
        known,
        key=lambda arm: (
            place[arm.scenario, arm.component], bool(arm.without), bool(arm.faults),
        ),
    )  # fmt: skip
