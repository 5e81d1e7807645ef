"""Parts: bundles that are to be merged, and whether they belong together.

Each is intact, shards have one plan, and all are made alike: the same code ran, from the same
files, under the same options.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

from pytest_dura.core.codec import encode
from pytest_dura.core.errors import ConfigurationError, shorten
from pytest_dura.evidence.bundle import RECORD_FILE, open_record
from pytest_dura.evidence.case_model import CasePlan
from pytest_dura.evidence.conclusions.tables import all_tables
from pytest_dura.evidence.entry import plain_data
from pytest_dura.evidence.files import file_entry
from pytest_dura.evidence.model import RecordHead, SessionRecord, components_under_test
from pytest_dura.evidence.session_model import MergedShard, ToolEntry
from pytest_dura.evidence.shard_units import plan_digest
from pytest_dura.evidence.text import one_line
from pytest_dura.evidence.verify import verify_bundle
from pytest_dura.provenance import describe_tool

PLANNED_KEYS = {each.name for each in fields(CasePlan)}
"""Keys of a case that are known before it is run."""
KEYS_OF_ALL_COMPONENTS = {"others", "sources"}
"""Keys of the first component about all of them."""
_MAX_PROBLEM_TEXT = 300
"""Greatest number of characters that are quoted from a damaged bundle."""
_MAX_LISTED = 8
"""Missing shards that are named."""


@dataclass(frozen=True)
class Part:
    """A bundle that is merged.

    Args:
        record: Its record.
        sha256: Of its ``evidence.json``.
    """

    record: SessionRecord
    sha256: str

    @property
    def head(self) -> RecordHead:
        """Head of its record."""
        return self.record.head

    @property
    def file(self) -> str:
        """Path of its record, for messages."""
        return str(self.record.directory / RECORD_FILE)

    @cached_property
    def sessions(self) -> list[MergedShard]:
        """The sessions that it is made of: those that were merged, or itself."""
        head, shard = self.head, self.head.shard
        if head.merged_from is not None:
            return head.merged_from
        own: dict[str, Any] = {
            key: None if shard is None else getattr(shard, key)
            for key in ("index", "count", "plan")
        }
        own |= {
            key: getattr(head, key) for key in ("created", "finished", "command", "environment")
        }
        own |= {"gate": head.gate.result, "exit_code": head.gate.exit_code, "record": self.sha256}
        own |= head.timings.to_json(include={"wall_seconds", "evidence_seconds"})
        own["units"] = None if shard is None else len(shard.holds)
        return [MergedShard.from_data(own)]

    @property
    def names(self) -> frozenset[str]:
        """Digests of the records of its sessions."""
        return frozenset(session.record for session in self.sessions)


def session_order(session: MergedShard) -> tuple[int, str, str]:
    """Sort key of sessions: the number of the shard, then when it began."""
    return session.index or 0, session.created, session.record


def read_parts(directories: Iterable[Path]) -> list[Part]:
    """Read the bundles of these directories, ordered by their sessions, each session once.

    Each is verified first, as ``python -m pytest_dura verify`` does. Nothing of it is run.

    Raises:
        ConfigurationError: If one is not an intact bundle of a finished session.
    """
    read = sorted(map(_read_part, directories), key=lambda part: -len(part.sessions))
    parts: list[Part] = []
    for part in read:
        if any(part.names <= other.names for other in parts):
            continue  # the other has all that it has
        for other in parts:
            if part.names & other.names:
                raise ConfigurationError(
                    "two merged bundles share a session, and neither has all sessions of the other",
                    file=part.file,
                    key="merged_from",
                    found=f"{len(part.names & other.names)} sessions of {other.file}",
                    expected="bundles of different sessions",
                    remedy="merge the bundles of the sessions themselves",
                )
        parts.append(part)
    return sorted(parts, key=lambda part: min(map(session_order, part.sessions)))


def _read_part(directory: Path) -> Part:
    bundle = verify_bundle(directory)
    file = str(directory / RECORD_FILE)
    if not bundle.intact:
        more = len(bundle.problems) - 1
        raise ConfigurationError(
            "this bundle cannot be merged, because it is not intact",
            file=file,
            key="BUNDLE",
            found=one_line(bundle.problems[0], _MAX_PROBLEM_TEXT)
            + (f" and {more} more" if more else ""),
            expected="an intact bundle of a session that came to its end",
            remedy=f"see `python -m pytest_dura verify {directory}`; copy it again, or run the "
            "shard again",
        )
    record = open_record(directory / RECORD_FILE)
    if record.head.shard is not None and record.head.shard.plan is None:
        raise ConfigurationError(
            "what this shard holds is not known: all of its workers died",
            file=file,
            key="shard.plan",
            expected="the bundle of a shard that collected its tests",
            remedy="run the shard again",
        )
    return Part(record, str(file_entry(directory / RECORD_FILE)["sha256"]))


def check_shards(parts: Sequence[Part]) -> None:
    """Refuse shards of different plans, and a plan of which shards are missing.

    Args:
        parts: Of :func:`read_parts`.

    Raises:
        ConfigurationError: For the first problem.
    """
    shards = [(part, part.head.shard) for part in parts if part.head.shard is not None]
    if not shards:
        return
    first, plan = shards[0]
    for part, shard in shards[1:]:
        for key in ("count", "plan", "units"):
            found, expected = getattr(shard, key), getattr(plan, key)
            if found != expected:
                raise ConfigurationError(
                    "it is part of another session: what is to be run as a whole differs",
                    file=part.file,
                    key=f"shard.{key}",
                    found=found,
                    expected=f"{expected!r}, as in {first.file}",
                    remedy="run all shards of one commit with the same arguments; selections such "
                    "as -k, -m and --lf have to be the same, too",
                )
    indices = {shard.index for _, shard in shards}
    # A damaged record may name any number of shards.
    absent = (index for index in range(1, plan.count + 1) if index not in indices)
    missing = list(islice(absent, _MAX_LISTED + 1))
    if missing:
        names = ", ".join(map(str, missing[:_MAX_LISTED]))
        names += " and more" if missing[_MAX_LISTED:] else ""
        several, verb = ("shards", "are") if missing[1:] else ("shard", "is")
        raise ConfigurationError(
            f"{several} {names} of {plan.count} {verb} missing, and without every shard there is "
            "no gate on the whole",
            key="BUNDLE",
            found=", ".join(str(part.record.directory) for part, _ in shards),
            expected=f"the bundles of all {plan.count} shards",
            remedy=f"fetch what is missing, or run it: --dura-shard={missing[0]}/{plan.count}",
        )
    held = {unit for _, shard in shards for unit in shard.holds}
    digest = plan_digest(held)
    if digest != plan.plan:
        raise ConfigurationError(
            "the shards together do not hold what the whole session was to run",
            file=first.file,
            key="shard.plan",
            found=f"{len(held)} units with the digest {digest}",
            expected=f"{plan.units} units with the digest {plan.plan}",
            remedy="a record was changed, or written by another version; run the shards again",
        )


_SAME_CODE = "run all parts of one commit, with the same packages"
_SAME_FILES = "run all parts of one commit, from the same files"


def check_alike(parts: Sequence[Part]) -> None:
    """Refuse parts that differ in what changes digests, or the meaning of a result.

    These are project, component, requirements, seeds, versions and options. Selections and
    machines may differ, and are recorded for each session.

    Args:
        parts: Of :func:`read_parts`.

    Raises:
        ConfigurationError: For the first difference.
    """
    ours, theirs = ToolEntry.from_data(describe_tool()), parts[0].head.tool
    if theirs != ours:
        other_code = theirs.version == ours.version
        what = "other code of pytest-dura of the same version" if other_code else "another version"
        key = "code" if other_code else "version"
        raise ConfigurationError(
            f"this bundle was written by {what}" + ("" if other_code else " of pytest-dura"),
            file=parts[0].file,
            key=f"tool.{key}",
            found=getattr(theirs, key),
            expected=getattr(ours, key),
            remedy="merge with the version that wrote the bundles: a released one, or one and the "
            "same commit of a checkout",
        )
    known: dict[str, tuple[Any, Part]] = {}
    for part in parts:
        for key, entry, remedy in _compared(part):
            value = plain_data(entry)
            before, first = known.setdefault(key, (value, part))
            if before != value:
                place, first_value, other_value = _first_difference(key, before, value)
                values = shorten(first_value), other_value
                raise _unlike((first, part), place, values, remedy)
    _check_configuration_files(parts)


def _unlike(
    parts: tuple[Part, Part], key: str, values: tuple[str, Any], remedy: str
) -> ConfigurationError:
    """Make the error on a value of the first of two parts that the other does not have."""
    (first, part), (expected, found) = parts, values
    return ConfigurationError(
        "the parts were not made alike",
        file=part.file,
        key=key,
        found=found,
        expected=f"{expected}, as in {first.file}",
        remedy=remedy,
    )


def _compared(part: Part) -> Iterator[tuple[str, Any, str]]:
    """Yield what has to be equal in all parts that have it: key, value and remedy."""
    head = part.head
    options = "give all parts the same options"
    for name in ("base_seed", "evidence_level", "require_repeatable"):
        yield name, getattr(head, name), options
    yield "second_engine.version", head.second_engine and head.second_engine.version, options
    yield "gate.warn_undecided", head.gate.warn_undecided, options
    yield "options", head.options or {}, options
    environment = head.environment
    yield "tool", head.tool, _SAME_CODE
    yield "environment.python", environment.python, _SAME_CODE
    yield "environment.packages", environment.packages, _SAME_CODE
    yield "environment.git.commit", environment.git.commit, _SAME_CODE
    known = [each for each in components_under_test(part.record) if each.name is not None]
    times = Counter(each.name for each in known)
    for component in known:
        key = f"component_under_test {component.name}"
        if times[component.name] > 1:
            key += f" {plain_data([component.path, component.params])}"
        yield key, component.to_json(exclude=KEYS_OF_ALL_COMPONENTS), _SAME_CODE
    for entry in head.inputs:
        if entry.kind != "baseline":
            yield f"inputs {entry.kind} {entry.path}", entry.sha256, _SAME_FILES
    for hazard in head.hazards or ():
        yield f"hazards {hazard.id}", hazard, _SAME_FILES
    for requirement in head.requirements:
        yield f"requirements {requirement.id}", requirement, _SAME_FILES
    for case in head.cases:
        plan = case.to_json(include=PLANNED_KEYS - {"planned"})
        yield f"cases {case.id} with {case.component}", plan, _SAME_FILES
    for measure in head.measures:
        yield f"measures {measure.name}", measure, _SAME_CODE
    for table in all_tables():
        yield from table.alike(head)
    for search in head.searches:
        key = f"searches {search.item} {search.case} {search.component} {search.seed}"
        yield key, encode(replace(search, waiver=None)), _SAME_CODE


def _first_difference(key: str, value: Any, other: Any) -> tuple[str, Any, Any]:
    """Find the first key in which two values differ, and both values there."""
    if isinstance(value, Mapping) and isinstance(other, Mapping):
        for name in sorted({*value, *other}):
            if value.get(name) != other.get(name):
                return _first_difference(f"{key}.{name}", value.get(name), other.get(name))
    return key, value, other


def _check_configuration_files(parts: Sequence[Part]) -> None:
    """Refuse parts of which only some read a ``conftest.py`` or a configuration."""
    files = [
        {(entry.kind, entry.path) for entry in part.head.inputs
         if entry.kind in ("conftest", "configuration")}
        for part in parts
    ]  # fmt: skip
    known = {key: part for part, own in reversed([*zip(parts, files, strict=True)]) for key in own}
    for part, own in zip(parts, files, strict=True):
        tests = [PurePosixPath(each.path) for each in part.head.inputs if each.kind == "test"]
        for kind, path in sorted(known.keys() - own):
            folder = PurePosixPath(path).parent
            used = any(folder in test.parents for test in tests)
            simulated = folder == PurePosixPath() and part.head.totals.episodes
            if kind == "configuration" or used or simulated:
                key, first = f"inputs {kind} {path}", known[kind, path]
                values = "the file", "no such file"
                raise _unlike((first, part), key, values, _SAME_FILES)
