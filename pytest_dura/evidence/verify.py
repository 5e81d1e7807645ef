"""Verify a bundle: hashes, schema, formats, traces, and whatever follows from the episodes.

The record's own sums are checked in ``verify_record``, its verdicts in ``verify_verdicts``.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from importlib import import_module
from pathlib import Path
from typing import Any

from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import ConfigurationError, DuraError
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
from pytest_dura.evidence.episodes import outcome_figures
from pytest_dura.evidence.files import file_entry, files_below, listed_files, manifest_problems
from pytest_dura.evidence.junit import junit_problems
from pytest_dura.evidence.mcap import read_trace
from pytest_dura.evidence.metrics import CaseMetrics, PooledMetrics, SharedViolations
from pytest_dura.evidence.model import Counts, SessionRecord, plain_data
from pytest_dura.evidence.redaction import count_redactions
from pytest_dura.evidence.sessions import reuse_problems
from pytest_dura.evidence.traces import Trace, trace_path
from pytest_dura.evidence.verify_record import record_problems
from pytest_dura.evidence.verify_verdicts import verdict_problems
from pytest_dura.requirements.checks import is_function_path
from pytest_dura.requirements.episode_verdicts import EpisodeVerdict, JudgedEpisode, judge_episode
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.monitoring.quality import MonitorQuality


def _format_problems(record: SessionRecord, counts: Counts) -> Iterator[str]:
    """Everything in which the formats differ from the record."""
    for item in all_formats():
        for problem in _problems_of_format(item, record, counts):
            yield f"{item.FILE}: {problem}"


def _other_version(record: SessionRecord) -> str | None:
    """The version that wrote the record, where it is not this one, which renders other texts."""
    # The package's own name is loaded in any case; importing it here would reach for all of it.
    version = str(record["tool"]["version"])
    return None if version == import_module("pytest_dura").__version__ else version


def _problems_of_format(item: Format, record: SessionRecord, counts: Counts) -> Iterator[str]:
    try:
        yield from _format_differences(item, record, counts)
    except Exception as error:  # a damaged record may break what renders it anywhere
        yield f"cannot be read back ({type(error).__name__}: {error})"


def _format_differences(item: Format, record: SessionRecord, counts: Counts) -> Iterator[str]:
    text = (record.directory / item.FILE).read_bytes().decode()
    told, held = item.read_counts(text).to_json(), counts.to_json()
    for name in held:
        if told[name] != held[name]:
            yield f"states {name} = {told[name]}, and the record holds {held[name]}"
    if _other_version(record) is None and text != _as_read_back(item.render(record)):
        yield "not as it is rendered from the record"
    broken = getattr(item, "broken_references", None)
    if broken is not None:
        yield from broken(text, record)
    for fragment in re.findall(r"report\.html#([\w.:~+%/-]+)", text):
        if f'id="{fragment}"' not in _report_text(record):
            yield f"refers to report.html#{fragment}, which is not there"


def _as_read_back(text: str) -> str:
    """A text as it is read back from its file."""
    return text.encode(errors="backslashreplace").decode()


def _report_text(record: SessionRecord) -> str:
    return (record.directory / "report.html").read_text(encoding="utf-8")


Data = Mapping[str, Any]
CaseKey = tuple[str, str]
_AFTERWARDS = ("redacted", "totals")
"""What was not there when redactions were counted."""


def recomputed_problems(record: SessionRecord) -> Iterator[str]:
    """Everything derived in a record that does not come out of it again."""
    yield from _case_problems(record)
    again = coverage(record["cases"], record["verdicts"], record.episodes())
    yield from _differences("coverage", record["coverage"], again)
    told = record["timings"]
    spent = {name: told[name] for name in ("wall_seconds", "evidence_seconds")}
    yield from _differences("timings", told, timings(record.episodes(), **spent))
    hidden = count_redactions({k: v for k, v in record.head.items() if k not in _AFTERWARDS})
    for episode in record.episodes():
        hidden += count_redactions(episode)
    yield from _differences("redacted", record["redacted"], dict(hidden))
    cases = {(case["id"], case["component"]) for case in record["cases"]}
    for number, monitor in enumerate(record["monitors"]):
        if (monitor["case"], monitor["component"]) not in cases:
            yield f"monitors/{number}: its case is not listed"
        yield from _monitor_problems(f"monitors/{number}", monitor)


def _case_problems(record: SessionRecord) -> Iterator[str]:
    metrics: dict[CaseKey, CaseMetrics] = defaultdict(CaseMetrics)
    heard: dict[CaseKey, set[int]] = defaultdict(set)
    shared = SharedViolations(record["verdicts"])
    pooled, courses = (
        PooledMetrics(record["cases"], record["verdicts"]),
        PairedCourses(record["verdicts"]),
    )
    for episode in record.episodes():
        if episode["planned"]:
            shared.add(episode)
            pooled.add(episode)
            courses.add(episode)
            key = episode["case"], episode["component"]
            metrics[key].add(episode)
            heard[key].add(episode["spec"]["run"])
    also_withouts = [verdict["also_without"] for verdict in record["verdicts"]]
    yield from _differences("verdicts: also_without", also_withouts, shared.to_json())
    yield from _differences("overall", record["overall"], pooled.to_json())
    again = effectiveness(record["verdicts"], record["monitors"], courses)
    yield from _differences("effectiveness", record["effectiveness"], again)
    judged = verdicts_on_cases(record["verdicts"])
    for case in record["cases"]:
        key, name = (case["id"], case["component"]), f"case {case['id']}"
        yield from _differences(
            f"{name}: metrics", case["metrics"], metrics[key].to_json(case["planned"])
        )
        missing = missing_runs(case, judged.get(key, []), heard[key])
        yield from _differences(name, {key: case[key] for key in missing}, missing)
        override = case["runs_override"]
        if override is not None and case["planned"] not in (0, override):
            yield f"{name}: {case['planned']} runs planned,"
            f" and --dura-runs={override} replaces them"


def _monitor_problems(name: str, item: Data) -> Iterator[str]:
    again = MonitorQuality.from_json(item)
    yield from _differences(name, item, {"case": item["case"], **again.to_json()})
    times = again.delays if again.horizon is None else again.lead_times
    if len(times) != again.true_positives or (again.delays and again.lead_times):
        yield f"{name}: {again.true_positives} true positives, and {len(times)} times of them"
    if again.late + again.early > again.false_negatives:
        yield f"{name}: more late and early alarms than false negatives"
    if again.false_positives > again.false_alarms:
        yield f"{name}: fewer false alarms than episodes with one"


def _differences(name: str, told: Any, again: Any) -> Iterator[str]:
    """The first place at which two pieces of plain data differ, if there is one."""
    for place, item, other in _element_differences(name, told, plain_data(again)):
        yield f"{place} is {item}, and the record gives {other}"
        return


def _presence(there: bool) -> str:
    return "there" if there else "not"


def _element_differences(name: str, told: Any, again: Any) -> Iterator[tuple[str, str, str]]:
    if isinstance(told, Mapping) and isinstance(again, Mapping):
        for key in [*told, *(key for key in again if key not in told)]:
            if key in told and key in again:
                yield from _element_differences(f"{name}/{key}", told[key], again[key])
            else:
                yield f"{name}/{key}", _presence(key in told), _presence(key in again)
    elif isinstance(told, list) and isinstance(again, list):
        if len(told) != len(again):
            yield f"{name}: its number", str(len(told)), str(len(again))
        for number, (item, other) in enumerate(zip(told, again, strict=False)):
            yield from _element_differences(f"{name}/{number}", item, other)
    elif told != again or isinstance(told, bool) != isinstance(again, bool):
        yield name, repr(told)[:80], repr(again)[:80]


@dataclass
class RejudgedCount:
    """How many verdicts on single episodes were judged again on their traces.

    Args:
        judged: Judged again, whether they were violations or not.
        left_out: Violations without a trace, of pairs, or by a function, which is not run here.
        found: What was found, by the number of the verdict in the record and the episode's id.
    """

    judged: int = 0
    left_out: int = 0
    found: dict[tuple[int, str], EpisodeVerdict] = field(default_factory=dict)


def trace_problems(record: SessionRecord, rejudged: RejudgedCount) -> Iterator[str]:
    """Everything in which traces differ from the record; counts what was judged again."""
    requirements = {requirement["id"]: requirement for requirement in record["requirements"]}
    verdicts: dict[tuple[str, str], list[tuple[int, Data]]] = defaultdict(list)
    for number, verdict in enumerate(record["verdicts"]):
        if verdict["requirement"] in requirements:  # another one is told as such
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
    """Whether the level of the evidence and its trace go together."""
    level, trace = record["evidence_level"], episode["trace"]
    if trace is None:
        # One that could not be written is told, and so is an episode that ran differently again.
        told = any(reason.startswith("infrastructure: ") for reason in record["gate"]["reasons"])
        if not told and (level == "all" or (level == "violations" and violated)):
            yield f"it has no trace, at the evidence level {level}"
        return
    if level == "summary":
        yield "it has a trace, at the evidence level summary"
    if violated and trace["kept_for"] != "violation":
        yield f"its trace is kept for {trace['kept_for']!r}, and it violated a requirement"
    if trace["file"] != trace_path(episode):
        yield f"its trace is {trace['file']}, and that of others"


def rests_on(verdict: Data, episode: Data) -> bool:
    """Whether a verdict may rest on an episode of its case; that of a campaign on the first runs.

    Further ones are those of another requirement on the same case, which needed more of them.
    """
    return bool(
        episode["planned"] and (not verdict["check"] or episode["spec"]["run"] < verdict["run"])
    )


@dataclass(frozen=True)
class _Claim:
    """What a verdict says of one episode: that it is a counterexample, or that it is none."""

    number: int
    requirement: Requirement | None
    counterexample: Data | None

    @classmethod
    def of(cls, number: int, verdict: Data, requirement: Data, episode: Data) -> _Claim:
        """Without a requirement where it cannot be judged on a trace alone."""
        listed = [
            counterexample
            for counterexample in verdict["counterexamples"]
            if counterexample["episode"] == episode["id"]
        ]
        check = verdict["check"]
        by_formula = check and not is_function_path(check) and verdict["paired"] is None
        judged_by = Requirement.from_json({**requirement, "check": check}) if by_formula else None
        return cls(number, judged_by, listed[0] if listed else None)


def _problems_of_trace(
    record: SessionRecord, episode: Data, claims: list[_Claim], rejudged: RejudgedCount
) -> Iterator[str]:
    told, file = episode["trace"], record.directory / episode["trace"]["file"]
    if file_entry(file) != {"sha256": told["sha256"], "bytes": told["bytes"]}:
        yield f"not the file that the record names for {episode['id']}"
        return
    trace = read_trace(file)
    for key in ("id", "case", "component", "seed", "digest", "validity", "termination", "failure"):
        if trace.about[key] != episode[key]:
            yield f"its {key} is {trace.about[key]!r}, and the record says {episode[key]!r}"
    if [_comparable_event(event) for event in trace.events] != episode["events"]:
        yield f"its events are not those of {episode['id']} in the record"
    again = _trace_episode(trace, episode)
    measured = outcome_figures(again)
    for key in ("flagged", "collided", "clearance_time", "gridlock", "switching"):
        if plain_data(measured[key]) != episode["outcome"][key]:
            yield f"its {key} is {measured[key]}, and the record says {episode['outcome'][key]}"
    for claim in claims:
        if claim.requirement is None:
            rejudged.left_out += claim.counterexample is not None
        else:
            rejudged.judged += 1
            found = judge_episode(claim.requirement, again)
            rejudged.found[claim.number, episode["id"]] = found
            yield from _rejudged_problems(found, claim.counterexample)


def _comparable_event(event: Data) -> dict[str, Any]:
    """An event as the record has it; a trace says of it whether it hangs on the machine's speed."""
    return {key: value for key, value in event.items() if key != "wall_clock"}


