"""Verify a bundle: hashes, schema, formats, traces, and all that follows from the episodes.

The record's own sums are checked in ``verify_record``, its verdicts in ``verify_verdicts``.
Functions named ``..._problems`` yield a sentence for each difference.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import ConfigurationError, DuraError, describe_error
from pytest_dura.core.metrics import DependabilityMetrics, FaultRecord, Tally
from pytest_dura.evidence.bundle import (
    RECORD_FILE,
    RENDERED_FILES,
    Format,
    all_formats,
    read_session_record,
)
from pytest_dura.evidence.conclude import (
    PairedCourses,
    coverage,
    effectiveness,
    missing_runs,
    timings,
    verdicts_on_cases,
)
from pytest_dura.evidence.entry import plain_data
from pytest_dura.evidence.episodes import outcome_figures
from pytest_dura.evidence.files import file_entry, files_below, listed_files, manifest_problems
from pytest_dura.evidence.junit import junit_problems
from pytest_dura.evidence.mcap import read_trace
from pytest_dura.evidence.metrics import CaseMetrics, PooledMetrics, SharedViolations
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.redaction import count_redactions
from pytest_dura.evidence.schema import check_record
from pytest_dura.evidence.sessions import reuse_problems
from pytest_dura.evidence.traces import Trace, trace_path
from pytest_dura.evidence.verify_record import record_problems
from pytest_dura.evidence.verify_verdicts import verdict_problems
from pytest_dura.requirements.checks import is_function_path
from pytest_dura.requirements.episode_verdicts import EpisodeVerdict, JudgedEpisode, judge_episode
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.monitoring.quality import MonitorQuality


def _other_version(record: SessionRecord) -> str | None:
    """Version that wrote the record, if it is another one, whose reports may differ."""
    # The package is loaded already; an import by statement would look like a circle.
    version = str(record["tool"]["version"])
    return None if version == import_module("pytest_dura").__version__ else version


def rendering_problems(record: SessionRecord) -> Iterator[str]:
    """Render the record again, and yield the files that come out different."""
    for report_format in all_formats():
        problem = _rendering_problem(report_format, record)
        if problem:
            yield f"{report_format.FILE}: {problem}"


def _rendering_problem(report_format: Format, record: SessionRecord) -> str:
    try:
        # Surrogates are escaped in the file.
        rendered = report_format.render(record).encode(errors="backslashreplace")
        file = (record.directory / report_format.FILE).read_bytes()
    except Exception as error:  # a damaged record may break what renders it anywhere
        return f"cannot be rendered again ({describe_error(error)})"
    return "" if file == rendered else "not as it is rendered from the record"


Data = Mapping[str, Any]
CaseKey = tuple[str, str]
_AFTERWARDS = ("redacted", "totals")
"""Keys that are added after redactions are counted."""


def recomputed_problems(record: SessionRecord) -> Iterator[str]:
    """Compute what is derived in a record again, and yield the differences."""
    yield from _case_problems(record)
    computed = coverage(record["cases"], record["verdicts"], record.episodes())
    yield from _differences("coverage", record["coverage"], computed)
    recorded = record["timings"]
    measured = {name: recorded[name] for name in ("wall_seconds", "evidence_seconds")}
    yield from _differences("timings", recorded, timings(record.episodes(), **measured))
    redactions = count_redactions({k: v for k, v in record.head.items() if k not in _AFTERWARDS})
    for episode in record.episodes():
        redactions += count_redactions(episode)
    yield from _differences("redacted", record["redacted"], dict(redactions))
    cases = {(case["id"], case["component"]) for case in record["cases"]}
    for number, monitor in enumerate(record["monitors"]):
        if (monitor["case"], monitor["component"]) not in cases:
            yield f"monitors/{number}: its case is not listed"
        yield from _monitor_problems(f"monitors/{number}", monitor)


def _case_problems(record: SessionRecord) -> Iterator[str]:
    metrics: dict[CaseKey, CaseMetrics] = defaultdict(CaseMetrics)
    reported: dict[CaseKey, set[int]] = defaultdict(set)
    shared = SharedViolations(record["verdicts"])
    pooled = PooledMetrics(record["cases"], record["verdicts"])
    courses = PairedCourses(record["verdicts"])
    for episode in record.episodes():
        if episode["planned"]:
            shared.add(episode)
            pooled.add(episode)
            courses.add(episode)
            key = episode["case"], episode["component"]
            metrics[key].add(episode)
            reported[key].add(episode["spec"]["run"])
    also_without = [verdict["also_without"] for verdict in record["verdicts"]]
    yield from _differences("verdicts: also_without", also_without, shared.to_json())
    yield from _differences("overall", record["overall"], pooled.to_json())
    computed = effectiveness(record["verdicts"], record["monitors"], courses)
    yield from _differences("effectiveness", record["effectiveness"], computed)
    judged = verdicts_on_cases(record["verdicts"])
    for case in record["cases"]:
        key, name = (case["id"], case["component"]), f"case {case['id']}"
        own_metrics = metrics[key].to_json(case["planned"])
        yield from _differences(f"{name}: metrics", case["metrics"], own_metrics)
        missing = missing_runs(case, judged.get(key, []), reported[key])
        yield from _differences(name, {key: case[key] for key in missing}, missing)
        override = case["runs_override"]
        if override is not None and case["planned"] not in (0, override):
            planned = f"{case['planned']} runs planned"
            yield f"{name}: {planned}, and --dura-runs={override} replaces them"


def _monitor_problems(name: str, monitor: Data) -> Iterator[str]:
    quality = MonitorQuality.from_json(monitor)
    yield from _differences(name, monitor, {"case": monitor["case"], **quality.to_json()})
    times = quality.delays if quality.horizon is None else quality.lead_times
    if len(times) != quality.true_positives or (quality.delays and quality.lead_times):
        yield f"{name}: {quality.true_positives} true positives, and {len(times)} times of them"
    if quality.late + quality.early > quality.false_negatives:
        yield f"{name}: more late and early alarms than false negatives"
    if quality.false_positives > quality.false_alarms:
        yield f"{name}: fewer false alarms than episodes with one"


def _differences(name: str, recorded: Any, computed: Any) -> Iterator[str]:
    """Yield the first place at which plain data differs from a computed value, if there is one."""
    for place, first, second in _element_differences(name, recorded, plain_data(computed)):
        yield f"{place} is {first}, and the record gives {second}"
        return


def _presence(present: bool) -> str:
    return "there" if present else "not"


def _element_differences(name: str, recorded: Any, computed: Any) -> Iterator[tuple[str, str, str]]:
    if isinstance(recorded, Mapping) and isinstance(computed, Mapping):
        for key in [*recorded, *(key for key in computed if key not in recorded)]:
            if key in recorded and key in computed:
                yield from _element_differences(f"{name}/{key}", recorded[key], computed[key])
            else:
                yield f"{name}/{key}", _presence(key in recorded), _presence(key in computed)
    elif isinstance(recorded, list) and isinstance(computed, list):
        if len(recorded) != len(computed):
            yield f"{name}: its number", str(len(recorded)), str(len(computed))
        for number, (first, second) in enumerate(zip(recorded, computed, strict=False)):
            yield from _element_differences(f"{name}/{number}", first, second)
    elif recorded != computed or isinstance(recorded, bool) != isinstance(computed, bool):
        yield name, repr(recorded)[:80], repr(computed)[:80]


@dataclass
class RejudgedCount:
    """Verdicts on single episodes that were judged again on their traces.

    Args:
        judged: How many, violations or not.
        left_out: Violations without a trace, of pairs, or by a function, which is not run here.
        verdicts: By the number of the verdict in the record and the episode's id.
    """

    judged: int = 0
    left_out: int = 0
    verdicts: dict[tuple[int, str], EpisodeVerdict] = field(default_factory=dict)


def trace_problems(record: SessionRecord, rejudged: RejudgedCount) -> Iterator[str]:
    """Yield the differences between traces and record; collect what was judged again."""
    requirements = {requirement["id"]: requirement for requirement in record["requirements"]}
    verdicts: dict[tuple[str, str], list[tuple[int, Data]]] = defaultdict(list)
    for number, verdict in enumerate(record["verdicts"]):
        if verdict["requirement"] in requirements:  # others are reported in verify_record
            verdicts[verdict["case"], verdict["component"]].append((number, verdict))
    for episode in record.episodes():
        claims = [
            _Claim.of(number, verdict, requirements[verdict["requirement"]], episode)
            for number, verdict in verdicts[episode["case"], episode["component"]]
            if rests_on(verdict, episode)
        ]
        violated = any(claim.counterexample is not None for claim in claims)
        for problem in _retention_problems(record, episode, violated=violated):
            yield f"{RECORD_FILE}: episode {episode['id']}: {problem}"
        if episode["trace"] is None:
            rejudged.left_out += sum(claim.counterexample is not None for claim in claims)
            continue
        name = episode["trace"]["file"]
        try:
            for problem in _problems_of_trace(record, episode, claims, rejudged):
                yield f"{name}: {problem}"
        except (DuraError, OSError, LookupError, TypeError, ValueError, AttributeError) as error:
            yield f"{name}: cannot be read as the trace of {episode['id']} ({error})"


def _retention_problems(record: SessionRecord, episode: Data, *, violated: bool) -> Iterator[str]:
    """Compare an episode's trace with the level of the evidence."""
    level, trace = record["evidence_level"], episode["trace"]
    if trace is None:
        # The gate names traces that could not be written, and episodes that are not repeatable.
        excused = any(reason.startswith("infrastructure: ") for reason in record["gate"]["reasons"])
        if not excused and (level == "all" or (level == "violations" and violated)):
            yield f"it has no trace, at the evidence level {level}"
        return
    if level == "summary":
        yield "it has a trace, at the evidence level summary"
    if violated and trace["kept_for"] != "violation":
        yield f"its trace is kept for {trace['kept_for']!r}, and it violated a requirement"
    if trace["file"] != trace_path(episode):
        yield f"its trace is {trace['file']}, and that of others"


