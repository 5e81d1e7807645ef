"""Side by side: what the bundles of several sessions show of different components.

Each component is held against the first one. Verdicts are compared as with a baseline; measures and
failure modes where a run of equal case, number, seed and conditions is valid for both. Nothing is
pooled for a test: pairs of one case are independent of each other, those of two cases with equal
seeds are not.
"""

from __future__ import annotations

import math
import os
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from statistics import fmean
from typing import Any

from pytest_dura.core.codec import encode
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.measures import MeasureInfo
from pytest_dura.evidence.baseline import (
    Claim,
    Conditions,
    claims_of,
    corrected_comparisons,
    uncorrected_comparisons,
)
from pytest_dura.evidence.bundle import RECORD_FILE, open_record
from pytest_dura.evidence.case_model import Percentiles
from pytest_dura.evidence.conclusions.failure_modes import percentile_summary
from pytest_dura.evidence.entry import plain_data
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.files import file_entry, files_below, require_directory
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import one_line
from pytest_dura.evidence.verify import hash_problems, resume_files
from pytest_dura.requirements.comparison import BaselineComparison, holm, mcnemar

_KEY = "DIR"
MOST_COMPONENTS = 26
"""Components side by side at most: they are named by letters."""


@dataclass(frozen=True)
class ModeCount:
    """How often a failure mode showed, over valid runs.

    Args:
        kind: ``failure``, ``control`` or ``comparison``.
        hits: Decisions that showed it.
        of: Decisions that could have.
        null_hits: The same of the null component.
        null_of: Decisions of it that could have.
        episodes: Runs in which it ever showed.
        of_episodes: Runs in which it could have.
    """

    kind: str
    hits: int = 0
    of: int = 0
    null_hits: int = 0
    null_of: int = 0
    episodes: int = 0
    of_episodes: int = 0


@dataclass(frozen=True)
class Figures:
    """What the planned runs of the cases that all components share come to, for one of them.

    Args:
        run: Runs.
        valid: Valid ones, on which all that follows rests.
        measures: Mean of each measure, a truth value as a share; ``None`` without a value.
        failure_modes: By name.
        answer_times: Percentiles of the wall-clock seconds of decisions; ``None`` without any.
        answer_ages: Percentiles of their ages in simulated seconds; ``None`` without any.
        usage: What they used by their components' accounts, by name; ``None`` where none tells.
    """

    run: int
    valid: int
    measures: Mapping[str, float | None]
    failure_modes: Mapping[str, ModeCount]
    answer_times: Percentiles | None
    answer_ages: Percentiles | None
    usage: Mapping[str, int] | None


@dataclass(frozen=True)
class VerdictShown:
    """A verdict of one component.

    Args:
        requirement: Id of the requirement.
        case: Id of the case.
        item: Node id of the test.
        verdict: ``supported``, ``violated`` or ``undecided``.
        violations: Valid episodes that violated it.
        episodes: Valid episodes.
    """

    requirement: str
    case: str
    item: str
    verdict: str
    violations: int
    episodes: int


@dataclass(frozen=True)
class Side:
    """One component of one bundle.

    Args:
        letter: Names it in tables.
        component: Its name.
        directory: The bundle, as the user gave it.
        sha256: Digest of the record.
        created: When its session began.
        status: ``complete`` or ``interrupted``.
        gate: Result of the session's gate, which may be on further components.
        base_seed: The session's.
        verdicts: All of the component, in the record's order.
        figures: Over the shared cases.
    """

    letter: str
    component: str
    directory: str
    sha256: str
    created: str
    status: str
    gate: str
    base_seed: int
    verdicts: Sequence[VerdictShown]
    figures: Figures


