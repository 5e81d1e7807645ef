"""Cards of survivors: how near each came to being caught, by what, and what would catch it."""

from __future__ import annotations

from collections.abc import Iterator

from pytest_dura.evidence.text import counted
from pytest_dura.qualification.results import Margin, Qualified
from pytest_dura.qualification.table import CONFIDENCE, named, place, results_of, runs_for_share
from pytest_dura.reports.columns import Shown
from pytest_dura.reports.document import Level, Picture, Plot, not_drawn
from pytest_dura.reports.plots.plot import PlotKind
from pytest_dura.reports.plots.strips import Frame, Strip, strip_plot

MAX_CARDS = 40


class SurvivorCards(PlotKind):
    """Draws a card for each survivor that uses up a margin, the one nearest to be caught first.

    They are no causes of a failed gate, and stand beside the matrix: table and summary have the
    same of all survivors.
    """

    weight = Level.PAGE
    place = 91

    def plots(self) -> Iterator[Plot]:
        """Draw them; nothing without survivors."""
        left = [each for each in results_of(self.head) if each.status == "survived"]
        near = [(each.nearest, each) for each in left if each.nearest is not None]
        near.sort(key=lambda pair: pair[0].share)
        if not near:
            return
        others = [each.name for each in left if each.nearest is None]
        text = f" No margin says how near {named(others)} came." if others else ""
        yield Plot(
            "How near each survivor came to being caught",
            tuple(_card(number, *pair) for number, pair in enumerate(near[:MAX_CARDS])),
            "Two circles: the worst margin of the nearest requirement with the defect, and without "
            f"it, where that would be caught at 0.{text}",
            left_out=not_drawn(len(near[MAX_CARDS:]), "survivors are"),
            small=True,
            shown=Shown.PAGE,
        )


def _card(number: int, near: Margin, result: Qualified) -> Picture:
    runs = runs_for_share(near.nearer, near.runs, CONFIDENCE)
    soon = (
        f", in {counted(runs, 'run')} with a probability of {100 * CONFIDENCE:.0f} %"
        if runs
        else ""
    )
    frame = Frame(
        f"survivor-{number}", result.name, "worst margin, in the unit of the check", width=500.0,
        left=110.0, right=110.0, zero=True, against="caught",
    )  # fmt: skip
    used = f"{100 * (1 - near.share):.0f} % used up"
    return Picture(
        result.name,
        strip_plot([Strip(near.requirement, None, (near.left, near.before), note=used)], frame),
        f"{result.about}. Nearest is {near.requirement} on {place(near.case, near.provoker)}, of "
        f"whose margin of {near.before:.3g} it leaves {near.left:.3g}. Asked for a margin above "
        f"{near.left:.3g}, up to {near.before:.3g}, that would catch it{soon}.",
    )
