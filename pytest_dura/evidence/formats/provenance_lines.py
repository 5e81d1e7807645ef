"""Where a session comes from, in Markdown: versions, commit, machine and command."""

from __future__ import annotations

from collections.abc import Iterator

from pytest_dura.evidence.formats.model_lines import model_lines
from pytest_dura.evidence.formats.stated import UNREVIEWED, merged
from pytest_dura.evidence.record.session_record import SessionRecord, components_under_test
from pytest_dura.evidence.text import code, name


def provenance_lines(record: SessionRecord, most: int) -> Iterator[str]:
    """The section, with at most so many components and models of each kind."""
    git, tool, told = record["environment"]["git"] or {}, record["tool"], record["environment"]
    commit = _name(git.get("commit")) + (" with local changes" if git.get("dirty") else "")
    yield from ["", "## Provenance", ""]
    for one in components_under_test(record)[:most]:
        version = f", version {_name(str(one['version']))}" if one.get("version") else ""
        digest = f", SHA-256 {_name(one['digest'])}" if one.get("digest") else ", no digest"
        yield f"- component under test: {_name(one['name'])}{version}{digest}"
    yield from model_lines(record["models"], most)
    yield from [f"- merged from {shards}"] if (shards := merged(record)) else []
    yield f"- commit: {commit}"
    yield f"- tool: {_name(tool['name'])} {_name(tool['version'])}"
    yield f"- Python {_name(told['python'])} on {_name(told['platform'])}"
    yield f"- base seed: {record['base_seed']}"
    yield f"- created {_name(record['created'])}, finished {_name(record['finished'])}"
    yield f"- command: {code(record['command'], 1000) or '-'}"
    yield f"- {UNREVIEWED}"


def _name(text: str | None) -> str:
    return code(name(text or "")) or "-"
