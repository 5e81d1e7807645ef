"""Merge bundles: the union of their lines, from which the record of the whole is concluded.

The parts are sessions of one project, component and seed: all shards of a session, sessions with
other selections, merged bundles. They may overlap: equal episodes have equal digests.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from heapq import merge as merge_sorted
from itertools import groupby
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

from pytest_dura.core.codec import encode
from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.baseline import Baseline, regression_objections
from pytest_dura.evidence.bundle import FORMATS, begin_bundle, short_name, write_bundle
from pytest_dura.evidence.case_model import CasePlan
from pytest_dura.evidence.conclude import complete, conclude
from pytest_dura.evidence.conclusions.faults import untraced
from pytest_dura.evidence.conclusions.verdicts import joined_lines, test_function
from pytest_dura.evidence.entry import JsonObject
from pytest_dura.evidence.episode_model import EpisodeEntry, TraceEntry, episode_order
from pytest_dura.evidence.episodes import trace_weight
from pytest_dura.evidence.files import (
    LOCK_FILE,
    DirectoryLock,
    listed_files,
    read_chunks,
    write_file,
)
from pytest_dura.evidence.gate import NO_TESTS, OK, TESTS_FAILED, Gate, repeat_objections
from pytest_dura.evidence.gather import RecordBuilder
from pytest_dura.evidence.lines import (
    ClaimedCase,
    Line,
    Remark,
    RepeatedCase,
    SignalUnit,
    UsedComponent,
)
from pytest_dura.evidence.model import RecordHead, SessionRecord, components_under_test
from pytest_dura.evidence.objections import other_objections
from pytest_dura.evidence.parts import (
    KEYS_OF_ALL_COMPONENTS,
    PLANNED_KEYS,
    Part,
    check_alike,
    check_shards,
    read_parts,
    session_order,
)
from pytest_dura.evidence.session_model import (
    ComponentEntry,
    ComponentUnderTest,
    MergedShard,
    SelectionEntry,
)
from pytest_dura.evidence.sessions import merged_resume
from pytest_dura.evidence.traces import is_trace_path

_MOST_LEFT_OUT = 20
"""Verdicts that are named of those that were left out."""


def union_of_episodes(parts: Sequence[Part]) -> Iterator[tuple[EpisodeEntry, Part]]:
    """Yield each episode of the parts once, in the order of a record, with the part it is from.

    Of equal episodes the one is taken whose trace is kept for the weightiest reason, whatever the
    order in which parts are merged.

    Raises:
        ConfigurationError: If two parts have an episode with different digests.
    """

    def stream(number: int, part: Part) -> Iterator[tuple[Any, int, EpisodeEntry]]:
        for episode in part.record.episodes():
            yield episode_order(episode), number, episode

    ordered = merge_sorted(*map(stream, range(len(parts)), parts), key=itemgetter(0, 1))
    for _, group in groupby(ordered, key=itemgetter(0)):
        yield _joined([(episode, parts[number]) for _, number, episode in group])


def _joined(held: Sequence[tuple[EpisodeEntry, Part]]) -> tuple[EpisodeEntry, Part]:
    """Join what several parts have of one episode."""
    (first, part), *others = held
    if not others:
        return first, part
    for other, other_part in others:
        if other.digest != first.digest:
            raise ConfigurationError(
                f"the episode {first.id} ({first.component}) came out differently in two parts: "
                f"the digest is {first.digest} in {part.file}, {other.digest} in {other_part.file}",
                key="episodes",
                found="two different episodes",
                expected="equal digests of what has the same inputs",
                remedy="find what the episode depends on beside its seed (--dura-replay compares "
                "it); or merge parts that do not share it",
            )
    held = sorted(held, key=lambda each: _place_among_equals(each[0]))
    traced, owner = held[0]
    faults = []
    for place, fault in enumerate(traced.faults):
        known = [episode.faults[place] for episode, _ in held]
        followed = (each for each in known if each != untraced(each))
        faults.append(next(followed, fault))
    planned = any(episode.planned for episode, _ in held)
    return traced.replace(planned=planned, faults=faults), owner


def _place_among_equals(episode: EpisodeEntry) -> tuple[int, str, bytes]:
    """Order what joining leaves as it is: the trace, and how long each run of it took."""
    trace = episode.trace
    file = "" if trace is None else trace.sha256
    return -trace_weight(trace), file, canonical(encode(episode.timings))


Component = ComponentEntry | ComponentUnderTest


def _lines_of(part: Part) -> Iterator[Line]:
    """Yield what the head of a part says."""
    head, components = part.head, components_under_test(part.record)
    sources = head.component_under_test.sources or {}
    for component in components:
        if component.name:
            about = component.to_json(exclude=KEYS_OF_ALL_COMPONENTS)
            yield UsedComponent(about, sources.get(component.digest or "", {}))
    for case in head.cases:
        plan = case.to_json(include=PLANNED_KEYS)
        yield CasePlan.from_data(plan)
        yield ClaimedCase.from_data(plan)
        if case.repeat is not None:
            repeat = case.repeat.to_json()
            yield RepeatedCase(**repeat, case=case.id, component=case.component)
    for signal, unit in (head.units or {}).items():
        yield SignalUnit(signal, unit)
    for note in head.resume.problems:
        yield Remark("note", note)
    yield from (*head.measures, *(head.hazards or ()), *head.requirements, *head.doubts)
    yield from head.searches
    for fact in head.facts or ():
        # Processes of other sessions are called alike.
        own = fact.process and head.merged_from is None
        yield replace(fact, process=f"{part.sha256}/{fact.process}") if own else fact


def _add_heads(record: RecordBuilder, parts: Sequence[Part]) -> None:
    """Add what the heads of the parts say to a record."""
    for part in parts:
        record.add(_lines_of(part))
        for item in part.head.failed_items or ():
            record.fail(item, (part.head.stopped_items or {}).get(item, ""))
        for item, waiver in part.head.waivers.items():
            record.waive(item, waiver.kind, waiver.reason)
    record.add(joined_lines(each for part in parts for each in part.head.judgements))
    # Of two measurements that on more runs holds, which is the last one.
    monitors = [monitor for part in parts for monitor in part.head.monitors]
    record.add(sorted(monitors, key=attrgetter("episodes", "invalid", "missing", "untimed")))


_SAME = ("tool", "base_seed", "evidence_level", "require_repeatable", "execution",
         "options")  # fmt: skip
"""Keys of the header that are those of the first part."""


def _merged_header(parts: Sequence[Part], output: Path) -> dict[str, Any]:
    """Build the header of the merged record.

    Args:
        parts: Of :func:`read_parts`.
        output: Where the merged evidence goes.
    """
    first = parts[0].head
    sessions = {session.record: session for part in parts for session in part.sessions}
    engines = [engine for part in parts if (engine := part.head.second_engine) is not None]
    not_compared: Counter[str] = Counter()
    for engine in engines:
        not_compared.update(engine.not_compared)
    compared = {
        "compared": sum(engine.compared for engine in engines),
        "not_compared": dict(not_compared),
    }
    dirty = [part.head.environment.git.dirty for part in parts]
    git = first.environment.git.replace(dirty=True if any(dirty) else dirty[0])
    header = {
        **{key: getattr(first, key) for key in _SAME},
        "created": min(session.created for session in sessions.values()),
        "command": merged_command(first.command, output),
        "environment": first.environment.replace(git=git),
        "second_engine": {**engines[0].to_json(), **compared} if engines else None,
        "looks": [*dict.fromkeys(look for part in parts for look in part.head.looks or ())] or None,
        "resume": merged_resume(part.head.resume for part in parts),
        "selection": _merged_selection(parts),
        "merged_from": sorted(sessions.values(), key=session_order),
    }
    return {key: value for key, value in header.items() if value is not None} | {"shard": None}


def _merged_selection(parts: Sequence[Part]) -> SelectionEntry:
    """Say what of the plan the parts were asked for together."""
    selections = [part.head.selection for part in parts]
    if all(selection == selections[0] for selection in selections):
        return selections[0]
    judgements = [judgement for part in parts for judgement in part.head.judgements]
    asked = {(each.decides, each.requirement, each.case) for each in judgements}
    names = {item for item, _, _ in asked}
    names |= {f"{name} on {case} by {test_function(item)}" for item, name, case in asked}
    left_out = {name for selection in selections for name in selection.left_out} - names
    planned = max(selection.planned for selection in selections)
    return selections[0].replace(
        planned=max(planned, len(asked) + len(left_out)),
        asked=len(asked),
        left_out=sorted(left_out)[:_MOST_LEFT_OUT],
    )


def merged_command(command: str, output: Path) -> str:
    """Turn the command of a part into that of the whole session, with another evidence folder."""
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


def _merged_inputs(parts: Iterable[Part]) -> list[dict[str, Any]]:
    """List the input files of all parts; ``changed`` if they changed while any part ran."""
    entries: dict[tuple[str, str], dict[str, Any]] = {}
    for part in parts:
        for entry in part.head.inputs:
            if entry.kind != "baseline":
                known = entries.setdefault((entry.path, entry.kind), entry.to_json())
                known["changed"] |= entry.changed
    return [entries[key] for key in sorted(entries)]


def _merged_gate(parts: Sequence[Part], record: SessionRecord, objections: Sequence[str]) -> Gate:
    """Judge the whole by the rules of a session.

    Args:
        parts: Of :func:`read_parts`.
        record: The merged record.
        objections: Reasons against the merged record itself.
    """
    against = list(objections)
    for part in parts:
        head = part.head
        anew = {*repeat_objections(head.cases)} if head.require_repeatable else set()
        anew |= {*regression_objections(head.baseline)} if head.baseline else set()
        against += [reason for reason in other_objections(head) if reason not in anew]
    if record.head.require_repeatable:
        against += repeat_objections(record.head.cases)
    sessions = record.head.merged_from or []
    codes = {session.exit_code for session in sessions}
    code = NO_TESTS
    if codes != {NO_TESTS}:
        against += [
            f"{session_name(session)}: no test was run"
            for session in sessions
            if session.exit_code == NO_TESTS
        ]
        failures = codes - {OK, NO_TESTS}
        code = failures.pop() if len(failures) == 1 else TESTS_FAILED if failures else OK
    return Gate.of(
        record.head.verdicts,
        list(dict.fromkeys(against)),
        searches=record.head.searches,
        interrupted=False,
        exit_code=code,
        failed=len(record.head.failed_items or ()),
        warn_undecided=parts[0].head.gate.warn_undecided,
    )


def session_name(session: MergedShard) -> str:
    """Name a merged session: ``shard 2 of 5``, or when it began."""
    if session.index is None:
        return f"the session of {session.created}"
    return f"shard {session.index} of {session.count}"


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


def _copy(source: Path, target: Path, trace: TraceEntry) -> None:
    """Copy a trace out of a part, and check its digest.

    Raises:
        ConfigurationError: If it differs from its record, or cannot be written.
    """
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


def merge_bundles(
    directories: Sequence[Path],
    output: Path,
    baseline: Baseline | None = None,
    *,
    fail_worse: bool = False,
) -> RecordHead:
    """Merge bundles: the union of their lines, concluded. Returns the head of the whole.

    The order of the bundles does not matter. Nothing is written before all of them are verified
    and belong together. A merge that is killed leaves a record that says so.

    Args:
        directories: Of the bundles, at least one.
        output: Where the merged evidence goes: an empty directory, or one that is made.
        baseline: An earlier record to compare the whole with.
        fail_worse: Whether a rate that got worse than there fails the gate.

    Raises:
        ConfigurationError: For bundles that do not belong together, and evidence that cannot be
            written.
    """
    check_output(output, directories)
    parts = read_parts(directories)
    check_shards(parts)
    check_alike(parts)
    for _ in union_of_episodes(parts):
        pass  # equal ids have equal digests
    lock = DirectoryLock(output)
    try:
        check_output(output, directories)
        with closing(RecordBuilder(_merged_header(parts, output), output)) as record:
            return _write_merged(record, parts, baseline, fail_worse=fail_worse).head
    finally:
        lock.release()


def _write_merged(
    record: RecordBuilder, parts: Sequence[Part], baseline: Baseline | None, *, fail_worse: bool
) -> SessionRecord:
    inputs = _merged_inputs(parts)
    begun = record.record("running")
    if baseline is not None:
        begun = begun.changed(baseline=baseline.compared())
        inputs.append({"path": baseline.session.path, "kind": "baseline",
                       "sha256": baseline.session.sha256, "changed": False})  # fmt: skip
    running = Gate.running(warn_undecided=parts[0].head.gate.warn_undecided)
    begin_bundle(_conclude_merged(begun, running, inputs))
    _add_heads(record, parts)
    head = record.head("complete")
    directory = record.directory or Path()
    lines = SessionRecord(
        head, directory, lambda: (episode for episode, _ in union_of_episodes(parts))
    )
    whole = conclude(lines)
    against = record.problems
    if baseline is not None:
        whole = whole.changed(baseline=baseline.compared(whole))
    if fail_worse and whole.head.baseline is not None:
        against += regression_objections(whole.head.baseline)
    for episode, part in union_of_episodes(parts):
        if episode.trace is not None:
            _copy(part.record.directory, directory, episode.trace)
    listed = {name for part in parts for name in listed_files(part.record.directory)}
    exports = [name for name in FORMATS if name in listed and short_name(name)]
    merged = _conclude_merged(whole, _merged_gate(parts, whole, against), inputs)
    return write_bundle(merged, exports)


def _conclude_merged(
    record: SessionRecord, gate: Gate, inputs: Sequence[JsonObject]
) -> SessionRecord:
    sessions = record.head.merged_from or []
    finished = max(session.finished for session in sessions)
    return complete(
        record,
        finished=None if record.head.status == "running" else finished,
        gate=gate,
        inputs=inputs,
        wall_seconds=sum(session.wall_seconds for session in sessions),
        evidence_seconds=sum(session.evidence_seconds for session in sessions),
        # The parts took out the secrets of the machines on which they ran.
        redact=lambda same: same,
    )
