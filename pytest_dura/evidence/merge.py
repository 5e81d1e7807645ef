"""Merge the bundles of all shards of a session into the bundle and the gate of the whole.

The records of all parts are joined by the code that makes the record of a session, and
written into a directory of their own.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pytest_dura.core.codec import encode
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.baseline import Baseline, regression_objections
from pytest_dura.evidence.bundle import begin_bundle, write_bundle
from pytest_dura.evidence.case_model import CasePlan
from pytest_dura.evidence.conclude import complete
from pytest_dura.evidence.conclusions.cases import untraced
from pytest_dura.evidence.episode_model import EpisodeEntry, TraceEntry
from pytest_dura.evidence.episodes import ItemReport, RepeatReport
from pytest_dura.evidence.files import LOCK_FILE, DirectoryLock, read_chunks, write_file
from pytest_dura.evidence.gate import NO_TESTS, OK, TESTS_FAILED, Gate
from pytest_dura.evidence.gather import RecordBuilder
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.merge_checks import (
    KEYS_OF_ALL_COMPONENTS,
    ShardBundle,
    check_complete,
    check_consistent,
    read_parts,
)
from pytest_dura.evidence.model import SessionRecord, Totals, components_under_test
from pytest_dura.evidence.objections import other_objections
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.evidence.session_model import LanguageModelEntry, MergedShard
from pytest_dura.evidence.sessions import merged_resume
from pytest_dura.evidence.traces import is_trace_path

_PLANNED_KEYS = set(CasePlan.model_fields)
_TRACE_REASONS = ("twin", "all", "sample", "missing", "violation")
"""Reasons to keep a trace; of several the last one is recorded."""


def _merged_header(parts: Sequence[ShardBundle], output: Path) -> dict[str, Any]:
    """Build the header of the merged record.

    Args:
        parts: Ordered by their numbers.
        output: Where the merged evidence goes.
    """
    first = parts[0].record.head
    dirty = [part.record.head.environment.git.dirty for part in parts]
    git = first.environment.git.replace(dirty=True if any(dirty) else dirty[0])
    return {
        "created": min(part.record.head.created for part in parts),
        "tool": first.tool,
        "command": merged_command(first.command, output),
        "base_seed": first.base_seed,
        "evidence_level": first.evidence_level,
        "require_repeatable": first.require_repeatable,
        "environment": first.environment.replace(git=git),
        "execution": first.execution,
        **_merged_second_engine(parts),
        **({} if first.llm_price is None else {"llm_price": first.llm_price}),
        **({} if first.looks is None else {"looks": first.looks}),
        "resume": merged_resume(part.record.head.resume for part in parts),
        "shard": None,
        "selection": first.selection,
        "merged_from": [_shard_summary(part) for part in parts],
    }


def _merged_second_engine(parts: Sequence[ShardBundle]) -> dict[str, Any]:
    """Sum up what the second engines of all shards were compared on, if they have one."""
    engines = [part.record.head.second_engine for part in parts]
    entries = [engine for engine in engines if engine is not None]
    if not entries:
        return {}
    left_out: Counter[str] = Counter()
    for entry in entries:
        left_out.update(entry.not_compared)
    counts = {"compared": sum(entry.compared for entry in entries), "not_compared": dict(left_out)}
    return {"second_engine": {**entries[0].to_json(), **counts}}


def _shard_summary(part: ShardBundle) -> MergedShard:
    head, shard = part.record.head, part.shard
    return MergedShard.model_validate(
        {
            "index": part.index,
            "count": shard.count,
            "plan": shard.plan,
            "units": len(part.units),
            "created": head.created,
            "finished": head.finished,
            "command": head.command,
            "environment": head.environment,
            "gate": head.gate.result,
            "exit_code": head.gate.exit_code,
            "wall_seconds": head.timings.wall_seconds,
            "record": part.sha256,
        }
    )


def merged_command(command: str, output: Path) -> str:
    """Turn the command of a shard into that of the whole session, with another evidence folder."""
    try:
        arguments = shlex.split(command)
    except ValueError:  # an unbalanced quote
        arguments = ["pytest"]
    kept: list[str] = []
    remaining = iter(arguments)
    for argument in remaining:
        name, equals, _ = argument.partition("=")
        if name not in ("--dura-shard", "--dura-evidence"):
            kept.append(argument)
        elif not equals:
            next(remaining, None)
    return shlex.join([*kept, f"--dura-evidence={output}"])


def _join_records(record: RecordBuilder, parts: Sequence[ShardBundle]) -> None:
    """Add the parts to a record, a few episodes at a time.

    An episode in two parts is that of a test which chooses its episodes itself. If it differs
    between them, the record says so, as that of a session does.

    Raises:
        ConfigurationError: If the episodes cannot be written.
    """
    for part in parts:
        head = part.record.head
        report = ItemReport("")
        report.components += [
            component.to_json(exclude=KEYS_OF_ALL_COMPONENTS)
            for component in components_under_test(part.record)
            if component.name
        ]
        report.sources.update(head.component_under_test.sources or {})
        report.cases += [
            CasePlan.model_validate(case.to_json(include=_PLANNED_KEYS)) for case in head.cases
        ]
        report.repeats += [
            RepeatReport(**case.repeat.to_json(), case=case.id, component=case.component)
            for case in head.cases
            if case.repeat is not None
        ]
        report.measures += head.measures
        report.hazards += head.hazards or []
        report.requirements += head.requirements
        report.monitors += head.monitors
        report.models += [{**model.to_json(), "process": part.name} for model in head.models]
        report.notes += head.resume.problems
        report.claimed += report.cases
        record.add(report)
        for judgement in head.judgements:
            record.add_judgement(judgement)
        for item, waiver in head.waivers.items():
            record.waive(item, waiver.kind, waiver.reason)
        for search in head.searches:
            record.searches.adopt(search)
    traced = _trace_owners(parts)
    # The first report of an episode holds, so that the owners of traces come first.
    for with_trace in (True, False):
        for part in parts:
            for episode in part.record.episodes():
                if (traced.get(_identity(episode)) == part.index) == with_trace:
                    report = _report_of(episode, with_trace=with_trace)
                    record.add(report)


def _trace_owners(parts: Iterable[ShardBundle]) -> dict[tuple[str, ...], int]:
    """Number of the part whose trace of an episode is kept: the first with the best reason."""
    owners: dict[tuple[str, ...], tuple[int, int]] = {}
    for part in parts:
        for episode in part.record.episodes():
            if episode.trace is not None:
                candidate = -_TRACE_REASONS.index(episode.trace.kept_for), part.index
                key = _identity(episode)
                owners[key] = min(candidate, owners.get(key, candidate))
    return {key: index for key, (_, index) in owners.items()}


def _identity(episode: EpisodeEntry) -> tuple[str, ...]:
    return episode.id, episode.component, episode.digest


def _report_of(episode: EpisodeEntry, *, with_trace: bool) -> ItemReport:
    """Rebuild the report of an episode, with the chains of its faults apart."""
    report = ItemReport("", episodes=[{**episode.to_json(), "trace": None}])
    about = {"component": episode.component, "episode": episode.id, "case": episode.case}
    for fault in episode.faults:
        if fault != untraced(fault):
            report.chains.append({**about, **encode(fault)})
    if with_trace:
        report.traces.append(episode.to_json(include={"id", "component", "digest", "trace"}))
    return report


def _merged_inputs(parts: Iterable[ShardBundle]) -> list[dict[str, Any]]:
    """List the input files of all parts; ``changed`` if they changed while any part ran."""
    entries: dict[tuple[str, str], dict[str, Any]] = {}
    for part in parts:
        for entry in part.record.head.inputs:
            known = entries.setdefault((entry.path, entry.kind), entry.to_json())
            known["changed"] |= entry.changed
    return [entries[key] for key in sorted(entries)]


def _merged_cassettes(parts: Iterable[ShardBundle]) -> dict[tuple[Any, ...], Any]:
    return {
        _model_key(model): model.cassette for part in parts for model in part.record.head.models
    }


def _model_key(model: LanguageModelEntry) -> tuple[Any, ...]:
    """Identify a model of a record."""
    return (
        model.component, model.model, model.fingerprint, model.prompts, model.base_url, model.mode
    )  # fmt: skip


def _merged_gate(
    parts: Sequence[ShardBundle],
    verdicts: Sequence[ItemVerdict],
    searches: Sequence[RecordedSearch],
    objections: Sequence[str],
) -> Gate:
    """Judge the whole by the rules of a session.

    Args:
        parts: Ordered by their numbers.
        verdicts: Of the merged record.
        searches: Of the merged record.
        objections: Reasons against the merged record itself.
    """
    codes = {part.record.head.gate.exit_code for part in parts}
    against = [reason for part in parts for reason in other_objections(part.record.head)]
    code = NO_TESTS
    if codes != {NO_TESTS}:
        empty = [part for part in parts if part.record.head.gate.exit_code == NO_TESTS]
        against += [f"{part.name}: no test was run" for part in empty]
        failures = codes - {OK, NO_TESTS}
        code = failures.pop() if len(failures) == 1 else TESTS_FAILED if failures else OK
    return Gate.of(
        verdicts,
        list(dict.fromkeys([*objections, *against])),
        searches=searches,
        interrupted=False,
        exit_code=code,
        failed=sum(part.record.head.gate.failed for part in parts),
        warn_undecided=parts[0].record.head.gate.warn_undecided,
    )


def check_output(output: Path, inputs: Sequence[Path]) -> None:
    """Refuse a directory that holds something, or that belongs to what is merged.

    Raises:
        ConfigurationError: If the merged evidence cannot go there.
    """
    place = output.resolve()
    for directory in inputs:
        bundle = directory.resolve()
        if place == bundle or place.is_relative_to(bundle) or bundle.is_relative_to(place):
            raise _output_error(
                "the merged evidence would go into what is merged, or around it",
                output,
                str(directory),
            )
    if output.is_symlink():
        raise _output_error("the merged evidence would go where a symbolic link leads", output)
    if output.exists() and not output.is_dir():
        raise _output_error("the merged evidence goes into a directory, and this is a file", output)
    if output.is_dir() and (held := {path.name for path in output.iterdir()} - {LOCK_FILE}):
        raise _output_error("this directory is not empty", output, min(held))


def _output_error(problem: str, output: Path, found: str | None = None) -> ConfigurationError:
    return ConfigurationError(
        problem,
        key="--output",
        found=str(output) if found is None else f"{output}, with {found}",
        expected="a directory that is empty, or that is not there yet",
        remedy="name another directory, or remove this one",
    )


def _copy_traces(record: SessionRecord, parts: Sequence[ShardBundle]) -> None:
    """Copy the traces of a merged record out of its parts, and check their digests.

    Raises:
        ConfigurationError: If one differs from its record, or cannot be written.
    """
    places: dict[tuple[str, str], Path] = {
        (episode.trace.file, episode.trace.sha256): part.record.directory
        for part in parts
        for episode in part.record.episodes()
        if episode.trace is not None
    }
    for episode in record.episodes():
        if episode.trace is not None:
            trace = episode.trace
            _copy(places[trace.file, trace.sha256], record.directory, trace)


def _copy(source: Path, target: Path, trace: TraceEntry) -> None:
    name = trace.file
    file = source / name
    # The bundle was verified, but may have changed since.
    if not is_trace_path(name) or file.is_symlink() or file.parent.is_symlink():
        raise _damaged_trace(file, "a name or a link that leads out of the bundle")
    try:
        written = write_file(target / name, read_chunks(file))
    except OSError as error:
        raise _damaged_trace(file, error.strerror or str(error)) from None
    if (written.sha256, written.bytes) != (trace.sha256, trace.bytes):
        raise _damaged_trace(file, "another file than the record names")


def _damaged_trace(file: Path, found: str) -> ConfigurationError:
    return ConfigurationError(
        "a trace changed while it was copied",
        file=str(file),
        key="BUNDLE",
        found=found,
        expected="the file that the record names, with its SHA-256",
        remedy="let nothing write to the bundles, and merge again",
    )


@dataclass(frozen=True)
class MergeResult:
    """Result of a merge.

    Args:
        shards: Number of shards.
        totals: Of the merged record.
        reasons: Why its gate did not pass; empty if it did.
    """

    shards: int
    totals: Totals
    reasons: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether the gate of the whole passed."""
        return self.totals.gate == "passed"