@dataclass(frozen=True)
class PairedDifference:
    """A figure in the pairs of one case, or of all cases.

    Args:
        name: Of the measure or failure mode.
        case: Id of the case; ``None`` for all, which has no test.
        pairs: Runs that have a value with both components.
        reference: Mean over them with the first component; a truth value as a share.
        value: Mean over them with the other component.
        more: Pairs in which the other component's value is greater.
        less: Pairs in which it is less.
        p_value: Two-sided, of the exact sign test, which for truth values is McNemar's.
        p_holm: Adjusted for all such tests of the comparison.
    """

    name: str
    case: str | None
    pairs: int
    reference: float
    value: float
    more: int
    less: int
    p_value: float | None = None
    p_holm: float | None = None


@dataclass(frozen=True)
class Contrast:
    """One component against the first one.

    Args:
        letter: Of the component.
        reference: Letter of the first one.
        pairs: Runs of equal case, number, seed and conditions that are valid for both.
        unlike: For each case whose runs of equal seeds differ in conditions: in which.
        verdicts: As with a baseline; ``worse`` is worse than the first component.
        measures: By case, after those over all cases.
        failure_modes: Whether each ever showed in a run; by case, after those over all cases.
    """

    letter: str
    reference: str
    pairs: int
    unlike: Mapping[str, Sequence[str]]
    verdicts: Sequence[BaselineComparison]
    measures: Sequence[PairedDifference]
    failure_modes: Sequence[PairedDifference]


@dataclass(frozen=True)
class SideBySide:
    """Comparison of several components.

    Args:
        sides: The components; the first one is the reference.
        cases: Ids of the cases that all of them share.
        measures: What simulators declare that all sessions agree on.
        contrasts: Each other component against the first one.
        left_out: In words, what was not compared.
    """

    sides: Sequence[Side]
    cases: Sequence[str]
    measures: Sequence[MeasureInfo]
    contrasts: Sequence[Contrast]
    left_out: Sequence[str] = ()

    def to_json(self) -> dict[str, Any]:
        """Convert to plain data; what a bundle says is as it is recorded there."""
        data = {key: value for key, value in vars(self).items() if key != "measures"}
        measures = [encode(measure) for measure in self.measures]
        plain = {
            key: [asdict(each) if not isinstance(each, str) else each for each in value]
            for key, value in data.items()
        }
        return {"hashes": "hold", "correction": "Holm", "measures": measures} | {
            key: plain_data(value) for key, value in plain.items()
        }


def compare_bundles(directories: Sequence[Path]) -> SideBySide:
    """Compare the components of several bundles, whose hashes must hold.

    Args:
        directories: The evidence directories, that of the reference first.

    Raises:
        ConfigurationError: For what is no bundle, is not as it was written, is of another version,
            a shard or unfinished; for fewer than two components, and where they share nothing.
    """
    real = Counter(os.path.realpath(directory) for directory in directories)
    for directory in directories:
        if real[os.path.realpath(directory)] > 1:
            raise ConfigurationError(
                "the same evidence is named twice",
                key=_KEY,
                found=str(directory),
                expected="different directories",
                remedy="give each session its own, with --dura-evidence",
            )
    sides = [side for directory in directories for side in _sides_of(directory)]
    if not 2 <= len(sides) <= MOST_COMPONENTS:
        components = ", ".join(f"{side.component} of {side.directory}" for side in sides)
        raise ConfigurationError(
            "too few components to compare" if len(sides) < 2 else "too many components to compare",
            key=_KEY,
            found=one_line(components),
            expected=f"2 to {MOST_COMPONENTS} components",
            remedy="name an evidence directory for each component",
        )
    cases = _shared_cases(sides)
    measures = _shared_measures([side.record for side in sides])
    contrasts = [_contrast(number, sides, measures) for number in range(1, len(sides))]
    _refuse_other_simulator(sides, cases)
    return SideBySide(
        [side.shown(number, cases, measures) for number, side in enumerate(sides)],
        cases,
        measures,
        _corrected(contrasts),
        list(_left_out(sides, cases, measures)),
    )


