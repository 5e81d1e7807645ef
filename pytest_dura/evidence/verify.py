"""Verify a bundle, in three sentences.

1. The hashes of the manifest hold.
2. Concluding from the recorded episodes gives the recorded verdicts, gate, totals, metrics and
   coverage.
3. Rendering the record gives the files, byte for byte.

The second one is checked with the code that concludes a session. What that code cannot make again,
since only the session knew it, is taken as recorded, and must not contradict itself: each line and
each table of ``conclusions`` knows what it cannot say. Nothing of the user's code is run, and
nothing is written.
"""

from __future__ import annotations

import json
import math
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from itertools import islice
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeAlias

from pytest_dura.core.codec import encode
from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.core.measures import Measure
from pytest_dura.core.metrics import DependabilityMetrics
from pytest_dura.core.simulator import SIMULATORS
from pytest_dura.evidence.bundle import (
    FORMATS,
    RECORD_FILE,
    DamagedRecordError,
    open_record,
    rendered_files,
    short_name,
)
from pytest_dura.evidence.conclude import complete, conclude, contradictions
from pytest_dura.evidence.conclusions.tables import unknown_tables
from pytest_dura.evidence.entry import plain_data
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.episodes import outcome_figures
from pytest_dura.evidence.files import (
    file_entry,
    files_below,
    listed_files,
    manifest_problems,
    require_directory,
)
from pytest_dura.evidence.junit import junit_problems
from pytest_dura.evidence.mcap import read_trace
from pytest_dura.evidence.model import RecordHead, SessionRecord, Totals
from pytest_dura.evidence.objections import judge_again
from pytest_dura.evidence.redaction import holds_redaction
from pytest_dura.evidence.text import one_line
from pytest_dura.evidence.traces import Trace, trace_path
from pytest_dura.requirements.checks import is_function_path
from pytest_dura.requirements.episode_verdicts import (
    CheckVerdict,
    EpisodeVerdict,
    JudgedEpisode,
    judge_episode,
)
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.second_engine import ENGINES_DISAGREE

_RESUME_FILE = re.compile(
    r"\.episodes/([0-9a-f]{2}/[0-9a-f]{64}\.(episode|claim)|[0-9a-f]{32}\.sources)"
)
"""Name of a file from which a failed session can be resumed, which is no evidence."""
JudgedOnTraces: TypeAlias = "dict[tuple[str, str, str, str], EpisodeVerdict]"
"""Verdicts on traces, by requirement, check, component and the episode's id."""
_IDENTITY = {"id", "component", "seed", "digest"}
"""Keys of an episode that name the file of its trace."""
_STATEMENT_FILE = "test-result.intoto.json"
_TRACED_FIGURES = ("flagged", "switching", "timeliness")
"""Figures of each episode, besides its measures, that its trace gives again."""
_MOST_DIFFERENCES = 10
"""Greatest number of differences that are listed of one key of the record."""


def hash_problems(directory: Path, kept: Collection[str]) -> Iterator[str]:
    """Check the hashes: those of the manifest, and the one of the record in a statement on it.

    Args:
        directory: The bundle.
        kept: Files from which the session can be resumed, which the manifest does not list.
    """
    yield from manifest_problems(directory, kept)
    statement = directory / _STATEMENT_FILE
    if statement.is_symlink() or not statement.exists():
        return
    try:
        subjects = json.loads(statement.read_bytes())["subject"]
        digests = [each["digest"]["sha256"] for each in subjects if each["name"] == RECORD_FILE]
    except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
        yield f"{_STATEMENT_FILE}: no statement on the record ({describe_error(error)})"
    else:
        if digests != [file_entry(directory / RECORD_FILE)["sha256"]]:
            yield f"{_STATEMENT_FILE}: a statement on another {RECORD_FILE}"