def _rejudged_problems(verdict: EpisodeVerdict, counterexample: Data | None) -> Iterator[str]:
    if counterexample is None:
        if verdict.verdict == "violated":
            yield (
                f"violates {verdict.requirement} at {verdict.time} s"
                f" by {verdict.margin}, "
                "and the record does not say so"
            )
    elif (verdict.verdict, verdict.time, verdict.margin) != (
        "violated", counterexample["time"], counterexample["margin"],
    ):  # fmt: skip
        yield (
            f"{verdict.requirement} on it is {verdict.verdict} at {verdict.time} s"
            f" by {verdict.margin}, "
            f"and the record says violated at {counterexample['time']} s by "
            f"{counterexample['margin']}"
        )


def _trace_episode(trace: Trace, episode: Data) -> JudgedEpisode:
    """The episode as far as formulas look at it."""
    names = {item.name for item in fields(FaultRecord)}
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
"""What reading a file meets that is not as it was written."""


@dataclass
class Verification:
    """What the check of a bundle came to.

    Args:
        problems: Every difference, as ``file: what``; an intact bundle has none.
        files: Files that were looked at.
        counts: What the record holds, if it could be read.
        rejudged: How much was judged again, on traces.
        not_rendered: The version that wrote the bundle, where it is another one than this, so that
            its formats were not rendered again: of their texts, counts and references alone were
            compared.
    """

    problems: list[str]
    files: int = 0
    counts: Counts | None = None
    rejudged: RejudgedCount = field(default_factory=RejudgedCount)
    not_rendered: str | None = None

    @property
    def intact(self) -> bool:
        """Whether nothing differs that was compared. It says nothing of the gate."""
        return not self.problems


