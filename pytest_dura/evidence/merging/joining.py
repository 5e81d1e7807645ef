"""Joining: the records of all parts as one, by the code that makes the record of a session."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pytest_dura.evidence.merging.parts import Part
from pytest_dura.evidence.record.evidence_record import EvidenceRecord
from pytest_dura.evidence.record.faults import UNFOLLOWED
from pytest_dura.evidence.record.gate import NO_TESTS, OK, TESTS_FAILED, Gate
from pytest_dura.evidence.record.item_report import ItemReport
from pytest_dura.evidence.record.reuse import joined_reuse
from pytest_dura.evidence.record.session_record import components_under_test

Data = Mapping[str, Any]
_OF_ITS_OWN = {"metrics", "missing_runs", "missing_runs_total", "repeat"}
_OF_ALL = {"others", "sources"}
"""What the first component holds of the others."""
_KEPT_FOR = ("all", "sample", "missing", "violation")
"""Of several reasons to keep a trace the last one is told."""


def header(parts: Sequence[Part], output: Path) -> dict[str, Any]:
    """What a session's record begins with; see the schema for what is whose.

    Args:
        parts: Ordered by their numbers.
        output: Where the merged evidence goes.
    """
    first = parts[0].record
    dirty = [one.record["environment"]["git"]["dirty"] for one in parts]
    git = {**first["environment"]["git"], "dirty": True if any(dirty) else dirty[0]}
    return {
        "created": min(one.record["created"] for one in parts),
        "tool": first["tool"],
        "command": whole_command(first["command"], output),
        "base_seed": first["base_seed"],
        "evidence_level": first["evidence_level"],
        "require_repeatable": first["require_repeatable"],
        "environment": {**first["environment"], "git": git},
        "execution": first["execution"],
        "argument": first["argument"],
        "reuse": joined_reuse(one.record["reuse"] for one in parts),
        "shard": None,
        "selection": first["selection"],
        "merged_from": [_told(one) for one in parts],
    }


def _told(part: Part) -> dict[str, Any]:
    record, gate = part.record, part.record["gate"]
    return {
        "index": part.index,
        "count": part.shard["count"],
        "plan": part.shard["plan"],
        "units": len(part.units),
        **{key: record[key] for key in ("created", "finished", "command", "environment")},
        "gate": gate["result"],
        "exit_code": gate["exit_code"],
        "wall_seconds": record["timings"]["wall_seconds"],
        "record": part.sha256,
    }


def whole_command(command: str, output: Path) -> str:
    """The command of the whole session: that of a shard, without it, and with this evidence."""
    try:
        words = shlex.split(command)
    except ValueError:  # no shell reads such a command
        words = ["pytest"]
    kept: list[str] = []
    given = iter(words)
    for word in given:
        name, equals, _ = word.partition("=")
        if name not in ("--dura-shard", "--dura-evidence"):
            kept.append(word)
        elif not equals:
            next(given, None)
    return shlex.join([*kept, f"--dura-evidence={output}"])


def join(record: EvidenceRecord, parts: Sequence[Part]) -> None:
    """Take the parts into a record, a few episodes at a time.

    An episode that two parts hold is that of a test which chooses its episodes itself. It is the
    same one in both, or the record says, as that of a session, that it came out differently.

    Raises:
        ConfigurationError: If the episodes cannot be kept.
    """
    for part in parts:
        told = part.record
        report = ItemReport("")
        report.components += [
            _without(one, _OF_ALL) for one in components_under_test(told) if one["name"]
        ]
        report.sources.update(told["component_under_test"].get("sources", {}))
        report.cases += [_without(one, _OF_ITS_OWN) for one in told["cases"]]
        report.repeats += [
            {**one["repeat"], "case": one["id"], "component": one["component"]}
            for one in told["cases"]
            if one["repeat"] is not None
        ]
        report.requirements += map(dict, told["requirements"])
        report.monitors += map(dict, told["monitors"])
        report.models += [{**one, "process": part.name} for one in told["models"]]
        report.notes += told["reuse"]["problems"]
        record.add(report.to_json())
        for verdict in told["verdicts"]:
            record.adopt(dict(verdict))
        for search in told["searches"]:
            record.searches.adopt(search)
    traced = _traced(parts)
    # What is told of an episode first holds, and a trace is that of the part which told it.
    for with_trace in (True, False):
        for part in parts:
            for episode in part.record.episodes():
                if (traced.get(_identity(episode)) == part.index) == with_trace:
                    record.add(_report_of(episode, with_trace=with_trace).to_json())


def _traced(parts: Iterable[Part]) -> dict[tuple[str, ...], int]:
    """The part whose trace of an episode is kept: the first of those with the best reason."""
    found: dict[tuple[str, ...], tuple[int, int]] = {}
    for part in parts:
        for episode in part.record.episodes():
            if episode["trace"] is not None:
                one = -_KEPT_FOR.index(episode["trace"]["kept_for"]), part.index
                key = _identity(episode)
                found[key] = min(one, found.get(key, one))
    return {key: index for key, (_, index) in found.items()}


def _identity(episode: Data) -> tuple[str, ...]:
    return episode["id"], episode["component"], episode["digest"]


def _report_of(episode: Data, *, with_trace: bool) -> ItemReport:
    """An episode as the item told it that ran it; what came of its faults was told beside it."""
    report = ItemReport("", episodes=[{**episode, "trace": None}])
    about = {"component": episode["component"], "episode": episode["id"], "case": episode["case"]}
    for fault in episode["faults"]:
        followed = {key: fault[key] for key in UNFOLLOWED}
        if followed != UNFOLLOWED:
            report.chains.append({**about, "id": fault["id"], **followed})
    if with_trace:
        trace = {key: episode[key] for key in ("id", "component", "digest", "trace")}
        report.traces.append(trace)
    return report


def _without(data: Data, keys: set[str]) -> dict[str, Any]:
    return {key: value for key, value in data.items() if key not in keys}


def joined_inputs(parts: Iterable[Part]) -> list[dict[str, Any]]:
    """Every input file of any part; changed, if it changed while one of them ran."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for part in parts:
        for one in part.record["inputs"]:
            known = found.setdefault((one["path"], one["kind"]), dict(one))
            known["changed"] |= one["changed"]
    return [found[key] for key in sorted(found)]