def trace_problems(record: SessionRecord, judged: JudgedOnTraces) -> Iterator[str]:
    """Yield the differences between traces and record, and collect what was judged again."""
    checks = _Checks(record)
    violating = {
        (verdict.component, counterexample.episode)
        for verdict in record.head.verdicts
        for counterexample in verdict.counterexamples
    }
    for episode in record.episodes():
        violated = episode.planned and (episode.component, episode.id) in violating
        for problem in _retention_problems(record, episode, violated=violated):
            yield f"{RECORD_FILE}: episode {episode.id}: {problem}"
        if episode.trace is None:
            continue
        name = episode.trace.file
        try:
            file = record.directory / name
            for problem in _problems_of_trace(record, file, episode, checks, judged):
                yield f"{name}: {problem}"
        except Exception as error:  # whatever a damaged trace does to its readers
            yield f"{name}: cannot be read as the trace of {episode.id} ({error})"


def _retention_problems(
    record: SessionRecord, episode: EpisodeEntry, *, violated: bool
) -> Iterator[str]:
    """Compare an episode's trace with the level of the evidence."""
    level, trace = record.head.evidence_level, episode.trace
    if trace is None:
        # The gate names traces that could not be written, and episodes that are not repeatable.
        excused = any(reason.startswith("infrastructure: ") for reason in record.head.gate.reasons)
        if not excused and (level == "all" or (level == "violations" and violated)):
            yield f"it has no trace, at the evidence level {level}"
        return
    if level == "summary":
        yield "it has a trace, at the evidence level summary"
    if trace.kept_for == "twin" and level != "violations":
        yield f"its trace is kept as a twin, at the evidence level {level}"
    if violated and trace.kept_for != "violation":
        yield f"its trace is kept for {trace.kept_for!r}, and it violated a requirement"
    if trace.file != trace_path(episode.to_json(include=_IDENTITY)):
        yield f"its trace is {trace.file}, and that of others"


class _Checks:
    """Formulas that judge recorded episodes, and what the record says of each.

    Args:
        record: The record.
    """

    def __init__(self, record: SessionRecord) -> None:
        head = record.head
        self._requirements = {known.id: known for known in head.requirements}
        self._declared = {(case.id, case.component): case.requirements for case in head.cases}
        self._asked: dict[str, list[tuple[str, str, CheckVerdict]]] = defaultdict(list)
        for judgement in head.judgements:
            for run in judgement.runs if judgement.kind == "campaign" else ():
                about = judgement.requirement, judgement.check
                for digest, verdict in (
                    (run.digest, run.verdict),
                    (run.twin, run.twin_verdict),
                    (run.reference, run.reference_verdict),
                ):
                    if verdict is not None:
                        self._asked[digest].append((*about, verdict))

    def on(self, episode: EpisodeEntry) -> Iterator[tuple[Requirement, CheckVerdict | None]]:
        """Yield each formula that judges an episode, with the recorded verdict."""
        for name in self._declared.get((episode.case, episode.component), ()):
            known = self._requirements.get(name)
            if known is not None and _is_formula(known.check):
                yield Requirement(name, check=known.check), episode.verdicts.get(name)
        for name, check, verdict in self._asked.get(episode.digest, ()):
            if _is_formula(check):
                yield Requirement(name, check=check), verdict


def _is_formula(check: str) -> bool:
    return bool(check) and not is_function_path(check)


def _problems_of_trace(
    record: SessionRecord,
    file: Path,
    episode: EpisodeEntry,
    checks: _Checks,
    judged: JudgedOnTraces,
) -> Iterator[str]:
    entry = episode.trace
    if entry is None or file_entry(file) != {"sha256": entry.sha256, "bytes": entry.bytes}:
        yield f"not the file that the record names for {episode.id}"
        return
    trace = read_trace(file)
    for key in ("id", "case", "component", "seed", "digest", "validity", "termination", "failure"):
        found, recorded = trace.about[key], getattr(episode, key)
        if found != recorded:
            yield f"its {key} is {found!r}, and the record says {recorded!r}"
    if [*trace.events] != [encode(event) for event in episode.events]:
        yield f"its events are not those of {episode.id} in the record"
    traced = _trace_episode(trace, episode)
    named = {(measure.name, measure.function) for measure in record.head.measures}
    own = episode.spec.simulator.path
    registered = {
        measure.name: measure
        for path, _, measure in _registered_measures([own, *(path for _, path in named)])
        if path == own or (measure.name, measure.path) in named
    }
    known = list(registered.values())
    figures, outcome = plain_data(outcome_figures(traced, known)), episode.outcome.to_json()
    computed = {**figures["measures"], **{key: figures.get(key) for key in _TRACED_FIGURES}}
    stated = {**outcome, **outcome["measures"]}
    for key in sorted({measure.name for measure in known} | {*_TRACED_FIGURES}):
        if computed.get(key) != stated.get(key):
            yield f"its {key} is {computed.get(key)}, and the record says {stated.get(key)}"
    for requirement, recorded in checks.on(episode):
        try:
            verdict = judge_episode(requirement, traced)
        except ConfigurationError:  # it names signals of another simulator
            if recorded is not None:
                yield f"{requirement.id} cannot be judged on it, and the record has a verdict"
            continue
        judged[requirement.id, requirement.check, episode.component, episode.id] = verdict
        yield from _rejudged_problems(verdict, recorded)