def verify_bundle(directory: Path, junit: Path | None = None) -> Verification:
    """Check a bundle against itself: its hashes, its references, its sums, its formats.

    Nothing of the user's code is run, and nothing is written.

    Args:
        directory: The evidence directory.
        junit: The JUnit file of the same session, which lies elsewhere, if it is to be compared.

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
    odd = [name for name in names if not (directory / name).is_symlink()]
    odd = [name for name in odd if not (directory / name).is_file()]
    if odd:  # reading a pipe would wait for ever
        return Verification([f"{name}: no file, where a bundle holds files only" for name in odd])
    verification = Verification([], len(names))
    try:
        record = read_session_record(directory)
    except ConfigurationError as error:
        verification.problems += [*manifest_problems(directory), f"{RECORD_FILE}: {error}"]
        return verification
    verification.problems += manifest_problems(directory, _kept_episodes(record, names))
    try:
        verification.problems += _schema_problems(record)
        if any(problem.startswith(f"{RECORD_FILE}: schema") for problem in verification.problems):
            return verification  # sums and references of what has another shape say nothing
        verification.counts = Counts.of(record)
        verification.problems += record_problems(record, verification.counts)
    except DAMAGE_ERRORS as error:
        verification.problems.append(_damaged(error))
        return verification
    verification.problems += _extra_files(record)
    verification.not_rendered = _other_version(record)
    verification.problems += _format_problems(record, verification.counts)
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
    """The files from which a session that did not pass can be resumed; no part of its evidence."""
    gate = record.head.get("gate")
    if not isinstance(gate, Mapping) or gate.get("result") == "passed":
        return []
    return [name for name in names if _RESUME_FILE.fullmatch(name)]


def _extra_files(record: SessionRecord) -> Iterator[str]:
    """Files that the manifest lists and that no bundle has."""
    made = {RECORD_FILE, *RENDERED_FILES}
    made.update(
        episode["trace"]["file"] for episode in record.episodes() if episode["trace"] is not None
    )
    for name in sorted(set(listed_files(record.directory)) - made):
        yield f"{name}: in the manifest, and no file of this bundle"


def derived_problems(record: SessionRecord, rejudged: RejudgedCount) -> Iterator[str]:
    """What follows from the episodes, computed again."""
    for problem in recomputed_problems(record):
        yield f"{RECORD_FILE}: {problem}"
    for problem in reuse_problems(record):
        yield f"{RECORD_FILE}: {problem}"
    for problem in verdict_problems(record, rejudged.found):
        yield f"{RECORD_FILE}: {problem}"


def _schema_problems(record: SessionRecord) -> Iterator[str]:
    from pytest_dura.evidence.schema import check_record

    for problem in check_record(record):
        yield f"{RECORD_FILE}: schema: {problem}"