def cassettes(parts: Iterable[Part]) -> dict[tuple[Any, ...], Any]:
    """The cassette of each language model; see :func:`model_key`."""
    return {model_key(one): one["cassette"] for part in parts for one in part.record["models"]}


def model_key(model: Data) -> tuple[Any, ...]:
    """What tells a model of a record from the others."""
    names = ("component", "model", "fingerprint", "prompts", "base_url", "mode")
    return tuple(model[name] for name in names)


def whole_gate(
    parts: Sequence[Part],
    verdicts: Sequence[Data],
    searches: Sequence[Data],
    objections: Sequence[str],
) -> Gate:
    """The gate of the whole, by the rules of a session: all verdicts, all tests, all objections.

    Args:
        parts: Ordered by their numbers.
        verdicts: Of the merged record.
        searches: Of the merged record.
        objections: What stands against the merged record itself.
    """
    codes = {one.record["gate"]["exit_code"] for one in parts}
    against = [reason for part in parts for reason in _objections(part)]
    code = NO_TESTS
    if codes != {NO_TESTS}:
        idle = [one for one in parts if one.record["gate"]["exit_code"] == NO_TESTS]
        against += [f"{one.name}: no test was run" for one in idle]
        found = codes - {OK, NO_TESTS}
        code = found.pop() if len(found) == 1 else TESTS_FAILED if found else OK
    return Gate.of(
        verdicts,
        list(dict.fromkeys([*objections, *against])),
        searches=searches,
        interrupted=False,
        exit_code=code,
        failed=sum(one.record["gate"]["failed"] for one in parts),
        warn_undecided=parts[0].record["gate"]["warn_undecided"],
    )


def _objections(part: Part) -> list[str]:
    """What stands against a shard beside its verdicts and its tests."""
    gate = part.record["gate"]
    by_rule = Gate.of(
        part.record["verdicts"],
        (),
        searches=part.record["searches"],
        interrupted=False,
        exit_code=gate["exit_code"],
        failed=gate["failed"],
        warn_undecided=gate["warn_undecided"],
    )
    return [reason for reason in gate["reasons"] if reason not in by_rule.reasons]