def _registered_measures(paths: Iterable[str]) -> Iterator[tuple[str, int, Measure]]:
    """Yield simulator, place and measure of what packages declare that are also in import paths.

    Nothing but what is registered is imported. Of a project's own simulator, measures are taken as
    recorded.
    """
    packages = {path.partition(".")[0] for path in paths}
    for name in SIMULATORS:
        path = SIMULATORS.path(name)
        if path.partition(".")[0] in packages:
            for place, measure in enumerate(getattr(SIMULATORS[name], "measures", ())):
                yield path, place, measure


def _measure_problems(record: SessionRecord) -> Iterator[str]:
    """Compare the measures with those of episodes, and with what registered simulators declare."""
    recorded = record.head.measures
    names = [measure.name for measure in recorded]
    in_order = sorted(recorded, key=attrgetter("place", "name"))
    if recorded != in_order or len({*names}) < len(names):
        yield "measures: not in their order, or twice"
    used = {name for episode in record.episodes() for name in episode.outcome.measures}
    for name in sorted(used ^ {*names} if used - {*names} else ()):
        yield f"measures: {name} is in episodes or in the list of measures alone"
    functions = [measure.function for measure in recorded]
    known = [measure.info(place) for _, place, measure in _registered_measures(functions)]
    packages = {measure.function.partition(".")[0] for measure in known}
    for measure in recorded:
        if measure.function.partition(".")[0] in packages and measure not in known:
            yield f"measures: {measure.name} is not as its simulator declares it"


def _rejudged_problems(verdict: EpisodeVerdict, recorded: CheckVerdict | None) -> Iterator[str]:
    """Compare a verdict on a trace with the recorded one."""
    if recorded is None:
        yield f"{verdict.requirement} on it is {verdict.verdict}, and the record has no verdict"
        return
    if recorded.status == "missing" and recorded.detail.startswith(ENGINES_DISAGREE):
        return  # only the session had both engines
    computed = (verdict.verdict, verdict.time, verdict.margin, verdict.vacuous)
    known = (recorded.status, recorded.time, recorded.margin, recorded.vacuous)
    same_detail = verdict.detail == recorded.detail or holds_redaction(recorded.detail)
    if computed != known or not same_detail:
        place = f"{verdict.verdict} at {verdict.time} s by {verdict.margin} ({verdict.detail})"
        stated = f"{recorded.status} at {recorded.time} s by {recorded.margin} ({recorded.detail})"
        yield f"{verdict.requirement} on it is {place}, and the record says {stated}"


def _trace_episode(trace: Trace, episode: EpisodeEntry) -> JudgedEpisode:
    """Rebuild the episode as far as formulas and measures read it.

    Of its performance values the record has the least and the greatest, and none where they are
    infinite.
    """
    performance = {
        name: (
            [0.0, 0.0],
            [
                -math.inf if series.min is None else series.min,
                math.inf if series.max is None else series.max,
            ],
        )
        for name, series in episode.metrics.performance.items()
    }
    return JudgedEpisode.of(
        Episode(
            spec=episode.spec,
            time=trace.time,
            signals=dict(trace.signals),
            decisions=dict(trace.decisions),
            events=tuple(episode.events),
            faults=tuple(episode.faults),
            termination=episode.termination,
            metrics=DependabilityMetrics(
                tallies=dict(episode.metrics.tallies), performance=performance
            ),
            failure=episode.failure,
        )
    )


