"""Plots of faults: the ways of runs from a fault to its outcome, and the latencies of alerts."""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from pytest_dura.core.metrics import TracedFault
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import RecordHead
from pytest_dura.evidence.text import counted, name
from pytest_dura.reports.columns import Shown, role_name
from pytest_dura.reports.document import Level, Picture, Plot, not_drawn
from pytest_dura.reports.plots.plot import PlotKind
from pytest_dura.reports.plots.strips import (
    Frame,
    Strip,
    bounded,
    dots_of,
    five_numbers,
    picture_of,
    strip_plot,
)
from pytest_dura.reports.svg import Svg, joined, tag

MAX_FLOWS = 6
MAX_LATENCIES = 5000
"""Latencies of a fault and a role that are kept."""
Step = tuple[str, ...]
"""States of a run from the first column to the one at which its way ends."""
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


_OUTCOMES = ("violated", "violated also without it", "tolerated", "contained", "masked", "idle",
             "missing", NOT_FOLLOWED)  # fmt: skip
_ORDER = (
    PLANNED, CHANGED, ALERT, ACTED, UNCHANGED, NO_ALERT, NOT_ACTED, UNKNOWN, NO_EFFECT, *_OUTCOMES
)  # fmt: skip
_ON_ITS_WAY = frozenset({PLANNED, CHANGED, ALERT, ACTED})