def rests_on(verdict: Data, episode: Data) -> bool:
    """Whether a verdict may rest on an episode of its case.

    The verdict of a campaign rests on the first runs of a case; another requirement on the same
    case may need more of them.
    """
    return bool(
        episode["planned"] and (not verdict["check"] or episode["spec"]["run"] < verdict["run"])
    )


@dataclass(frozen=True)
class _Claim:
    """Statement of a verdict on an episode: that it is a counterexample, or that it is none."""

    number: int
    requirement: Requirement | None
    counterexample: Data | None

    @classmethod
    def of(cls, number: int, verdict: Data, requirement: Data, episode: Data) -> _Claim:
        """Make it without a requirement if the verdict cannot be made on a trace alone."""
        listed = (e for e in verdict["counterexamples"] if e["episode"] == episode["id"])
        check = verdict["check"]
        by_formula = check and not is_function_path(check) and verdict["paired"] is None
        judged_by = Requirement.from_json({**requirement, "check": check}) if by_formula else None
        return cls(number, judged_by, next(listed, None))


def _problems_of_trace(
    record: SessionRecord, episode: Data, claims: list[_Claim], rejudged: RejudgedCount
) -> Iterator[str]:
    entry, file = episode["trace"], record.directory / episode["trace"]["file"]
    if file_entry(file) != {"sha256": entry["sha256"], "bytes": entry["bytes"]}:
        yield f"not the file that the record names for {episode['id']}"
        return
    trace = read_trace(file)
    for key in ("id", "case", "component", "seed", "digest", "validity", "termination", "failure"):
        if trace.about[key] != episode[key]:
            yield f"its {key} is {trace.about[key]!r}, and the record says {episode[key]!r}"
    # Only traces say which events depend on the machine's speed.
    events = [{k: v for k, v in event.items() if k != "wall_clock"} for event in trace.events]
    if events != episode["events"]:
        yield f"its events are not those of {episode['id']} in the record"
    traced = _trace_episode(trace, episode)
    measured = outcome_figures(traced)
    for key in ("flagged", "collided", "clearance_time", "gridlock", "switching"):
        if plain_data(measured[key]) != episode["outcome"][key]:
            yield f"its {key} is {measured[key]}, and the record says {episode['outcome'][key]}"
    for claim in claims:
        if claim.requirement is None:
            rejudged.left_out += claim.counterexample is not None
        else:
            rejudged.judged += 1
            verdict = judge_episode(claim.requirement, traced)
            rejudged.verdicts[claim.number, episode["id"]] = verdict
            yield from _rejudged_problems(verdict, claim.counterexample)