def record_problems(record: SessionRecord) -> Iterator[str]:
    """Yield what the lines of a record cannot say together, each with the name of its file."""
    for problem in contradictions(record):
        yield f"{RECORD_FILE}: {problem}"


def conclusion_problems(record: SessionRecord) -> Iterator[str]:
    """Conclude from the recorded episodes and judgements again, and yield the differences."""
    for problem in _measure_problems(record):
        yield f"{RECORD_FILE}: {problem}"
    for name in unknown_tables(record.head):
        yield (
            f"{RECORD_FILE}: conclusions: the table {name!r} cannot be concluded again, as no "
            "installed package has it; install the package that does"
        )
    head, again = record.head.to_json(), conclude_again(record).head.to_json()
    for key in dict.fromkeys([*head, *again]):
        found, expected = ({key: each[key]} if key in each else {} for each in (head, again))
        for problem in islice(differences("", found, expected), _MOST_DIFFERENCES):
            yield f"{RECORD_FILE}: {problem}{_subject(record, problem)}"


def conclude_again(record: SessionRecord) -> SessionRecord:
    """Conclude a recorded session as it was concluded itself, from its episodes and verdicts."""
    timings = record.head.timings
    return complete(
        conclude(record),
        finished=record.head.finished,
        gate=judge_again(record.head),
        inputs=record.head.inputs,
        wall_seconds=timings.wall_seconds,
        evidence_seconds=timings.evidence_seconds,
        redact=lambda same: same,  # the session took out its secrets
    )


_ABSENT = "nothing"


def differences(pointer: str, recorded: Any, computed: Any) -> Iterator[str]:
    """Yield the places, as JSON pointers, at which plain data differs from computed data."""
    if isinstance(recorded, Mapping) and isinstance(computed, Mapping):
        for key in [*recorded, *(key for key in computed if key not in recorded)]:
            place = f"{pointer}/{str(key).replace('~', '~0').replace('/', '~1')}"
            if key in recorded and key in computed:
                yield from differences(place, recorded[key], computed[key])
            else:
                kinds = ("a value", _ABSENT) if key in recorded else (_ABSENT, "a value")
                yield f"{place}: found {kinds[0]}, expected {kinds[1]}"
    elif isinstance(recorded, list) and isinstance(computed, list):
        if len(recorded) != len(computed):
            yield f"{pointer}: found {len(recorded)} entries, expected {len(computed)}"
        for number, (found, expected) in enumerate(zip(recorded, computed, strict=False)):
            yield from differences(f"{pointer}/{number}", found, expected)
    elif recorded != computed or isinstance(recorded, bool) != isinstance(computed, bool):
        yield f"{pointer}: found {_short(recorded)}, expected {_short(computed)}"


def _short(value: Any) -> str:
    """JSON of a value, cut short."""
    return one_line(json.dumps(value, ensure_ascii=False), _MAX_SHOWN)


_MAX_SHOWN = 100
"""Characters of a value that are shown."""
_ENTRY = re.compile(r"/(cases|verdicts)/(\d+)/")


def _subject(record: SessionRecord, pointer: str) -> str:
    """Name the case or the verdict that a JSON pointer leads to."""
    match = _ENTRY.match(pointer)
    if match is None:
        return ""
    number = int(match[2])
    if match[1] == "cases":
        return f" ({record.head.cases[number].id})"
    verdict = record.head.verdicts[number]
    return f" ({verdict.requirement} on {verdict.case})"


def rendering_problems(record: SessionRecord) -> Iterator[str]:
    """Render the record again, and yield the files that come out different."""
    listed = set(listed_files(record.directory))
    for name in FORMATS:
        # A bundle that was written elsewhere has no formats of packages that are only here, and
        # none that is made on request alone unless it lists it.
        if name in listed or (FORMATS.is_ours(name) and not short_name(name)):
            try:
                # Surrogates are escaped in the file.
                rendered = FORMATS[name].render(record).encode(errors="backslashreplace")
                file = record.directory / name
                # What a link leads to may be read without end.
                equal = file.stat().st_size == len(rendered) and file.read_bytes() == rendered
            except Exception as error:  # a damaged record may break what renders it anywhere
                yield f"{name}: cannot be rendered again ({describe_error(error)})"
            else:
                if not equal:
                    yield f"{name}: not as it is rendered from the record"


