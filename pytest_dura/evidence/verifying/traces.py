"""Whether traces are those of their episodes, and whether what they violated comes up again."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import DuraError
from pytest_dura.core.metrics import DependabilityMetrics, FaultRecord
from pytest_dura.evidence.manifest import file_entry
from pytest_dura.evidence.session_record import SessionRecord
from pytest_dura.evidence.traces.mcap_file import read_trace
from pytest_dura.evidence.traces.trace import Trace
from pytest_dura.requirements.checks import is_function_path
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.verdicts.episodes import JudgedEpisode, judge_episode

Data = Mapping[str, Any]


@dataclass
class Rejudged:
    """How many counterexamples were judged again on their traces, and how many could not be.

    Args:
        judged: Judged again.
        left_out: Without a trace, of pairs, or by a function, which this check does not run.
    """

    judged: int = 0
    left_out: int = 0


def trace_problems(record: SessionRecord, rejudged: Rejudged) -> Iterator[str]:
    """Everything in which traces differ from the record; counts what was judged again."""
    claims: dict[tuple[str, str], list[tuple[Data, Data]]] = defaultdict(list)
    for verdict in record["verdicts"]:
        for one in verdict["counterexamples"]:
            claims[one["episode"], verdict["component"]].append((verdict, one))
    requirements = {one["id"]: one for one in record["requirements"]}
    for episode in record.episodes():
        own = claims.get((episode["id"], episode["component"]), []) if episode["planned"] else []
        if episode["trace"] is None:
            rejudged.left_out += len(own)
            continue
        name = episode["trace"]["file"]
        try:
            for problem in _trace(record, episode, own, requirements, rejudged):
                yield f"{name}: {problem}"
        except (DuraError, OSError, LookupError, TypeError, ValueError, AttributeError) as error:
            yield f"{name}: cannot be read as the trace of {episode['id']} ({error})"


def _trace(
    record: SessionRecord,
    episode: Data,
    claims: list[tuple[Data, Data]],
    requirements: Mapping[str, Data],
    rejudged: Rejudged,
) -> Iterator[str]:
    told, file = episode["trace"], record.directory / episode["trace"]["file"]
    if file_entry(file) != {"sha256": told["sha256"], "bytes": told["bytes"]}:
        yield f"not the file that the record names for {episode['id']}"
        return
    trace = read_trace(file)
    for key in ("id", "case", "component", "seed", "digest", "validity", "termination", "failure"):
        if trace.about[key] != episode[key]:
            yield f"its {key} is {trace.about[key]!r}, and the record says {episode[key]!r}"
    if list(trace.events) != episode["events"]:
        yield f"its events are not those of {episode['id']} in the record"
    again = _episode(trace, episode)
    for verdict, counterexample in claims:
        requirement = {**requirements[verdict["requirement"]], "check": verdict["check"]}
        formula = verdict["check"] and not is_function_path(verdict["check"])
        if verdict["paired"] is not None or not formula:
            rejudged.left_out += 1
            continue
        rejudged.judged += 1
        found = judge_episode(Requirement.from_json(requirement), again)
        if (found.verdict, found.time, found.margin) != (
            "violated", counterexample["time"], counterexample["margin"],
        ):  # fmt: skip
            yield (
                f"{verdict['requirement']} on it is {found.verdict} at {found.time} s by "
                f"{found.margin}, and the record says violated at {counterexample['time']} s by "
                f"{counterexample['margin']}"
            )


def _episode(trace: Trace, episode: Data) -> JudgedEpisode:
    """The episode as far as formulas look at it."""
    names = {one.name for one in fields(FaultRecord)}
    faults = [
        FaultRecord(**{key: value for key, value in one.items() if key in names})
        for one in episode["faults"]
    ]
    return JudgedEpisode.of(
        Episode(
            spec=EpisodeSpec.from_json(episode["spec"]),
            time=trace.time,
            signals=dict(trace.signals),
            decisions=dict(trace.decisions),
            events=(),
            faults=tuple(faults),
            termination=episode["termination"],
            metrics=DependabilityMetrics(),
            failure=episode["failure"],
        )
    )