def _rejudged_problems(verdict: EpisodeVerdict, counterexample: Data | None) -> Iterator[str]:
    if counterexample is None:
        if verdict.verdict == "violated":
            place = f"{verdict.requirement} at {verdict.time} s by {verdict.margin}"
            yield f"violates {place}, and the record does not say so"
    elif (verdict.verdict, verdict.time, verdict.margin) != (
        "violated", counterexample["time"], counterexample["margin"],
    ):  # fmt: skip
        status = f"{verdict.verdict} at {verdict.time} s by {verdict.margin}"
        recorded = f"violated at {counterexample['time']} s by {counterexample['margin']}"
        yield f"{verdict.requirement} on it is {status}, and the record says {recorded}"


def _trace_episode(trace: Trace, episode: Data) -> JudgedEpisode:
    """Rebuild the episode as far as formulas read it."""
    names = {field_.name for field_ in fields(FaultRecord)}
    # Nothing is built here, and a bare instance could not be.
    roles = {name: {"path": role["path"]} for name, role in episode["spec"]["roles"].items()}
    faults = [
        FaultRecord(**{key: value for key, value in fault.items() if key in names})
        for fault in episode["faults"]
    ]
    tallies = {name: Tally(**tally) for name, tally in episode["metrics"]["tallies"].items()}
    return JudgedEpisode.of(
        Episode(
            spec=EpisodeSpec.from_json({**episode["spec"], "roles": roles}),
            time=trace.time,
            signals=dict(trace.signals),
            decisions=dict(trace.decisions),
            events=(),
            faults=tuple(faults),
            termination=episode["termination"],
            metrics=DependabilityMetrics(tallies=tallies),
            failure=episode["failure"],
        )
    )