@dataclass(frozen=True)
class _Run:
    """What a comparison needs of an episode."""

    conditions: Conditions
    validity: str
    measures: Mapping[str, Any]
    tallies: Mapping[str, ModeCount]
    answer_seconds: Sequence[float]
    answer_ages: Sequence[float]
    usage: Mapping[str, int] | None

    @classmethod
    def of(cls, episode: EpisodeEntry) -> _Run:
        metrics = episode.metrics
        return cls(
            Conditions.of(episode.spec),
            episode.validity,
            episode.outcome.measures,
            {name: ModeCount(**encode(tally)) for name, tally in metrics.tallies.items()},
            metrics.answer_seconds,
            metrics.answer_ages,
            metrics.answer_usage,
        )


@dataclass(frozen=True)
class _Read:
    """A component of a bundle as it was read."""

    directory: str
    component: str
    record: SessionRecord
    claims: Sequence[Claim]
    runs: Mapping[str, Mapping[int, _Run]] = field(default_factory=dict)
    """By case and number."""

    def shown(self, number: int, cases: Sequence[str], measures: Sequence[MeasureInfo]) -> Side:
        head = self.record.head
        own = [verdict for verdict in head.verdicts if verdict.component == self.component]
        return Side(
            letter=_letter(number),
            component=self.component,
            directory=self.directory,
            sha256=str(file_entry(self.record.directory / RECORD_FILE)["sha256"]),
            created=head.created,
            status=head.status,
            gate=head.gate.result,
            base_seed=head.base_seed,
            verdicts=[
                VerdictShown(
                    **{each.name: getattr(verdict, each.name) for each in fields(VerdictShown)}
                )
                for verdict in own
            ],
            figures=_figures([run for case in cases for run in self.runs[case].values()], measures),
        )


def _letter(number: int) -> str:
    return chr(ord("A") + number)


def _sides_of(directory: Path) -> Iterator[_Read]:
    """Read a bundle and yield its components.

    Raises:
        ConfigurationError: For one that cannot be compared.
    """
    require_directory(directory)
    file = directory / RECORD_FILE
    record = open_record(file, _KEY)
    head = record.head
    if head.status == "running" or head.shard is not None:
        is_shard = head.shard is not None
        raise ConfigurationError(
            "this is a shard of a session"
            if is_shard
            else "this session was killed, or still runs",
            file=str(file),
            key="shard" if is_shard else "status",
            found="a part of the planned verdicts" if is_shard else head.status,
            expected="the record of a whole session",
            remedy="run `python -m pytest_dura merge` first" if is_shard else "run it to its end",
        )
    problems = list(hash_problems(directory, resume_files(files_below(directory))))
    if problems:
        rest = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise ConfigurationError(
            f"this bundle is not as it was written: {one_line(problems[0])}{rest}",
            file=str(file),
            key=_KEY,
            found=len(problems),
            expected="a bundle that agrees with its manifest.json",
            remedy="run `python -m pytest_dura verify` on it, restore its files, or run the "
            "session again",
        )
    # Those in which a role is switched off are second runs, for verdicts on pairs.
    second = {(case.id, case.component) for case in head.cases if case.without}
    runs: dict[str, dict[str, dict[int, _Run]]] = defaultdict(lambda: defaultdict(dict))
    for episode in record.episodes():
        if episode.planned and (episode.case, episode.component) not in second:
            runs[episode.component][episode.case].setdefault(episode.spec.run, _Run.of(episode))
    try:
        claims = claims_of(record)
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(
            "the record contradicts itself",
            file=str(file),
            key=_KEY,
            found=str(error),
            expected="a record as pytest-dura wrote it",
            remedy="restore the file, or run the session again",
        ) from None
    for component in sorted(runs):
        own = [claim for claim in claims if claim.component == component]
        yield _Read(str(directory), component, record, own, runs[component])


