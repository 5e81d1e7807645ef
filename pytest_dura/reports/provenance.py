"""Provenance: on what a session ran, with which inputs, and who reviewed it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from pytest_dura.evidence.model import SessionRecord, components_under_test
from pytest_dura.evidence.session_model import (
    ComponentEntry,
    ComponentUnderTest,
    EnvironmentEntry,
    InputEntry,
    MergedShard,
)
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.reports.columns import (
    Cell,
    Column,
    Shown,
    moment_text,
    prose_cell,
    role_name,
    seconds_text,
)
from pytest_dura.reports.document import Entry, Facts, Level, Part, Table
from pytest_dura.reports.wording import (
    merge_text,
    names_text,
    review_text,
    second_engine_text,
)

_MOST_COMPONENTS = 10
_UNREAD = "could not be read"


def session_facts(record: SessionRecord) -> Facts:
    """What a session is, for who opens its summary or page."""
    return Facts(tuple(_session_entries(record)))


def _session_entries(record: SessionRecord) -> Iterator[Entry]:
    head = record.head
    components = components_under_test(record)
    for number, component in enumerate(components[:_MOST_COMPONENTS]):
        yield Entry("" if number else "component under test", component_text(component))
    if len(components) > _MOST_COMPONENTS:
        yield Entry("", f"and {len(components) - _MOST_COMPONENTS} more, in evidence.json")
    yield Entry("episodes", episode_sentence(record))
    ended = f" to {moment_text(head.finished)}" if head.finished else ""
    yield Entry("when", f"{moment_text(head.created)}{ended} ({head.status})")
    if shards := merge_text(record):
        yield Entry("merged from", shards)
    yield Entry("run it again", head.command or "-", "command")
    yield Entry(
        "base seed", f"{head.base_seed}: with it and the packages, the episodes are the same"
    )
    if commit := commit_text(head.environment):
        yield Entry("commit", commit)
    python, platform = head.environment.python, head.environment.platform
    tool = f"{name(head.tool.name)} {name(head.tool.version)}"
    yield Entry("made by", f"{tool}, Python {name(python)} on {one_line(platform)}")
    if engine := second_engine_text(record):
        yield Entry("formulas", engine)
    yield Entry("review", review_text(record))
    if record.review is None:
        yield Entry(
            "", "A reviewer writes review.yaml (who, when, what, decision) and signs it:",
            weight=Level.PAGE,
        )  # fmt: skip
        command = "python -m pytest_dura sign DIR --key=KEY.pem --review=review.yaml"
        yield Entry("", command, "command", weight=Level.PAGE)
    else:
        command = "python -m pytest_dura verify --key=PUBLIC.pem DIR"
        yield Entry("", f"Its signature is checked by `{command}`, not here.", weight=Level.PAGE)


def episode_sentence(record: SessionRecord) -> str:
    """Count the episodes that were simulated, and say what those are for that no case plans."""
    cases, total = record.head.cases, record.head.totals.episodes
    plain = [case.metrics for case in cases if not case.without]
    planned = sum(metrics.planned for metrics in plain)
    beyond = sum(max(0, metrics.run - metrics.planned) for metrics in plain)
    arms = Counter[str]()
    for case in cases:
        if case.reference:
            arms[f"with {name(case.reference)} in the component's place"] += case.metrics.run
        elif case.without:
            arms[f"without {names_text(case.without)}"] += case.metrics.run
    run = sum(metrics.run for metrics in plain)
    parts = [f"{run - beyond} of {planned} planned"]
    parts += [f"{beyond} beyond the plan of their case"] if beyond else []
    parts += [
        f"{count} of the same seeds {lacking}, to compare with"
        for lacking, count in arms.items()
        if count
    ]
    by_hand = episodes_by_hand(record)
    parts += [f"{by_hand} with a seed chosen by hand"] if by_hand else []
    repeated = sum(case.repeat is not None and case.repeat.result != "skipped" for case in cases)
    again = f"; {counted(repeated, 'case')} run once more, to see whether it repeats"
    return f"{counted(total, 'episode')}: {', '.join(parts)}{again if repeated else ''}"


def episodes_by_hand(record: SessionRecord) -> int:
    """How many episodes no case plans, with a seed chosen by hand."""
    run = sum(case.metrics.run for case in record.head.cases)
    return max(0, record.head.totals.episodes - run)


def component_text(component: ComponentUnderTest | ComponentEntry) -> str:
    """A component under test: its name, where it is from, and what identifies it."""
    digest, files = component.digest, component.file_count
    over = f" over {counted(files, 'file')}" if digest is not None and files else ""
    parts = [
        name(component.name or "unknown"),
        *([f"from {name(component.path)}"] if component.path else []),
        f"version {name(component.version)}" if component.version else "no version",
        f"SHA-256 {name(digest)}{over}" if digest is not None else "no digest",
        *([f"parameters {one_line(str(component.params))}"] if component.params else []),
    ]
    if component.opaque:
        parts.append("an instance whose state the record does not hold")
    return ", ".join(parts)


def commit_text(environment: EnvironmentEntry) -> str:
    """The commit that was run, and whether files differed from it; empty without one."""
    git = environment.git
    if git.commit is None:
        return ""
    changed = {True: " with changes that are not committed", None: ", unknown whether changed"}
    return f"{name(git.commit)}{changed.get(git.dirty, '')}"


# What the page alone shows.


def provenance_parts(record: SessionRecord) -> Iterator[tuple[str, Part]]:
    """Yield what else results depend on, and where the time went, each with its title."""
    head = record.head
    if head.merged_from:
        rows = [(f"{shard.index} of {shard.count}", shard) for shard in head.merged_from]
        yield "Merged shards", _table("shard", SHARD_COLUMNS, rows)
    yield (
        "Environment",
        Facts(tuple(_environment_entries(record)), Level.PAGE, Shown.PAGE, view="provenance"),
    )
    yield "Input files", _table("file", INPUT_COLUMNS, [(each.path, each) for each in head.inputs])
    times = head.timings
    timings = {
        "Session, wall clock": times.wall_seconds,
        "Simulated time of all episodes": times.simulated_seconds,
        "Gathering evidence, of these": times.evidence_seconds,
        **{
            f"Wall clock of {role_name(role)}": seconds
            for role, seconds in sorted(times.processing_seconds.items())
        },
    }
    yield "Timings", _table("what", TIMING_COLUMNS, list(timings.items()))


def _table(what: str, columns: Sequence[Column[Any]], rows: Sequence[tuple[str, Any]]) -> Table:
    return Table(what, columns, rows, weight=Level.PAGE, shown=Shown.PAGE, view="provenance")


def _environment_entries(record: SessionRecord) -> Iterator[Entry]:
    head = record.head
    environment, execution = head.environment, head.execution
    yield Entry("processor features", ", ".join(map(name, environment.cpu_features or [])) or "-")
    yield Entry("linear algebra", name(environment.blas or "-"))
    packages = sorted(environment.packages.items(), key=lambda each: each[0].lower())
    joined = ", ".join(f"{name(each)}\N{NO-BREAK SPACE}{name(own)}" for each, own in packages)
    yield Entry("packages", joined)
    processes = f", {execution.processes} processes" if execution.processes else ""
    yield Entry("simulated by", f"{name(execution.executor)}{processes}")
    yield Entry("evidence level", f"{head.evidence_level}: which traces are kept")
    if head.redacted:
        replaced = (f"{name(what)} ({count})" for what, count in sorted(head.redacted.items()))
        yield Entry("redacted", ", ".join(replaced))
    yield Entry("schema version", head.schema_version)


def _digest_cell(digest: str | None, note: str = "") -> Cell:
    text = name(digest or _UNREAD)
    return Cell(text, text, text, (note,) if note else ())


INPUT_COLUMNS: Sequence[Column[InputEntry]] = (
    Column("kind", lambda row: row.kind),
    Column(
        "SHA-256",
        lambda row: _digest_cell(row.sha256, "changed while the session ran" * row.changed),
        heading="SHA-256", kind="digest",
    ),
)  # fmt: skip
TIMING_COLUMNS: Sequence[Column[float]] = (Column("time", seconds_text),)
SHARD_COLUMNS: Sequence[Column[MergedShard]] = (
    Column("gate", lambda row: row.gate),
    Column("when", lambda row: f"{moment_text(row.created)} to {moment_text(row.finished)}"),
    Column(
        "environment",
        lambda row: prose_cell(f"Python {row.environment.python}, {row.environment.platform}"),
    ),
    Column("command", lambda row: prose_cell(row.command)),
    Column(
        "record", lambda row: _digest_cell(row.record), heading="SHA-256 of its record",
        kind="digest",
    ),
)  # fmt: skip