@dataclass(frozen=True)
class MergeComparison:
    """Comparison of the whole with a baseline.

    Args:
        baseline: An earlier record.
        fail_worse: Whether a rate that got worse fails the gate.
    """

    baseline: Baseline | None = None
    fail_worse: bool = False

    def compared(self, record: SessionRecord) -> SessionRecord:
        """Add the comparison to a record."""
        finished = None if record.head.status == "running" else record
        baseline = None if self.baseline is None else self.baseline.compared(finished)
        return record.changed(baseline=baseline)

    def objections(self, record: SessionRecord) -> list[str]:
        """Reasons against a record that was compared."""
        baseline = record.head.baseline
        return regression_objections(baseline) if self.fail_worse and baseline else []

    def inputs(self) -> list[dict[str, Any]]:
        """Entry of the baseline's file among the record's inputs."""
        baseline = None if self.baseline is None else self.baseline.session
        if baseline is None:
            return []
        return [
            {"path": baseline.path, "kind": "baseline", "sha256": baseline.sha256, "changed": False}
        ]


_NO_COMPARISON = MergeComparison()


def merge_bundles(
    directories: Sequence[Path], output: Path, comparison: MergeComparison = _NO_COMPARISON
) -> MergeResult:
    """Merge the bundles of all shards of a session.

    The order of the bundles does not matter. Nothing is written before all of them are verified
    and make up a whole session. A merge that is killed leaves a record that says so.

    Args:
        directories: Of the bundles, at least one.
        output: Where the merged evidence goes: an empty directory, or one that is made.
        comparison: Baseline to compare the whole with.

    Raises:
        ConfigurationError: For bundles that are no whole, and evidence that cannot be written.
    """
    check_output(output, directories)
    parts = read_parts(directories)
    check_complete(parts)
    check_consistent(parts)
    lock = DirectoryLock(output)
    try:
        check_output(output, directories)
        record = RecordBuilder(_merged_header(parts, output), output)
        try:
            written = _write_merged(record, parts, comparison)
        finally:
            record.close()
    finally:
        lock.release()
    return MergeResult(len(parts), written.head.totals, tuple(written.head.gate.reasons))