def _other_version(record: SessionRecord) -> str | None:
    """Version that wrote the record, if it is another one, whose reports may differ."""
    # The package is loaded already; an import by statement would look like a circle.
    version = str(record.head.tool.version)
    return None if version == import_module("pytest_dura").__version__ else version


@dataclass
class Verification:
    """Result of the check of a bundle.

    Args:
        problems: Every difference, as ``file: what``; an intact bundle has none.
        files: Number of files that were checked.
        totals: Those of the record, if it could be read.
        rejudged: Verdicts on single episodes that were judged again on their traces.
        not_rendered: Version that wrote the bundle, if it is not this one: the third sentence was
            not checked then.
        head: Head of the record, if it could be read.
    """

    problems: list[str]
    files: int = 0
    totals: Totals | None = None
    rejudged: JudgedOnTraces = field(default_factory=dict)
    not_rendered: str | None = None
    head: RecordHead | None = None

    @property
    def intact(self) -> bool:
        """Whether no difference was found. The gate may have failed all the same."""
        return not self.problems


def verify_bundle(
    directory: Path, junit: Path | None = None, *, signed: bool = False
) -> Verification:
    """Check the three sentences on a bundle.

    Args:
        directory: The evidence directory.
        junit: The JUnit file of the same session, if it is to be compared.
        signed: Whether the bundle is, or is to be, signed: then each file has to be in the
            manifest, also those from which a session that failed can be resumed.

    Raises:
        ConfigurationError: If there is no such directory.
    """
    require_directory(directory)
    names = files_below(directory)
    paths = {name: directory / name for name in names}
    irregular = [n for n, path in paths.items() if not (path.is_symlink() or path.is_file())]
    if irregular:  # reading a pipe would never end
        return Verification(
            [f"{name}: no file, where a bundle holds files only" for name in irregular]
        )
    verification = Verification([], len(names))
    try:
        record = open_record(directory / RECORD_FILE)
    except DamagedRecordError as error:
        verification.problems += [f"{RECORD_FILE}: schema: {each}" for each in error.mismatches]
        verification.problems += hash_problems(directory, resume_files(names))
        return verification  # what follows needs the shape of the schema
    except ConfigurationError as error:
        verification.problems += [*manifest_problems(directory), f"{RECORD_FILE}: {error}"]
        return verification
    try:
        _check_sentences(verification, record, names, signed=signed)
    except Exception as error:  # whatever a damaged record does to the code that concludes it
        why = str(error).partition("\n")[0]
        verification.problems.append(f"{RECORD_FILE}: damaged ({type(error).__name__}: {why})")
    if junit is not None:
        verification.problems += junit_problems(record, junit)
    return verification


def _check_sentences(
    verification: Verification, record: SessionRecord, names: Iterable[str], *, signed: bool
) -> None:
    problems, verification.head = verification.problems, record.head
    # A session that lost runs can be resumed, also if a waiver let it pass.
    is_whole = record.head.gate.result == "passed" and not record.head.totals.missing
    kept = () if signed or is_whole else resume_files(names)
    problems += hash_problems(record.directory, kept)
    expected = {RECORD_FILE, *rendered_files()}
    expected.update(e.trace.file for e in record.episodes() if e.trace is not None)
    for name in sorted(set(listed_files(record.directory)) - expected):
        problems.append(f"{name}: in the manifest, and no file of this bundle")
    verification.totals = record.head.totals
    problems += record_problems(record)
    problems += trace_problems(record, verification.rejudged)
    problems += conclusion_problems(record)
    verification.not_rendered = _other_version(record)
    if verification.not_rendered is None:
        problems += rendering_problems(record)


def resume_files(names: Iterable[str]) -> list[str]:
    """Select the files from which a session that failed can be resumed."""
    return [name for name in names if _RESUME_FILE.fullmatch(name)]
