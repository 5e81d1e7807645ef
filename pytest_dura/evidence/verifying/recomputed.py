"""Whether what follows from a record's episodes and verdicts is what the record says of them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

from pytest_dura.evidence.plain import plain
from pytest_dura.evidence.record.case_metrics import CaseMetrics, Pooled
from pytest_dura.evidence.record.coverage import coverage
from pytest_dura.evidence.record.effectiveness import Courses, effectiveness
from pytest_dura.evidence.record.faults import SharedViolations
from pytest_dura.evidence.record.missing_runs import missing_runs, verdicts_on_cases
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.evidence.record.timings import timings
from pytest_dura.evidence.redaction.redactor import redactions_in
from pytest_dura.requirements.monitoring.quality import MonitorQuality

Data = Mapping[str, Any]
Key = tuple[str, str]
_AFTERWARDS = ("redacted", "totals")
"""What was not there when redactions were counted."""


def recomputed_problems(record: SessionRecord) -> Iterator[str]:
    """Everything derived in a record that does not come out of it again."""
    yield from _cases(record)
    again = coverage(record["cases"], record["verdicts"], record.episodes())
    yield from _differences("coverage", record["coverage"], again)
    told = record["timings"]
    spent = {name: told[name] for name in ("wall_seconds", "evidence_seconds")}
    yield from _differences("timings", told, timings(record.episodes(), **spent))
    hidden = redactions_in({k: v for k, v in record.head.items() if k not in _AFTERWARDS})
    for episode in record.episodes():
        hidden += redactions_in(episode)
    yield from _differences("redacted", record["redacted"], dict(hidden))
    cases = {(one["id"], one["component"]) for one in record["cases"]}
    for number, one in enumerate(record["monitors"]):
        if (one["case"], one["component"]) not in cases:
            yield f"monitors/{number}: its case is not listed"
        yield from _monitor(f"monitors/{number}", one)


def _cases(record: SessionRecord) -> Iterator[str]:
    metrics: dict[Key, CaseMetrics] = defaultdict(CaseMetrics)
    heard: dict[Key, set[int]] = defaultdict(set)
    shared = SharedViolations(record["verdicts"])
    pooled, courses = Pooled(record["cases"], record["verdicts"]), Courses(record["verdicts"])
    for episode in record.episodes():
        if episode["planned"]:
            shared.add(episode)
            pooled.add(episode)
            courses.add(episode)
            key = episode["case"], episode["component"]
            metrics[key].add(episode)
            heard[key].add(episode["spec"]["run"])
    told = [one["also_without"] for one in record["verdicts"]]
    yield from _differences("verdicts: also_without", told, shared.to_json())
    yield from _differences("overall", record["overall"], pooled.to_json())
    again = effectiveness(record["verdicts"], record["monitors"], courses)
    yield from _differences("effectiveness", record["effectiveness"], again)
    judged = verdicts_on_cases(record["verdicts"])
    for one in record["cases"]:
        key, name = (one["id"], one["component"]), f"case {one['id']}"
        yield from _differences(
            f"{name}: metrics", one["metrics"], metrics[key].to_json(one["planned"])
        )
        missing = missing_runs(one, judged.get(key, []), heard[key])
        yield from _differences(name, {key: one[key] for key in missing}, missing)
        override = one["runs_override"]
        if override is not None and one["planned"] not in (0, override):
            yield f"{name}: {one['planned']} runs planned, and --dura-runs={override} replaces them"


def _monitor(name: str, one: Data) -> Iterator[str]:
    again = MonitorQuality.from_json(one)
    yield from _differences(name, one, {"case": one["case"], **again.to_json()})
    times = again.delays if again.horizon is None else again.lead_times
    if len(times) != again.true_positives or (again.delays and again.lead_times):
        yield f"{name}: {again.true_positives} true positives, and {len(times)} times of them"
    if again.late + again.early > again.false_negatives:
        yield f"{name}: more late and early alarms than false negatives"
    if again.false_positives > again.false_alarms:
        yield f"{name}: fewer false alarms than episodes with one"


def _differences(name: str, told: Any, again: Any) -> Iterator[str]:
    """The first place at which two pieces of plain data differ, if there is one."""
    for place, one, other in _places(name, told, plain(again)):
        yield f"{place} is {one}, and the record gives {other}"
        return


def _there(there: bool) -> str:
    return "there" if there else "not"


def _places(name: str, told: Any, again: Any) -> Iterator[tuple[str, str, str]]:
    if isinstance(told, Mapping) and isinstance(again, Mapping):
        for key in [*told, *(key for key in again if key not in told)]:
            if key in told and key in again:
                yield from _places(f"{name}/{key}", told[key], again[key])
            else:
                yield f"{name}/{key}", _there(key in told), _there(key in again)
    elif isinstance(told, list) and isinstance(again, list):
        if len(told) != len(again):
            yield f"{name}: its number", str(len(told)), str(len(again))
        for number, (one, other) in enumerate(zip(told, again, strict=False)):
            yield from _places(f"{name}/{number}", one, other)
    elif told != again or isinstance(told, bool) != isinstance(again, bool):
        yield name, repr(told)[:80], repr(again)[:80]