_RESUME_FILE = re.compile(r"\.episodes/[0-9a-f]{2}/[0-9a-f]{64}\.(episode|claim)")
DAMAGE_ERRORS = (
    DuraError,
    AttributeError,
    LookupError,
    TypeError,
    ValueError,
    ArithmeticError,
    OSError,
    RecursionError,
)
"""Errors that reading a damaged file may raise."""


@dataclass
class Verification:
    """Result of the check of a bundle.

    Args:
        problems: Every difference, as ``file: what``; an intact bundle has none.
        files: Number of files that were checked.
        totals: Those of the record, if it could be read.
        rejudged: Verdicts that were judged again on traces.
        not_rendered: Version that wrote the bundle, if it is not this one; its formats were then
            not rendered again.
    """

    problems: list[str]
    files: int = 0
    totals: Data | None = None
    rejudged: RejudgedCount = field(default_factory=RejudgedCount)
    not_rendered: str | None = None

    @property
    def intact(self) -> bool:
        """Whether no difference was found. The gate may have failed all the same."""
        return not self.problems


def verify_bundle(directory: Path, junit: Path | None = None) -> Verification:
    """Check a bundle against itself: its hashes, its references, its sums, its formats.

    Nothing of the user's code is run, and nothing is written.

    Args:
        directory: The evidence directory.
        junit: The JUnit file of the same session, if it is to be compared.

    Raises:
        ConfigurationError: If there is no such directory.
    """
    if not directory.is_dir():
        raise ConfigurationError(
            "there is no such directory",
            key="DIR",
            found=str(directory),
            expected="the evidence directory of a session",
            remedy="name the directory that --dura-evidence named; by default dura-evidence",
        )
    names = files_below(directory)
    paths = {name: directory / name for name in names}
    irregular = [n for n, path in paths.items() if not (path.is_symlink() or path.is_file())]
    if irregular:  # reading a pipe would never end
        return Verification(
            [f"{name}: no file, where a bundle holds files only" for name in irregular]
        )
    verification = Verification([], len(names))
    try:
        record = read_session_record(directory)
    except ConfigurationError as error:
        verification.problems += [*manifest_problems(directory), f"{RECORD_FILE}: {error}"]
        return verification
    verification.problems += manifest_problems(directory, _kept_episodes(record, names))
    try:
        mismatches = check_record(record)
        if mismatches:
            verification.problems += [f"{RECORD_FILE}: schema: {text}" for text in mismatches]
            return verification  # sums need the shape of the schema
        verification.totals = record["totals"]
        verification.problems += record_problems(record)
    except DAMAGE_ERRORS as error:
        verification.problems.append(_damaged(error))
        return verification
    verification.problems += _extra_files(record)
    verification.not_rendered = _other_version(record)
    if verification.not_rendered is None:
        verification.problems += rendering_problems(record)
    verification.problems += trace_problems(record, verification.rejudged)
    try:
        verification.problems += derived_problems(record, verification.rejudged)
    except DAMAGE_ERRORS as error:
        verification.problems.append(_damaged(error))
    if junit is not None:
        verification.problems += junit_problems(record, junit)
    return verification


def _damaged(error: Exception) -> str:
    why = str(error).partition("\n")[0]
    return f"{RECORD_FILE}: damaged ({type(error).__name__}: {why})"


def _kept_episodes(record: SessionRecord, names: Iterable[str]) -> list[str]:
    """List the files from which a failed session can be resumed, which are no evidence."""
    gate = record.head.get("gate")
    if not isinstance(gate, Mapping) or gate.get("result") == "passed":
        return []
    return [name for name in names if _RESUME_FILE.fullmatch(name)]


def _extra_files(record: SessionRecord) -> Iterator[str]:
    """Yield the files that the manifest lists and that belong to no bundle."""
    expected = {RECORD_FILE, *RENDERED_FILES}
    expected.update(e["trace"]["file"] for e in record.episodes() if e["trace"] is not None)
    for name in sorted(set(listed_files(record.directory)) - expected):
        yield f"{name}: in the manifest, and no file of this bundle"


def derived_problems(record: SessionRecord, rejudged: RejudgedCount) -> Iterator[str]:
    """Compute what follows from the episodes again."""
    yield from (
        f"{RECORD_FILE}: {problem}"
        for problem in chain(
            recomputed_problems(record),
            reuse_problems(record),
            verdict_problems(record, rejudged.verdicts),
        )
    )
