"""Tables of a qualification: what is caught by which requirement, and what is left of the rest."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

from pytest_dura.core.codec import decode
from pytest_dura.evidence import Claim, ConcludedColumn, Table
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import CellValue, RecordHead
from pytest_dura.qualification.requirement import ROLE as REQUIREMENT
from pytest_dura.qualification.results import NAME, Kill, Qualified
from pytest_dura.requirements.rate_tests import lower_bound, upper_bound

CONFIDENCE = 0.95
_MOST_NAMED = 4


def results_of(head: RecordHead) -> list[Qualified]:
    """Read the results of a record, in the order of the plan."""
    facts = [fact for fact in head.facts or () if fact.table == NAME]
    return [decode(Qualified, dict(fact.data)) for fact in facts]


def caught_text(results: Sequence[Qualified]) -> str:
    """Say how many seeded defects are caught, with a two-sided interval."""
    caught, of = sum(each.status == "caught" for each in results), len(results)
    level = (1.0 + CONFIDENCE) / 2.0
    low, high = lower_bound(caught, of, level), upper_bound(caught, of, level)
    return (
        f"the suite catches {caught} of {of} seeded defects "
        f"({100 * CONFIDENCE:.0f} % interval {100 * low:.0f} to {100 * high:.0f} %)"
    )


class _OfResults(Table):
    """A table of the results, which see no episode of the session."""

    def add(self, episode: EpisodeEntry) -> None:
        """Add nothing: episodes with mutants are in no record."""

    def introduction(self, results: Sequence[Qualified]) -> str:  # noqa: ARG002 - for overrides
        """Return what stands above it; by default what it shows."""
        return self.about

    def rows(self) -> Iterable[Sequence[CellValue]]:
        """Return its rows; none without a qualification."""
        results = results_of(self.head)
        if not results:
            return ()
        self.about = self.introduction(results)  # type: ignore[misc]
        return self.of(results)

    def of(self, results: Sequence[Qualified]) -> Iterator[Sequence[CellValue]]:
        """Yield the rows."""
        raise NotImplementedError


class SeededDefects(_OfResults):
    """One row for each mutant."""

    name = NAME
    title = "Seeded defects"
    columns = (
        ConcludedColumn("mutant", "the part, and what is wrong with it"),
        ConcludedColumn("result", "whether the gate would fail by it"),
        ConcludedColumn("by", "requirements that it violates, on the case of the fewest runs"),
        ConcludedColumn("on", "the case; beside it the component that provoked it"),
        ConcludedColumn("runs", "with the mutant"),
        ConcludedColumn(
            "for 95 %", "runs of that case that catch it with a probability of 95 %, at the share "
            "of runs that was observed to", "runs",
        ),
    )  # fmt: skip

    def introduction(self, results: Sequence[Qualified]) -> str:
        """Say what is caught, and what the interval does not say."""
        return (
            f"{caught_text(results)[0].upper()}{caught_text(results)[1:]}. The interval is that of "
            "defects drawn like these; which defects a system has is not known."
        )

    @classmethod
    def claims(cls, head: RecordHead) -> Sequence[Claim]:
        """Return the goal that the suite catches seeded defects, and those of each part."""
        results = results_of(head)
        by_part: dict[str, list[Qualified]] = defaultdict(list)
        for result in results:
            by_part[result.role].append(result)
        return (
            Claim(
                "",
                "The suite catches defects of what its verdicts rest on, to the extent that they "
                f"were seeded: {caught_text(results)}. No verdict rests on this.",
                shown=True,
            ),
            *(claim for part, own in by_part.items() for claim in _claims(part, own)),
        )

    def of(self, results: Sequence[Qualified]) -> Iterator[Sequence[CellValue]]:
        """Yield a row for each mutant."""
        for result in results:
            kill = quickest(result)
            if kill is None:
                yield result.name, result.status, None, None, result.runs, None
                continue
            same = [each for each in result.kills
                    if (each.case, each.provoker) == (kill.case, kill.provoker)]  # fmt: skip
            yield (
                result.name,
                result.status
                if kill.violated
                else f"{result.status}, {kill.why.partition(';')[0]}",
                named([each.requirement for each in same]),
                place(kill.case, kill.provoker),
                result.runs,
                runs_for_power(kill),
            )


def _claims(part: str, results: Sequence[Qualified]) -> Iterator[Claim]:
    """Yield what is caught of the defects of a part, and what is left open."""
    left = [each.name for each in results if each.status != "caught"]
    caught, what = len(results) - len(left), f"seeded defects of the {part.replace('_', ' ')}"
    if caught:
        yield Claim(part, f"Of {len(results)} {what}, the suite catches {caught}.", shown=True)
    if left:
        others = f"the other {len(left)}" if caught else f"the {len(left)}"
        text = f"The suite catches {others} {what}. Not shown: {named(left)}."
        yield Claim(f"{part}-left", text, shown=False)


class Survivors(_OfResults):
    """One row for each mutant that nothing catches."""

    name = f"{NAME}_survivors"
    title = "Defects that nothing catches"
    about = (
        "One that uses up a margin would be caught by that requirement if more of a margin were "
        "asked of it than is left, and passes without it up to what there was, if its reason "
        "allows a tighter bound; the runs for 95 % are those with the tightest one, at the share "
        "of runs that was observed. One that uses up none needs a requirement on what it changes; "
        "one without whom no run would differ, a scenario that needs the part, or nothing, if it "
        "is equivalent"
    )
    columns = (
        ConcludedColumn("mutant"),
        ConcludedColumn("what is wrong"),
        ConcludedColumn("nearest", "the requirement whose margin it uses up most, on its case"),
        ConcludedColumn("left", "worst margin with it, in the unit of the check"),
        ConcludedColumn("before", "the same without it"),
        ConcludedColumn("would catch it", "asked of that requirement, in the unit of its check"),
        ConcludedColumn("for 95 %", "runs with that bound", "runs"),
    )

    def of(self, results: Sequence[Qualified]) -> Iterator[Sequence[CellValue]]:
        """Yield a row for each of them."""
        for result in results:
            near = result.nearest
            if result.status == "caught":
                continue
            if near is None:
                nothing: str = result.status
                if nothing == "survived":
                    of_requirement = result.role == REQUIREMENT
                    nothing = "no run tells it apart" if of_requirement else "uses up no margin"
                yield result.name, result.about, nothing, None, None, None, None
                continue
            where = f"{near.requirement} on {place(near.case, near.provoker)}"
            yield (
                result.name,
                result.about,
                where,
                near.left,
                near.before,
                f"a margin above {near.left:.3g}, up to {near.before:.3g}",
                runs_for_share(near.nearer, near.runs, CONFIDENCE),
            )


def place(case: str, provoker: str) -> str:
    """Name a case, and the component that provoked what happened there."""
    return f"{case} ({provoker})" if provoker else case


class Catchers(_OfResults):
    """One row for each requirement."""

    name = f"{NAME}_requirements"
    title = "What each requirement catches"
    about = (
        "By the runs that were made: a mutant that the first run of some case reveals is run no "
        "further. A requirement that catches nothing alone may still be needed for what was not "
        "seeded"
    )
    columns = (
        ConcludedColumn("requirement"),
        ConcludedColumn("catches", "mutants"),
        ConcludedColumn("alone", "mutants that no other requirement catches"),
        ConcludedColumn("on", "cases, those with the most first"),
    )

    def of(self, results: Sequence[Qualified]) -> Iterator[Sequence[CellValue]]:
        """Yield a row for each requirement of the record, the one that catches most first."""
        caught: dict[str, set[str]] = defaultdict(set)
        cases: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
        by: dict[str, set[str]] = defaultdict(set)
        for result in results:
            for kill in result.kills:
                caught[kill.requirement].add(result.name)
                cases[kill.requirement][kill.case].add(result.name)
                by[result.name].add(kill.requirement)
        known = {each.id for each in self.head.requirements} if results else set()
        for name in sorted({*known, *caught}, key=lambda each: (-len(caught[each]), each)):
            alone = sum(by[mutant] == {name} for mutant in caught[name])
            ordered = sorted(cases[name], key=lambda case: (-len(cases[name][case]), case))
            yield name, len(caught[name]), alone, named(ordered) if ordered else None


def quickest(result: Qualified) -> Kill | None:
    """Choose the kill that shows in the largest share of its runs, and in the first of them."""
    order = {id(kill): place for place, kill in enumerate(result.kills)}
    return min(
        result.kills,
        key=lambda kill: (not kill.violated, kill.run, -kill.violated / kill.runs, order[id(kill)]),
        default=None,
    )


def runs_for_power(kill: Kill, power: float = CONFIDENCE) -> int | None:
    """Runs in which it is caught with this probability, at the observed share.

    The share rests on the few runs of a qualification: it is an estimate, and no bound.
    """
    return runs_for_share(kill.violated, kill.runs, power)


def runs_for_share(shown: int, runs: int, power: float) -> int | None:
    """Runs of which one shows it with a probability, where some of these did."""
    if not shown:
        return None
    share = shown / runs
    return 1 if share >= 1.0 else math.ceil(math.log(1.0 - power) / math.log(1.0 - share))


def named(names: Sequence[str]) -> str:
    """Name a few of several things."""
    known = list(dict.fromkeys(names))
    more = f" and {len(known) - _MOST_NAMED} more" if len(known) > _MOST_NAMED else ""
    return ", ".join(known[:_MOST_NAMED]) + more


def qualification_objections(head: RecordHead, at_least: float | None) -> list[str]:
    """List what a demanded share of caught defects does not let pass; it fails closed.

    Args:
        head: Of the record.
        at_least: Least acceptable share; ``None`` accepts any.
    """
    if at_least is None:
        return []
    results = results_of(head)
    if not results:
        return ["qualification: no mutant was run, so that nothing shows what the suite catches"]
    lost = [each.name for each in results if each.status == "not run"]
    objections = [f"qualification: {named(lost)} not run"] if lost else []
    caught = sum(each.status == "caught" for each in results)
    if caught < at_least * len(results):
        asked = f"at least {100 * at_least:.4g} % are demanded"
        objections.append(f"qualification: {caught_text(results)}, and {asked}")
    return objections
