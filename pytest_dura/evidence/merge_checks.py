"""Check bundles that are to be merged: intact, parts of the same plan, and made alike.

Parts are alike if the same code ran, from the same files, under the same options.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path, PurePosixPath
from typing import Any

from pytest_dura.core.errors import ConfigurationError, shorten
from pytest_dura.evidence.bundle import RECORD_FILE, open_record
from pytest_dura.evidence.conclusions.verdicts import question_key
from pytest_dura.evidence.entry import plain_data
from pytest_dura.evidence.files import file_entry
from pytest_dura.evidence.model import SessionRecord, components_under_test
from pytest_dura.evidence.session_model import ShardEntry, ToolEntry
from pytest_dura.evidence.shard_units import ShardUnit, plan_digest
from pytest_dura.evidence.text import one_line
from pytest_dura.evidence.verify import verify_bundle
from pytest_dura.provenance import describe_tool

_MAX_PROBLEM_TEXT = 300
"""Greatest number of characters that are quoted from a damaged bundle."""


@dataclass(frozen=True)
class ShardBundle:
    """Bundle of a shard.

    Args:
        record: Its record.
        sha256: Of its ``evidence.json``.
    """

    record: SessionRecord
    sha256: str

    @property
    def file(self) -> str:
        """Path of its record, for messages."""
        return str(self.record.directory / RECORD_FILE)

    @property
    def shard(self) -> ShardEntry:
        """Entry ``shard`` of its record."""
        shard = self.record.head.shard
        assert shard is not None  # as :func:`read_parts` has checked
        return shard

    @property
    def index(self) -> int:
        """Number of the shard, from 1."""
        return self.shard.index

    @property
    def units(self) -> list[ShardUnit]:
        """Units that it holds."""
        return self.shard.holds

    @property
    def name(self) -> str:
        """Name such as ``shard 2 of 5``."""
        return f"shard {self.index} of {self.shard.count}"


def read_parts(directories: Iterable[Path]) -> list[ShardBundle]:
    """Read the bundles of these directories, ordered by the numbers of their shards.

    Each is verified first, as ``python -m pytest_dura verify`` does. Nothing of it is run.

    Raises:
        ConfigurationError: If one is no intact bundle of a finished shard.
    """
    return sorted(map(_read_part, directories), key=lambda part: part.index)


def _read_part(directory: Path) -> ShardBundle:
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
            expected="an intact bundle of a shard that came to its end",
            remedy=f"see `python -m pytest_dura verify {directory}`; copy it again, or run the "
            "shard again",
        )
    record = open_record(directory / RECORD_FILE)
    if record.head.shard is None:
        merged = record.head.merged_from is not None
        raise ConfigurationError(
            "this bundle is merged already"
            if merged
            else "this bundle is that of a whole session: sessions planned apart are no parts of "
            "one, and what their runs come to together nobody has planned",
            file=file,
            key="shard",
            found="a merged bundle" if merged else "a whole session",
            expected="the bundle of a session with --dura-shard=K/N",
            remedy="name the bundles of all shards" if merged else "run it with --dura-shard",
        )
    if record.head.shard.plan is None:
        raise ConfigurationError(
            "nobody told what this shard holds: all of its workers died",
            file=file,
            key="shard.plan",
            expected="the bundle of a shard that collected its tests",
            remedy="run the shard again",
        )
    return ShardBundle(record, str(file_entry(directory / RECORD_FILE)["sha256"]))


_MAX_LISTED_UNITS = 8


def check_complete(parts: Sequence[ShardBundle]) -> None:
    """Refuse parts that overlap, are not all there, or belong to different sessions.

    Args:
        parts: Ordered by their numbers, at least one.

    Raises:
        ConfigurationError: For the first problem.
    """
    first = parts[0]
    for other in parts[1:]:
        for key, why in (
            ("count", "the session was not split into the same number of shards"),
            ("plan", "it is part of another session: what is to be run as a whole differs"),
            ("units", "it is part of another session: what is to be run as a whole differs"),
        ):
            found, expected = getattr(other.shard, key), getattr(first.shard, key)
            if found != expected:
                raise ConfigurationError(
                    why,
                    file=other.file,
                    key=f"shard.{key}",
                    found=found,
                    expected=f"{expected!r}, as in {first.file}",
                    remedy="run all shards of one commit with the same arguments; selections such "
                    "as -k, -m and --lf have to be the same, too",
                )
    _check_numbers(parts)
    _check_units(parts)


def _check_numbers(parts: Sequence[ShardBundle]) -> None:
    for part, other in pairwise(parts):
        if part.index == other.index:
            raise ConfigurationError(
                f"{part.name} is there twice",
                file=other.file,
                key="shard.index",
                found=other.index,
                expected=f"another shard than that of {part.file}",
                remedy="name each shard's bundle once",
            )
    count = parts[0].shard.count
    indices = {part.index for part in parts}
    # A damaged record may name any number of shards.
    absent = (index for index in range(1, count + 1) if index not in indices)
    missing = list(islice(absent, _MAX_LISTED_UNITS + 1))
    if missing:
        names = ", ".join(map(str, missing[:_MAX_LISTED_UNITS]))
        names += " and more" if len(missing) > _MAX_LISTED_UNITS else ""
        several = "shards" if len(missing) > 1 else "shard"
        verb = "are" if len(missing) > 1 else "is"
        raise ConfigurationError(
            f"{several} {names} of {count} {verb} missing, and without every shard there is no "
            "gate on the whole",
            key="BUNDLE",
            found=", ".join(str(part.record.directory) for part in parts),
            expected=f"the bundles of all {count} shards",
            remedy=f"fetch what is missing, or run it: --dura-shard={missing[0]}/{count}",
        )


def _check_units(parts: Sequence[ShardBundle]) -> None:
    holder: dict[tuple[str, str], ShardBundle] = {}
    for part in parts:
        for unit in part.units:
            if unit.key in holder:
                raise ConfigurationError(
                    f"{unit.name!r} is in two shards, and would count twice",
                    file=part.file,
                    key="shard.holds",
                    found=unit.name,
                    expected=f"in one shard alone; it is in {holder[unit.key].file}, too",
                    remedy="run the shards again: no two of them hold the same",
                )
            holder[unit.key] = part
    digest = plan_digest(unit for part in parts for unit in part.units)
    if digest != parts[0].shard.plan:
        raise ConfigurationError(
            "the shards together do not hold what the whole session was to run",
            file=parts[0].file,
            key="shard.plan",
            found=f"{len(holder)} units with the digest {digest}",
            expected=f"{parts[0].shard.units} units with the digest {parts[0].shard.plan}",
            remedy="a record was changed, or written by another version; run the shards again",
        )


KEYS_OF_ALL_COMPONENTS = {"others", "sources"}
"""Keys of the first component about all of them."""
NamedValues = Iterator[tuple[str, Any]]
_SAME_OPTIONS = "give all shards the same options"
_SAME_CODE = "run all shards of one commit, with the same packages"
_SAME_FILES = "run all shards of one commit, from the same files"
_KEYS_THAT_MAY_DIFFER = {"metrics", "planned", "missing_runs", "missing_runs_total", "repeat"}
"""Keys of a case that follow from the episodes of its shard."""


_ROOT = PurePosixPath()


def check_consistent(parts: Sequence[ShardBundle]) -> None:
    """Refuse parts whose results are not comparable.

    Machines may differ and are recorded for each part. What changes digests, or the meaning of a
    result, may not differ.

    Args:
        parts: Ordered by their numbers, at least one.

    Raises:
        ConfigurationError: For the first difference.
    """
    _check_version(parts[0])
    for values_of, remedy in _COMPARED_VALUES:
        known: dict[str, tuple[Any, ShardBundle]] = {}
        for part in parts:
            for key, entry in values_of(part.record):
                value = plain_data(entry)
                before, first = known.setdefault(key, (value, part))
                if before != value:
                    place, first_value, other_value = _first_difference(key, before, value)
                    raise ConfigurationError(
                        "the shards were not made alike",
                        file=part.file,
                        key=place,
                        found=other_value,
                        expected=f"{shorten(first_value)}, as in {first.file}",
                        remedy=remedy,
                    )
    _check_configuration_files(parts)
    _check_verdicts(parts)


def _check_configuration_files(parts: Sequence[ShardBundle]) -> None:
    """Refuse parts of which only some read a ``conftest.py`` or a configuration."""
    known: dict[tuple[str, str], ShardBundle] = {}
    for part in parts:
        for key in _configuration_files(part):
            known.setdefault(key, part)
    for part in parts:
        inputs = part.record.head.inputs
        tests = [PurePosixPath(entry.path) for entry in inputs if entry.kind == "test"]
        for kind, path in sorted(known.keys() - _configuration_files(part)):
            folder = PurePosixPath(path).parent
            used = any(folder in test.parents for test in tests)
            if kind == "conftest" and not used and not (folder == _ROOT and _simulated(part)):
                continue
            raise ConfigurationError(
                "the shards were not made alike",
                file=part.file,
                key=f"inputs {kind} {path}",
                found="no such file",
                expected=f"the one of {known[kind, path].file}",
                remedy=_SAME_FILES,
            )


def _configuration_files(part: ShardBundle) -> set[tuple[str, str]]:
    kinds = ("conftest", "configuration")
    return {(entry.kind, entry.path) for entry in part.record.head.inputs if entry.kind in kinds}


def _simulated(part: ShardBundle) -> bool:
    return bool(part.record.head.totals.episodes)


def _check_verdicts(parts: Sequence[ShardBundle]) -> None:
    searched: dict[str, ShardBundle] = {}
    for part in parts:
        for item in {search.item for search in part.record.head.searches}:
            first = searched.setdefault(item, part)
            if first is not part:
                raise ConfigurationError(
                    "two shards ran the same search, and it would stand there twice",
                    file=part.file,
                    key="searches",
                    found=item,
                    expected=f"a test in one shard alone; it is in {first.file}, too",
                    remedy="run the shards again: no two of them hold the same",
                )
    judged: dict[tuple[str, ...], ShardBundle] = {}
    for part in parts:
        for verdict in part.record.head.verdicts:
            first = judged.setdefault(question_key(verdict.item, verdict), part)
            if first is not part:
                raise ConfigurationError(
                    "two shards judged the same, and it would count twice",
                    file=part.file,
                    key="verdicts",
                    found=f"{verdict.requirement} on {verdict.case}",
                    expected=f"a verdict in one shard alone; it is in {first.file}, too",
                    remedy="run the shards again: no two of them hold the same",
                )


def _check_version(part: ShardBundle) -> None:
    ours, theirs = ToolEntry.model_validate(describe_tool()), part.record.head.tool
    if theirs.version != ours.version:
        raise ConfigurationError(
            "this bundle was written by another version of pytest-dura",
            file=part.file,
            key="tool.version",
            found=theirs.version,
            expected=ours.version,
            remedy="merge with the version that wrote the bundles",
        )
    if theirs != ours:
        raise ConfigurationError(
            "this bundle was written by other code of pytest-dura of the same version",
            file=part.file,
            key="tool.code",
            found=theirs.code,
            expected=ours.code,
            remedy="merge with the code that wrote the bundles: a released version, or one and "
            "the same commit of a checkout",
        )


def _first_difference(key: str, value: Any, other: Any) -> tuple[str, Any, Any]:
    """Find the first key in which two values differ, and both values there."""
    if isinstance(value, Mapping) and isinstance(other, Mapping):
        for name in sorted({*value, *other}):
            if value.get(name) != other.get(name):
                return _first_difference(f"{key}.{name}", value.get(name), other.get(name))
    return key, value, other


def _session(record: SessionRecord) -> NamedValues:
    options = {"base_seed", "evidence_level", "require_repeatable", "selection"}
    yield from record.head.to_json(include=options).items()
    yield "llm_price", record.head.llm_price
    engine = record.head.second_engine
    yield "second_engine.version", None if engine is None else engine.version
    yield "gate.warn_undecided", record.head.gate.warn_undecided
    yield "shard.options", None if record.head.shard is None else record.head.shard.options


def _code(record: SessionRecord) -> NamedValues:
    environment = record.head.environment
    yield "tool", record.head.tool
    yield "environment.python", environment.python
    yield "environment.packages", environment.packages
    yield "environment.git.commit", environment.git.commit


def _under_test(record: SessionRecord) -> NamedValues:
    known = [entry for entry in components_under_test(record) if entry.name is not None]
    times = Counter(component.name for component in known)
    for component in known:
        key = f"component_under_test {component.name}"
        if times[component.name] > 1:
            key += f" {json.dumps([component.path, component.params], sort_keys=True)}"
        yield key, component.to_json(exclude=KEYS_OF_ALL_COMPONENTS)


def _read_files(record: SessionRecord) -> NamedValues:
    for entry in record.head.inputs:
        yield f"inputs {entry.kind} {entry.path}", entry.sha256


def _requirements_and_cases(record: SessionRecord) -> NamedValues:
    for hazard in record.head.hazards or ():
        yield f"hazards {hazard.id}", hazard
    for requirement in record.head.requirements:
        yield f"requirements {requirement.id}", requirement
    for case in record.head.cases:
        name = f"cases {case.id} with {case.component}"
        yield name, case.to_json(exclude=_KEYS_THAT_MAY_DIFFER)


def _measured(record: SessionRecord) -> NamedValues:
    for monitor in record.head.monitors:
        names = monitor.case, monitor.component, monitor.target, monitor.monitor
        yield f"monitors {' '.join(names)}", monitor


def _measures(record: SessionRecord) -> NamedValues:
    for measure in record.head.measures:
        yield f"measures {measure.name}", measure


def _models(record: SessionRecord) -> NamedValues:
    for model in record.head.models:
        names = f"{model.component} {model.model} {model.fingerprint} {model.mode}"
        yield f"models {names}", model.to_json(include={"capabilities", "cassette"})


_COMPARED_VALUES: tuple[tuple[Callable[[SessionRecord], NamedValues], str], ...] = (
    (_session, _SAME_OPTIONS),
    (_code, _SAME_CODE),
    (_under_test, _SAME_CODE),
    (_read_files, _SAME_FILES),
    (_requirements_and_cases, _SAME_FILES),
    (_measures, _SAME_CODE),
    (_models, "let all shards replay one cassette: --dura-llm=replay"),
    (_measured, "run the shards again: no two of them measure the same"),
)
