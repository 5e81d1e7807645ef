"""The whole check of a bundle, from its files to what its formats state."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.bundle.directory import RECORD, RENDERED, read_session_record
from pytest_dura.evidence.bundle.manifest import files_of, listed_files, manifest_problems
from pytest_dura.evidence.record.counts import Counts
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.evidence.verifying.campaigns import verdict_problems
from pytest_dura.evidence.verifying.junit import junit_problems
from pytest_dura.evidence.verifying.recomputed import recomputed_problems
from pytest_dura.evidence.verifying.references import format_problems, other_version
from pytest_dura.evidence.verifying.reuse import reuse_problems
from pytest_dura.evidence.verifying.sums import record_problems
from pytest_dura.evidence.verifying.traces import Rejudged, trace_problems

_KEPT = re.compile(r"\.episodes/[0-9a-f]{2}/[0-9a-f]{64}\.(episode|claim)")
DAMAGED = (
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
    rejudged: Rejudged = field(default_factory=Rejudged)
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
    names = files_of(directory)
    odd = [name for name in names if not (directory / name).is_symlink()]
    odd = [name for name in odd if not (directory / name).is_file()]
    if odd:  # reading a pipe would wait for ever
        return Verification([f"{name}: no file, where a bundle holds files only" for name in odd])
    found = Verification([], len(names))
    try:
        record = read_session_record(directory)
    except ConfigurationError as error:
        found.problems += [*manifest_problems(directory), f"{RECORD}: {error}"]
        return found
    found.problems += manifest_problems(directory, _kept_episodes(record, names))
    try:
        found.problems += _schema_problems(record)
        if any(one.startswith(f"{RECORD}: schema") for one in found.problems):
            return found  # sums and references of what has another shape say nothing
        found.counts = Counts.of(record)
        found.problems += record_problems(record, found.counts)
    except DAMAGED as error:
        found.problems.append(f"{RECORD}: damaged ({type(error).__name__}: {error})")
        return found
    found.problems += _extra_files(record)
    found.not_rendered = other_version(record)
    found.problems += format_problems(record, found.counts)
    found.problems += trace_problems(record, found.rejudged)
    try:
        found.problems += claim_problems(record, found.rejudged)
    except DAMAGED as error:
        found.problems.append(f"{RECORD}: damaged ({type(error).__name__}: {error})")
    if junit is not None:
        found.problems += junit_problems(record, junit)
    return found


def _kept_episodes(record: SessionRecord, names: Iterable[str]) -> list[str]:
    """The files from which a session that did not pass can be resumed; no part of its evidence."""
    gate = record.head.get("gate")
    if not isinstance(gate, Mapping) or gate.get("result") == "passed":
        return []
    return [name for name in names if _KEPT.fullmatch(name)]


def _extra_files(record: SessionRecord) -> Iterator[str]:
    """Files that the manifest lists and that no bundle has."""
    made = {RECORD, *RENDERED}
    made.update(one["trace"]["file"] for one in record.episodes() if one["trace"] is not None)
    for name in sorted(set(listed_files(record.directory)) - made):
        yield f"{name}: in the manifest, and no file of this bundle"


def claim_problems(record: SessionRecord, rejudged: Rejudged) -> Iterator[str]:
    """What follows from the episodes, computed again."""
    for problem in recomputed_problems(record):
        yield f"{RECORD}: {problem}"
    for problem in reuse_problems(record):
        yield f"{RECORD}: {problem}"
    for problem in verdict_problems(record, rejudged.found):
        yield f"{RECORD}: {problem}"


def _schema_problems(record: SessionRecord) -> Iterator[str]:
    from pytest_dura.evidence.bundle.schema import check_record

    for problem in check_record(record):
        yield f"{RECORD}: schema: {problem}"