def _shared_cases(sides: Sequence[_Read]) -> list[str]:
    """List the cases that every component was run on, in the order of the first record.

    Raises:
        ConfigurationError: Without any.
    """
    order = dict.fromkeys(case.id for case in sides[0].record.head.cases)
    shared = [case for case in order if all(case in side.runs for side in sides)]
    if not shared:
        # Of three that share nothing, the first that has nothing in common with the first one.
        other = next((s for s in sides if not order.keys() & s.runs.keys()), sides[-1])
        raise ConfigurationError(
            "these components share no case, so that there is nothing to compare",
            key=_KEY,
            found=f"{_some(other.runs)} in {other.directory}",
            expected=f"{_some(order)}, as in {sides[0].directory}",
            remedy="run the sessions with the same scenarios, faults and --dura-select",
        )
    return shared


def _some(cases: Iterable[str]) -> str:
    """Names of a few cases."""
    names = sorted(cases)
    more = f" and {len(names) - 2} more" if names[2:] else ""
    return one_line(", ".join(names[:2]) + more, 100)


def _refuse_other_simulator(sides: Sequence[_Read], cases: Sequence[str]) -> None:
    """Refuse bundles of which no shared case was run in the same simulator.

    Raises:
        ConfigurationError: Naming the simulators.
    """
    first = _simulators(sides[0], cases)
    for side in sides[1:]:
        own = _simulators(side, cases)
        if first.isdisjoint(own):
            raise ConfigurationError(
                "these components were run in different simulators",
                key=_KEY,
                found=one_line(f"{', '.join(sorted(own))} in {side.directory}"),
                expected=one_line(f"{', '.join(sorted(first))}, as in {sides[0].directory}"),
                remedy="run both in the same simulator",
            )


def _simulators(side: _Read, cases: Sequence[str]) -> set[str]:
    runs = (run for case in cases for run in side.runs[case].values())
    return {run.conditions.values["simulator.path"] for run in runs}


def _shared_measures(records: Sequence[SessionRecord]) -> list[MeasureInfo]:
    """List the measures that all records describe alike, in the order of tables."""
    first, *others = (record.head.measures for record in records)
    functions = [{measure.name: measure.function for measure in other} for other in others]
    return [
        measure
        for measure in first
        if all(f.get(measure.name) == measure.function for f in functions)
    ]


def _left_out(
    sides: Sequence[_Read], cases: Sequence[str], measures: Sequence[MeasureInfo]
) -> Iterator[str]:
    """Describe what is not compared, since not all components have it."""
    every = sorted({case for side in sides for case in side.runs} - {*cases})
    if every:
        yield f"cases that not all of them were run on: {', '.join(every)}"
    names = {measure.name for side in sides for measure in side.record.head.measures}
    rest = sorted(names - {measure.name for measure in measures})
    if rest:
        yield f"measures that not all of them have, or not as the same function: {', '.join(rest)}"
    for number, side in enumerate(sides):
        if side.record.head.status != "complete":
            yield f"what the session of {_letter(number)} did not come to: it was interrupted"


def _figures(runs: Sequence[_Run], measures: Sequence[MeasureInfo]) -> Figures:
    valid = [run for run in runs if run.validity == "valid"]
    means = {}
    for measure in measures:
        values = [value for run in valid if (value := _number(run, measure.name)) is not None]
        means[measure.name] = fmean(values) if values else None
    modes: dict[str, ModeCount] = {}
    for run in valid:
        for name, tally in run.tallies.items():
            mode = modes.get(name, ModeCount(tally.kind))
            counts = ("hits", "of", "null_hits", "null_of")
            modes[name] = replace(
                mode,
                **{count: getattr(mode, count) + getattr(tally, count) for count in counts},
                episodes=mode.episodes + (tally.hits > 0),
                of_episodes=mode.of_episodes + (tally.of > 0),
            )
    usages = [run.usage for run in valid if run.usage is not None]
    used = dict.fromkeys(name for usage in usages for name in usage)
    return Figures(
        len(runs),
        len(valid),
        means,
        modes,
        percentile_summary(value for run in valid for value in run.answer_seconds),
        percentile_summary(value for run in valid for value in run.answer_ages),
        {name: sum(usage.get(name, 0) for usage in usages) for name in used} or None,
    )