def _write_merged(
    record: RecordBuilder, parts: Sequence[ShardBundle], comparison: MergeComparison
) -> SessionRecord:
    warn_undecided = parts[0].record.head.gate.warn_undecided
    running = Gate.running(warn_undecided=warn_undecided)
    begin_bundle(
        _conclude_merged(comparison.compared(record.record("running")), parts, running, comparison)
    )
    _join_records(record, parts)
    whole = record.record("complete")
    tapes = _merged_cassettes(parts)
    models = [model.replace(cassette=tapes[_model_key(model)]) for model in whole.head.models]
    whole = comparison.compared(whole.changed(models=models))
    _copy_traces(whole, parts)
    against = [*record.problems, *comparison.objections(whole)]
    gate = _merged_gate(parts, whole.head.verdicts, whole.head.searches, against)
    return write_bundle(_conclude_merged(whole, parts, gate, comparison))


def _conclude_merged(
    record: SessionRecord, parts: Sequence[ShardBundle], gate: Gate, comparison: MergeComparison
) -> SessionRecord:
    timings = [part.record.head.timings for part in parts]
    finished = max(part.record.head.finished or "" for part in parts)
    return complete(
        record,
        finished=None if record.head.status == "running" else finished,
        gate=gate,
        inputs=[*_merged_inputs(parts), *comparison.inputs()],
        wall_seconds=sum(timing.wall_seconds for timing in timings),
        evidence_seconds=sum(timing.evidence_seconds for timing in timings),
        # The shards took out the secrets of the machines on which they ran.
        redact=lambda same: same,
    )
