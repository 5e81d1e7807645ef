"""Whether parts were made alike: by the same code, from the same files, under the same options."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

from pytest_dura.core.errors import ConfigurationError, shorten
from pytest_dura.evidence.merging.parts import Part
from pytest_dura.evidence.record.attempts import question
from pytest_dura.evidence.record.session_record import SessionRecord, components_under_test
from pytest_dura.provenance.ourselves import describe_tool

Data = Mapping[str, Any]
Named = Iterator[tuple[str, Any]]
_OPTIONS = "give all shards the same options"
_CODE = "run all shards of one commit, with the same packages"
_FILES = "run all shards of one commit, from the same files"
_OF_ITS_OWN = {"metrics", "planned", "missing_runs", "missing_runs_total", "repeat"}
"""Keys of a case that follow from the episodes of its shard."""


_ROOT = PurePosixPath()


def check_alike(parts: Sequence[Part]) -> None:
    """Refuse parts whose results are not those of one session.

    Machines may differ: where they ran is kept for each. What may change digests, or what a result
    means, may not.

    Args:
        parts: Ordered by their numbers, at least one.

    Raises:
        ConfigurationError: For the first difference.
    """
    _check_version(parts[0])
    for told, remedy in _TOLD:
        known: dict[str, tuple[Any, Part]] = {}
        for part in parts:
            for key, value in told(part.record):
                before, where = known.setdefault(key, (value, part))
                if before != value:
                    place, one, other = _place(key, before, value)
                    raise ConfigurationError(
                        "the shards were not made alike",
                        file=part.file,
                        key=place,
                        found=other,
                        expected=f"{shorten(one)}, as in {where.file}",
                        remedy=remedy,
                    )
    _check_seen(parts)
    _check_verdicts(parts)


def _check_seen(parts: Sequence[Part]) -> None:
    """Refuse parts one of which saw a ``conftest.py`` or a configuration that was not there."""
    known: dict[tuple[str, str], Part] = {}
    for part in parts:
        for key in _seen(part):
            known.setdefault(key, part)
    for part in parts:
        inputs = part.record["inputs"]
        tests = [PurePosixPath(one["path"]) for one in inputs if one["kind"] == "test"]
        for kind, path in sorted(known.keys() - _seen(part)):
            folder = PurePosixPath(path).parent
            used = any(folder in one.parents for one in tests)
            if kind == "conftest" and not used and not (folder == _ROOT and _simulated(part)):
                continue
            raise ConfigurationError(
                "the shards were not made alike",
                file=part.file,
                key=f"inputs {kind} {path}",
                found="no such file",
                expected=f"the one of {known[kind, path].file}",
                remedy=_FILES,
            )


def _seen(part: Part) -> set[tuple[str, str]]:
    kinds = ("conftest", "configuration")
    return {(one["kind"], one["path"]) for one in part.record["inputs"] if one["kind"] in kinds}


def _simulated(part: Part) -> bool:
    return bool(part.record["totals"]["episodes"])


def _check_verdicts(parts: Sequence[Part]) -> None:
    searched: dict[str, Part] = {}
    for part in parts:
        for item in {one["item"] for one in part.record["searches"]}:
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
    asked: dict[tuple[str, ...], Part] = {}
    for part in parts:
        for verdict in part.record["verdicts"]:
            first = asked.setdefault(question(verdict["item"], verdict), part)
            if first is not part:
                raise ConfigurationError(
                    "two shards judged the same, and it would count twice",
                    file=part.file,
                    key="verdicts",
                    found=f"{verdict['requirement']} on {verdict['case']}",
                    expected=f"a verdict in one shard alone; it is in {first.file}, too",
                    remedy="run the shards again: no two of them hold the same",
                )


def _check_version(part: Part) -> None:
    ours, theirs = describe_tool(), part.record["tool"]
    if theirs["version"] != ours["version"]:
        raise ConfigurationError(
            "this bundle was written by another version of pytest-dura",
            file=part.file,
            key="tool.version",
            found=theirs["version"],
            expected=ours["version"],
            remedy="merge with the version that wrote the bundles",
        )
    if theirs != ours:
        raise ConfigurationError(
            "this bundle was written by other code of pytest-dura of the same version",
            file=part.file,
            key="tool.code",
            found=theirs["code"],
            expected=ours["code"],
            remedy="merge with the code that wrote the bundles: a released version, or one and "
            "the same commit of a checkout",
        )


def _place(key: str, one: Any, other: Any) -> tuple[str, Any, Any]:
    """Where two values differ first, and by what."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        for name in sorted({*one, *other}):
            if one.get(name) != other.get(name):
                return _place(f"{key}.{name}", one.get(name), other.get(name))
    return key, one, other


def _session(record: SessionRecord) -> Named:
    for key in ("base_seed", "evidence_level", "require_repeatable", "argument", "selection"):
        yield key, record[key]
    yield "gate.warn_undecided", record["gate"]["warn_undecided"]
    yield "shard.options", record["shard"]["options"]


def _code(record: SessionRecord) -> Named:
    environment = record["environment"]
    yield "tool", record["tool"]
    yield "environment.python", environment["python"]
    yield "environment.packages", environment["packages"]
    yield "environment.git.commit", environment["git"]["commit"]


def _under_test(record: SessionRecord) -> Named:
    known = [one for one in components_under_test(record) if one["name"] is not None]
    times = Counter(one["name"] for one in known)
    for one in known:
        told = {key: value for key, value in one.items() if key not in ("others", "sources")}
        alone = times[one["name"]] == 1
        made = "" if alone else f" {json.dumps([one['path'], one['params']], sort_keys=True)}"
        yield f"component_under_test {one['name']}{made}", told


def _read_files(record: SessionRecord) -> Named:
    for one in record["inputs"]:
        yield f"inputs {one['kind']} {one['path']}", one["sha256"]


def _asked(record: SessionRecord) -> Named:
    for one in record["requirements"]:
        yield f"requirements {one['id']}", one
    for one in record["cases"]:
        told = {key: value for key, value in one.items() if key not in _OF_ITS_OWN}
        yield f"cases {one['id']} with {one['component']}", told


def _measured(record: SessionRecord) -> Named:
    for one in record["monitors"]:
        names = (one[name] for name in ("case", "component", "target", "monitor"))
        yield f"monitors {' '.join(names)}", one


def _models(record: SessionRecord) -> Named:
    for one in record["models"]:
        told = {key: one[key] for key in ("capabilities", "cassette")}
        yield f"models {one['component']} {one['model']} {one['fingerprint']} {one['mode']}", told


_TOLD: tuple[tuple[Callable[[SessionRecord], Named], str], ...] = (
    (_session, _OPTIONS),
    (_code, _CODE),
    (_under_test, _CODE),
    (_read_files, _FILES),
    (_asked, _FILES),
    (_models, "let all shards replay one cassette: --dura-llm=replay"),
    (_measured, "run the shards again: no two of them measure the same"),
)
