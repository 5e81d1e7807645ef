"""Whether traces are those of their episodes, and whether what they violated comes up again."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import DuraError
from pytest_dura.core.metrics import DependabilityMetrics, FaultRecord, Tally
from pytest_dura.evidence.bundle.directory import RECORD
from pytest_dura.evidence.bundle.manifest import file_entry
from pytest_dura.evidence.plain import plain
from pytest_dura.evidence.record.episodes import outcome
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.evidence.traces.mcap_file import read_trace
from pytest_dura.evidence.traces.names import trace_path
from pytest_dura.evidence.traces.trace import Trace
from pytest_dura.requirements.checks import is_function_path
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.verdicts.episodes import (
    EpisodeVerdict,
    JudgedEpisode,
    judge_episode,
)

Data = Mapping[str, Any]


@dataclass
class Rejudged:
    """How many verdicts on single episodes were judged again on their traces.

    Args:
        judged: Judged again, whether they were violations or not.
        left_out: Violations without a trace, of pairs, or by a function, which is not run here.
        found: What was found, by the number of the verdict in the record and the episode's id.
    """

    judged: int = 0
    left_out: int = 0
    found: dict[tuple[int, str], EpisodeVerdict] = field(default_factory=dict)


def trace_problems(record: SessionRecord, rejudged: Rejudged) -> Iterator[str]:
    """Everything in which traces differ from the record; counts what was judged again."""
    requirements = {one["id"]: one for one in record["requirements"]}
    verdicts: dict[tuple[str, str], list[tuple[int, Data]]] = defaultdict(list)
    for number, one in enumerate(record["verdicts"]):
        if one["requirement"] in requirements:  # another one is told as such
            verdicts[one["case"], one["component"]].append((number, one))
    for episode in record.episodes():
        claims = [
            _Claim.of(number, one, requirements[one["requirement"]], episode)
            for number, one in verdicts[episode["case"], episode["component"]]
            if rests_on(one, episode)
        ]
        violated = any(one.counterexample is not None for one in claims)
        for problem in _kept(record, episode, violated=violated):
            yield f"{RECORD}: episode {episode['id']}: {problem}"
        if episode["trace"] is None:
            rejudged.left_out += sum(one.counterexample is not None for one in claims)
            continue
        name = episode["trace"]["file"]
        try:
            for problem in _trace(record, episode, claims, rejudged):
                yield f"{name}: {problem}"
        except (DuraError, OSError, LookupError, TypeError, ValueError, AttributeError) as error:
            yield f"{name}: cannot be read as the trace of {episode['id']} ({error})"


def _kept(record: SessionRecord, episode: Data, *, violated: bool) -> Iterator[str]:
    """Whether the level of the evidence and its trace go together."""
    level, trace = record["evidence_level"], episode["trace"]
    if trace is None:
        # One that could not be written is told, and so is an episode that ran differently again.
        told = any(one.startswith("infrastructure: ") for one in record["gate"]["reasons"])
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
        listed = [one for one in verdict["counterexamples"] if one["episode"] == episode["id"]]
        check = verdict["check"]
        by_formula = check and not is_function_path(check) and verdict["paired"] is None
        judged_by = Requirement.from_json({**requirement, "check": check}) if by_formula else None
        return cls(number, judged_by, listed[0] if listed else None)


def _trace(
    record: SessionRecord, episode: Data, claims: list[_Claim], rejudged: Rejudged
) -> Iterator[str]:
    told, file = episode["trace"], record.directory / episode["trace"]["file"]
    if file_entry(file) != {"sha256": told["sha256"], "bytes": told["bytes"]}:
        yield f"not the file that the record names for {episode['id']}"
        return
    trace = read_trace(file)
    for key in ("id", "case", "component", "seed", "digest", "validity", "termination", "failure"):
        if trace.about[key] != episode[key]:
            yield f"its {key} is {trace.about[key]!r}, and the record says {episode[key]!r}"
    if [_timeless(one) for one in trace.events] != episode["events"]:
        yield f"its events are not those of {episode['id']} in the record"
    again = _episode(trace, episode)
    measured = outcome(again)
    for key in ("flagged", "collided", "clearance_time", "gridlock", "switching"):
        if plain(measured[key]) != episode["outcome"][key]:
            yield f"its {key} is {measured[key]}, and the record says {episode['outcome'][key]}"
    for one in claims:
        if one.requirement is None:
            rejudged.left_out += one.counterexample is not None
        else:
            rejudged.judged += 1
            found = judge_episode(one.requirement, again)
            rejudged.found[one.number, episode["id"]] = found
            yield from _judged_again(found, one.counterexample)


def _timeless(event: Data) -> dict[str, Any]:
    """An event as the record has it; a trace says of it whether it hangs on the machine's speed."""
    return {key: value for key, value in event.items() if key != "wall_clock"}


def _judged_again(found: EpisodeVerdict, counterexample: Data | None) -> Iterator[str]:
    if counterexample is None:
        if found.verdict == "violated":
            yield (
                f"violates {found.requirement} at {found.time} s by {found.margin}, "
                "and the record does not say so"
            )
    elif (found.verdict, found.time, found.margin) != (
        "violated", counterexample["time"], counterexample["margin"],
    ):  # fmt: skip
        yield (
            f"{found.requirement} on it is {found.verdict} at {found.time} s by {found.margin}, "
            f"and the record says violated at {counterexample['time']} s by "
            f"{counterexample['margin']}"
        )


def _episode(trace: Trace, episode: Data) -> JudgedEpisode:
    """The episode as far as formulas look at it."""
    names = {one.name for one in fields(FaultRecord)}
    # Nothing is built here, and a bare instance could not be.
    roles = {name: {"path": one["path"]} for name, one in episode["spec"]["roles"].items()}
    faults = [
        FaultRecord(**{key: value for key, value in one.items() if key in names})
        for one in episode["faults"]
    ]
    tallies = {name: Tally(**one) for name, one in episode["metrics"]["tallies"].items()}
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
