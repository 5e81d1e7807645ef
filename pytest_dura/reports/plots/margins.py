"""Plots of margins: by how much each requirement held in the runs of its cases."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

from pytest_dura.evidence.conclusions.coverage import WORST_FIRST
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.text import counted, name
from pytest_dura.reports.columns import Shown
from pytest_dura.reports.contents import CaseKey, folded_cases, split_folded, verdict_key
from pytest_dura.reports.document import Level, Picture, Plot, not_drawn
from pytest_dura.reports.incidents import KINDS
from pytest_dura.reports.plots.plot import PlotKind
from pytest_dura.reports.plots.strips import (
    FiveNumbers,
    Frame,
    Strip,
    five_numbers,
    strip_plot,
)
from pytest_dura.requirements.campaign_verdicts import Margins

MAX_CROSSES = 60
MAX_PLOTS = 40
MAX_MARGIN_ROWS = 16
MAX_OPEN = 6
"""Plots that are unfolded."""


class MarginPlots(PlotKind):
    """Draws a plot for each requirement with margins: violated ones, and safety, first."""

    weight = Level.PAGE
    place = 3

    def plots(self) -> Iterator[Plot]:
        """Draw those that are judged on several cases."""
        by_requirement: dict[str, list[ItemVerdict]] = defaultdict(list)
        bare = 0
        for verdict in self.head.verdicts:
            if verdict.margins is None:
                bare += 1
            else:
                by_requirement[verdict.requirement].append(verdict)
        kinds = {each.id: KINDS.index(each.kind) for each in self.head.requirements}

        def worst(requirement: str) -> tuple[int, bool, int]:
            own = by_requirement[requirement]
            status = min(WORST_FIRST.index(verdict.verdict) for verdict in own)
            clean = not any(verdict.violations for verdict in own)
            return status, clean, kinds.get(requirement, len(KINDS))

        order = sorted((own for own in by_requirement if len(by_requirement[own]) > 1), key=worst)
        if not order:
            return
        folded = folded_cases(self.head)
        single = len(by_requirement) - len(order)
        about = (
            "Over the valid runs of each case; below zero the requirement is violated. The record "
            "has quartiles of a verdict's margins, which the boxes show, and the margin of each "
            "violating run, which is a cross; the margins of other runs it has not. Each picture "
            "has the unit and the scale of its own check."
        )
        about += f" {bare} verdicts have no margins." if bare else ""
        if single:
            judged = f"{counted(single, 'requirement')} {'is' if single == 1 else 'are'} judged"
            about += f" {judged} on one case alone: the margins stand in the verdict."
        yield Plot(
            "Margins of requirements",
            tuple(
                _picture(own, by_requirement[own], place, folded)
                for place, own in enumerate(order[:MAX_PLOTS])
            ),
            about,
            left_out=not_drawn(len(order[MAX_PLOTS:]), "requirements are"),
            small=True,
            shown=Shown.PAGE,
        )


def _picture(
    requirement: str, verdicts: Sequence[ItemVerdict], place: int, folded: frozenset[CaseKey]
) -> Picture:
    several = len({verdict.component for verdict in verdicts}) > 1
    shown, rest = split_folded(verdicts, folded, verdict_key)
    ordered = sorted(shown, key=lambda verdict: (verdict.margin is None, verdict.margin or 0.0))
    drawn = ordered[:MAX_MARGIN_ROWS]
    violations = sum(verdict.violations for verdict in verdicts)
    title = f"Margins of {name(requirement)}"
    frame = Frame(
        f"margin-{place}", title, "margin, in the unit of the check", width=640.0, left=215.0,
        right=110.0, zero=True, against="violated",
    )  # fmt: skip
    count = f"\N{BALLOT X} {counted(violations, 'violating run')}"
    return Picture(
        name(requirement),
        strip_plot([_margin_strip(verdict, several=several) for verdict in drawn], frame),
        left_out=not_drawn(len(ordered) - len(drawn) + len(rest), "cases are"),
        mark=count if violations else "no violation",
        opened=bool(violations) and place < MAX_OPEN,
    )


def _margin_strip(verdict: ItemVerdict, *, several: bool) -> Strip:
    margins = verdict.margins
    assert margins is not None  # verdicts without any have no row
    crosses = [
        each.margin for each in verdict.counterexamples if each.valid and each.margin is not None
    ]
    note = f"\N{MULTIPLICATION X} {verdict.violations} of {margins.n}"
    if not verdict.violations:
        note = f"0 of {margins.n}"
    label = f"{verdict.case} {verdict.component}" if several else verdict.case
    return Strip(label, _box_of(margins), (), crosses[:MAX_CROSSES], note, verdict.violations > 0)


def _box_of(margins: Margins) -> FiveNumbers | None:
    """The quartiles; of margins without an end those alone that are finite."""
    known = [margins.min, margins.q25, margins.median, margins.q75, margins.max]
    # The quartiles of five numbers are these numbers.
    return five_numbers(each for each in known if each is not None)
