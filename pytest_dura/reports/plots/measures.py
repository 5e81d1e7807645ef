"""Plots of measures: their numbers in the arms of a scenario, and differences in pairs of seeds.

Of an episode a few numbers stay; everything is of valid planned episodes.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from pytest_dura.core.measures import MeasureInfo
from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import RecordHead
from pytest_dura.evidence.text import name, one_line
from pytest_dura.reports.columns import Column, Shown, measure_label, number_text
from pytest_dura.reports.contents import folded_cases
from pytest_dura.reports.document import Level, Picture, Plot, Table, not_drawn
from pytest_dura.reports.plots.plot import PlotKind
from pytest_dura.reports.plots.strips import (
    MAX_ROWS,
    FiveNumbers,
    Frame,
    Strip,
    bounded,
    dots_of,
    five_numbers,
    strip_plot,
)

MAX_MEASURES = 6
MAX_RUNS = 5000
"""Runs of an arm whose numbers are kept."""
_EQUAL = 1e-9
"""Differences up to this are rounding: times are sums of steps."""
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


class MeasurePlots(PlotKind):
    """Draws each declared number by scenario and arm, and its differences in pairs of seeds.

    No plot is of a single case.
    """

    weight = Level.PAGE
    place = 1

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        known = [each for each in head.measures if each.shown == "mean"]
        self._left_out = len(known[MAX_MEASURES:])
        arms = [Arm.of(case) for case in head.cases]
        folded = folded_cases(head)
        drawn = arms_in_order(arm for arm in arms if arm.key not in folded)[:MAX_ROWS]
        self._arms_left_out = len(arms) - len(drawn)
        self.arms = {arm.key: arm for arm in arms}
        self._drawn = frozenset(arm.key for arm in drawn)
        self._measures = {each.name: each for each in known[:MAX_MEASURES]}
        self.numbers: dict[str, dict[ArmKey, Numbers]] = {name: {} for name in self._measures}

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode, if it is a valid planned one of an arm that is drawn."""
        key = episode.case, episode.component
        if key not in self._drawn or not episode.planned or episode.validity != "valid":
            return
        for measure, arms in self.numbers.items():
            value = episode.outcome.measures.get(measure, False)
            if not isinstance(value, bool):  # else the simulator lacks what it needs
                arms.setdefault(key, Numbers()).add(episode.seed, value)

    def plots(self) -> Iterator[Plot]:
        """Draw the numbers, then the differences."""
        shown = [own for own, arms in self.numbers.items() if len(arms) > 1]
        pictures = [self._of_arms(own, place) for place, own in enumerate(shown)]
        differences = [self._of_pairs(own, place) for place, own in enumerate(shown)]
        pictures += [each for each in differences if each is not None]
        if pictures:
            left_out = not_drawn(self._left_out, "measures are")
            yield Plot(pictures=tuple(pictures), left_out=left_out, shown=Shown.PAGE)

    def _of_arms(self, measure: str, place: int) -> Picture:
        info, known = self._measures[measure], self.numbers[measure]
        arms = arms_in_order(self.arms[key] for key in self.arms if key in known)
        several = len({arm.component for arm in arms}) > 1
        strips = [_measure_strip(arm, known[arm.key], _group(arm, several=several)) for arm in arms]
        title = f"{name(measure_label(info)).capitalize()} by scenario"
        rows = [
            (arm.scenario, ArmRow(arm, known[arm.key], strip.five))
            for arm, strip in zip(arms, strips, strict=True)
        ]
        return Picture(
            title,
            strip_plot(strips, Frame(f"measure-{place}", title, _unit(info))),
            f"{one_line(info.meaning)}. Runs that have no number stand apart, in the margin.",
            Table("scenario", ARM_COLUMNS, rows, caption=f"{title}, in numbers"),
            not_drawn(self._arms_left_out, "cases are"),
        )

    def _of_pairs(self, measure: str, place: int) -> Picture | None:
        info, known = self._measures[measure], list(self.differences(measure))
        if not known:
            return None
        several = len({each.arm.component for each in known}) > 1
        strips = [_difference_strip(each, _group(each.arm, several=several)) for each in known]
        order = {group: i for i, group in reversed(list(enumerate(each.group for each in strips)))}
        strips.sort(key=lambda strip: order[strip.group])
        rows, left_out = bounded(strips)
        title = f"Differences of {name(measure_label(info))} in pairs of equal seeds"
        frame = Frame(
            f"difference-{place}", title, f"with minus without, {_unit(info)}", right=300.0,
            width=1060.0, zero=True,
        )  # fmt: skip
        about = (
            "of each pair, the run with the fault or the role, minus the run without it. Pairs in "
            "which one run alone has a number are counted in the margin: lost, where the run with "
            "it has none; gained, where the run without it has none."
        )
        more = not_drawn(left_out, "comparisons are")
        return Picture(title, strip_plot(rows, frame), about, left_out=more)

    def differences(self, measure: str) -> Iterator[Differences]:
        """Yield what faults change, then what each role changes that an arm lacks."""
        by_scenario: dict[tuple[str, str], list[Arm]] = defaultdict(list)
        for arm in self.arms.values():
            if arm.key not in self.numbers[measure]:
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
        ours, theirs = self.numbers[measure][arm.key], self.numbers[measure][twin.key]
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


@dataclass(frozen=True)
class ArmRow:
    """A measure's numbers in an arm."""

    arm: Arm
    numbers: Numbers
    five: FiveNumbers | None


def _number(place: int) -> Callable[[ArmRow], str | None]:
    return lambda row: None if row.five is None else number_text(row.five[place])


ARM_COLUMNS: Sequence[Column[ArmRow]] = (
    Column("arm", lambda row: name(row.arm.label), kind=""),
    Column("n", lambda row: len(row.numbers.of_seed), heading="n"),
    Column("without a number", lambda row: len(row.numbers.seeds)),
    *(
        Column(title, _number(place))
        for place, title in enumerate(
            ("least", "first quartile", "median", "third quartile", "greatest")
        )
    ),
)


def _unit(measure: MeasureInfo) -> str:
    label = name(measure_label(measure))
    return f"{label} in {name(measure.unit)}" if measure.unit else label


def _group(arm: Arm, *, several: bool) -> str:
    return f"{arm.scenario} with {arm.component}" if several else arm.scenario


def _measure_strip(arm: Arm, numbers: Numbers, group: str) -> Strip:
    values = list(numbers.of_seed.values())
    apart = len(numbers.seeds)
    note = f"n = {len(values)}" + (f", \N{MULTIPLICATION X} {apart} without" if apart else "")
    note += f", {numbers.left_out} more runs" if numbers.left_out else ""
    five = five_numbers(values)
    return Strip(arm.label, five, dots_of(values), (), note, apart > 0, group, arm.form)


def _difference_strip(each: Differences, group: str) -> Strip:
    numbers = each.numbers
    less = sum(number < -_EQUAL for number in numbers)
    more = sum(number > _EQUAL for number in numbers)
    note = f"{less} less, {len(numbers) - less - more} equal, {more} more"
    if each.lost or each.gained:
        note += f"; \N{MULTIPLICATION X} {each.lost} lost, {each.gained} gained"
    if each.arm.faults and each.change != "+".join(each.arm.faults):
        label = f"{each.change}, under {'+'.join(each.arm.faults)}"
    else:
        label = each.change
    five = five_numbers(numbers)
    form = each.twin.form if each.twin.without else each.arm.form
    return Strip(label, five, dots_of(numbers), (), note, bool(each.lost), group, form)