def _number(run: _Run, measure: str) -> float | None:
    """A measure of a run, a truth value as 0 or 1; ``None`` where it has none."""
    value = run.measures.get(measure)
    return None if value is None or not math.isfinite(value) else float(value)


def _shown(run: _Run, mode: str) -> float | None:
    """Whether a failure mode ever showed in a run, as 0 or 1; ``None`` where it could not."""
    tally = run.tallies.get(mode)
    return None if tally is None or not tally.of else float(tally.hits > 0)


def _contrast(number: int, sides: Sequence[_Read], measures: Sequence[MeasureInfo]) -> Contrast:
    """Compare a component with the first one, on the cases that the two share."""
    reference, own = sides[0], sides[number]
    pairs: dict[str, list[tuple[_Run, _Run]]] = {}
    unlike: dict[str, list[str]] = {}
    for case in (case for case in reference.runs if case in own.runs):
        first, second = reference.runs[case], own.runs[case]
        for run in sorted(first.keys() & second.keys()):
            both = first[run], second[run]
            if both[0].conditions.seed != both[1].conditions.seed:
                continue
            if both[0].conditions != both[1].conditions:
                unlike.setdefault(case, both[0].conditions.differences(both[1].conditions))
            elif both[0].validity == both[1].validity == "valid":
                pairs.setdefault(case, []).append(both)
    modes = sorted({name for each in pairs.values() for both in each for name in both[1].tallies})
    return Contrast(
        letter=_letter(number),
        reference=_letter(0),
        pairs=sum(map(len, pairs.values())),
        unlike=unlike,
        verdicts=uncorrected_comparisons(own.claims, reference.claims),
        measures=[
            difference
            for measure in measures
            for difference in _differences(measure.name, pairs, _number)
        ],
        failure_modes=[d for mode in modes for d in _differences(mode, pairs, _shown)],
    )


def _differences(
    name: str, pairs: Mapping[str, Sequence[tuple[_Run, _Run]]], value_of: Any
) -> Iterator[PairedDifference]:
    """Yield the difference over all cases, without a test, then that of each case."""
    by_case: dict[str, list[tuple[float, float]]] = {}
    for case, both in pairs.items():
        values = [(value_of(first, name), value_of(second, name)) for first, second in both]
        known = [(a, b) for a, b in values if a is not None and b is not None]
        if known:
            by_case[case] = known
    if by_case:
        yield _difference(name, None, [pair for known in by_case.values() for pair in known])
    for case, known in by_case.items():
        difference = _difference(name, case, known)
        yield replace(difference, p_value=mcnemar(difference.more, difference.less))


def _difference(
    name: str, case: str | None, known: Sequence[tuple[float, float]]
) -> PairedDifference:
    return PairedDifference(
        name=name,
        case=case,
        pairs=len(known),
        reference=fmean(first for first, _ in known),
        value=fmean(second for _, second in known),
        more=sum(second > first for first, second in known),
        less=sum(second < first for first, second in known),
    )


def _corrected(contrasts: Sequence[Contrast]) -> list[Contrast]:
    """Correct by Holm's method: all verdicts together, and all measures and failure modes."""
    verdicts = iter(corrected_comparisons([each for c in contrasts for each in c.verdicts]))
    tested = [
        difference.p_value
        for contrast in contrasts
        for difference in (*contrast.measures, *contrast.failure_modes)
        if difference.p_value is not None
    ]
    adjusted = iter(holm(tested))

    def correct(differences: Sequence[PairedDifference]) -> list[PairedDifference]:
        return [
            each if each.p_value is None else replace(each, p_holm=next(adjusted))
            for each in differences
        ]

    return [
        replace(
            contrast,
            verdicts=[next(verdicts) for _ in contrast.verdicts],
            measures=correct(contrast.measures),
            failure_modes=correct(contrast.failure_modes),
        )
        for contrast in contrasts
    ]