class FaultPlots(PlotKind):
    """Draws flows from faults to outcomes, and latencies of alerts, over arms that lack no role."""

    weight = Level.PAGE
    place = 2

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        self._whole = {(case.id, case.component) for case in head.cases if not case.without}
        self.detections: dict[str, Detections] = defaultdict(Detections)
        """By fault."""
        self.chains: dict[str, Counter[Step]] = defaultdict(Counter)
        """By fault: how many runs went which way."""

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode, if it is a planned one that was run."""
        known = (episode.case, episode.component) in self._whole
        if known and episode.planned and episode.validity != "missing":
            for fault in episode.faults:
                self._add_fault(fault)

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

    def plots(self) -> Iterator[Plot]:
        """Draw the chains of the faults that violated most, then of those that ran most."""

        def worst_first(fault: str) -> tuple[int, int, str]:
            ways = self.chains[fault]
            violated = sum(runs for way, runs in ways.items() if way[-1] == VIOLATED)
            return -violated, -ways.total(), fault

        order = sorted(self.chains, key=worst_first)
        pictures = []
        for place, fault in enumerate(order[:MAX_FLOWS]):
            flow = Flow(CHAIN, self.chains[fault], _ORDER, frozenset({VIOLATED}), _ON_ITS_WAY)
            title = f"From the fault {name(fault)} to its outcome"
            pictures.append(Picture(name(fault), flow_plot(flow, f"flow-{place}", title)))
        if pictures:
            yield Plot(
                "From faults to outcomes",
                tuple(pictures),
                "Each band is as wide as its number of runs, missing ones and arms without a role "
                "left out. A fault without an effect on a percept, or on the command, ends its way "
                "there.",
                left_out=not_drawn(len(order[MAX_FLOWS:]), "faults are"),
                shown=Shown.PAGE,
            )
        if self.detections:
            yield Plot(pictures=(self._latencies(),), shown=Shown.PAGE)

    def _latencies(self) -> Picture:
        strips: list[Strip] = []
        for fault, known in sorted(self.detections.items()):
            group = f"{fault}: manifested in {counted(known.manifested, 'run')}"
            for role, latencies in sorted(known.latencies.items()):
                values = list(latencies)
                note = f"n = {len(values)}"
                strips.append(
                    Strip(role_name(role) or "alert", five_numbers(values), dots_of(values), (),
                          note, group=group, form="filled")
                )  # fmt: skip
            if known.undetected:
                note = f"\N{MULTIPLICATION X} {known.undetected} of {known.manifested}"
                strips.append(Strip("not detected", None, (), (), note, alarming=True, group=group))
        rows, left_out = bounded(strips)
        frame = Frame(
            "detection", "Detection latency by fault and role",
            "from activation to the alert, in s", right=120.0,
        )  # fmt: skip
        about = (
            "from the activation of a fault to the first alert while it acted, by the role that "
            "raised it. Runs in which it manifested without an alert are counted apart."
        )
        more = not_drawn(left_out, "rows are")
        return Picture("Detection latency", strip_plot(rows, frame), about, left_out=more)


@dataclass
class Flow:
    """Ways of runs through the steps of a chain.

    Args:
        columns: Headings of the steps.
        ways: How many runs took which way; a way may end before the last column.
        order: States from above to below; others follow by name.
        bad: States that are marked as violations.
        good: States that are the "yes" of their step.
    """

    columns: Sequence[str]
    ways: Mapping[Step, int]
    order: Sequence[str]
    bad: frozenset[str] = frozenset()
    good: frozenset[str] = frozenset()
    _places: dict[tuple[int, str], tuple[float, float]] = field(default_factory=dict, init=False)
    """Upper end and height of each node, by column and state."""

    def nodes(self) -> list[dict[str, int]]:
        """Count the runs in each state of each column, states from above to below."""
        counts: list[Counter[str]] = [Counter() for _ in self.columns]
        for way, runs in self.ways.items():
            for column, state in enumerate(way):
                counts[column][state] += runs
        return [dict(sorted(column.items(), key=lambda each: self._rank(each[0])))
                for column in counts]  # fmt: skip

    def links(self) -> dict[tuple[int, str, str], int]:
        """Count the runs from each state to each of the next column."""
        counts: Counter[tuple[int, str, str]] = Counter()
        for way, runs in self.ways.items():
            for column, (state, after) in enumerate(pairwise(way)):
                counts[column, state, after] += runs
        order = sorted(counts, key=lambda key: (key[0], self._rank(key[1]), self._rank(key[2])))
        return {key: counts[key] for key in order}

    def _rank(self, state: str) -> tuple[int, str]:
        known = self.order.index(state) if state in self.order else len(self.order)
        return known, state


_NODE = 12.0
_FLOW_WIDTH, _FLOW_HEIGHT, _FLOW_GAP = 1060.0, 90.0, 26.0


def flow_plot(flow: Flow, ident: str, title: str) -> Svg:
    """Draw ways of runs as bands between columns, as wide as their counts.

    Args:
        flow: The ways; at least one run.
        ident: Begins the picture's anchors.
        title: What it shows.
    """
    nodes, links = flow.nodes(), flow.links()
    total = sum(nodes[0].values())
    unit = _FLOW_HEIGHT / total
    step = (_FLOW_WIDTH - 170) / max(len(flow.columns) - 1, 1)
    places: dict[tuple[int, str], float] = {}
    drawn: list[Svg] = []
    bottom = 0.0
    for column, states in enumerate(nodes):
        x, y = 4 + column * step, 34.0
        drawn.append(tag("text", flow.columns[column], class_="group", x=x, y=16.0))
        for state, runs in states.items():
            places[column, state] = y
            height = max(runs * unit, 1.5)
            kind = "bad" if state in flow.bad else "yes" if state in flow.good else "no"
            drawn.append(tag("rect", class_=f"node {kind}", x=x, y=y, width=_NODE, height=height))
            shown = f"{state}: {runs}" if column else f"{runs}"
            mark = "\N{MULTIPLICATION X} " if kind == "bad" else ""
            drawn.append(
                tag("text", mark + shown, class_="halo", x=x + _NODE + 4, y=y + height / 2 + 4)
            )
            y += height + _FLOW_GAP * (0.6 if len(states) > 3 else 1.0)
        bottom = max(bottom, y - 8)
    bands = list(_bands(flow, links, places, unit, step))
    described = "; ".join(
        f"{flow.columns[column]} {state} to {flow.columns[column + 1]} {after}: {runs}"
        for (column, state, after), runs in links.items()
    )
    return picture_of(ident, title, f"{counted(total, 'run')}. {described}.",
                    (_FLOW_WIDTH, bottom), joined([*bands, *drawn]))  # fmt: skip


def _bands(
    flow: Flow,
    links: Mapping[tuple[int, str, str], int],
    places: Mapping[tuple[int, str], float],
    unit: float,
    step: float,
) -> Iterator[Svg]:
    out, into = dict(places), dict(places)
    for (column, state, after), runs in links.items():
        x1, x2 = 4 + column * step + _NODE, 4 + (column + 1) * step
        y1, y2, height = out[column, state], into[column + 1, after], max(runs * unit, 1.0)
        out[column, state] += height
        into[column + 1, after] += height
        middle = (x1 + x2) / 2
        kind = "bad" if after in flow.bad else "yes" if after in flow.good else "no"
        curve = (
            f"M{x1:.1f} {y1:.1f}C{middle:.1f} {y1:.1f} {middle:.1f} {y2:.1f} {x2:.1f} {y2:.1f}"
            f"L{x2:.1f} {y2 + height:.1f}C{middle:.1f} {y2 + height:.1f} {middle:.1f} "
            f"{y1 + height:.1f} {x1:.1f} {y1 + height:.1f}Z"
        )
        yield tag("path", class_=f"band {kind}", d=curve)
