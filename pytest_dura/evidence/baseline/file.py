"""Baseline: an earlier record against which a session is held."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.baseline.claims import Claim, claims_of
from pytest_dura.evidence.baseline.comparisons import compare_claims
from pytest_dura.evidence.bundle.directory import RECORD, load_record
from pytest_dura.evidence.record.session_record import SessionRecord

OPTION = "--dura-baseline"


@dataclass(frozen=True)
class Baseline:
    """An earlier record, read and checked.

    Args:
        path: As the user gave it.
        sha256: Digest of the file.
        created: When its session began.
        status: ``complete`` or ``interrupted``.
        base_seed: Its base seed.
        component: Its component under test, as it is recorded.
        claims: What it says.
    """

    path: str
    sha256: str
    created: str
    status: str
    base_seed: int
    component: Mapping[str, Any]
    claims: tuple[Claim, ...]

    @classmethod
    def read(cls, given: str, relative_to: Path) -> Baseline:
        """From a file, or a directory that holds one.

        Raises:
            ConfigurationError: If there is none, or it is damaged, foreign or unfinished.
        """
        file = relative_to / given
        if file.is_dir():
            file /= RECORD
        record, digest = load_record(file, OPTION)
        try:
            baseline = cls(
                path=given,
                sha256=digest,
                created=str(record["created"]),
                status=str(record["status"]),
                base_seed=_seed(record["base_seed"]),
                component=_without_sources({"name": None, **record["component_under_test"]}),
                claims=tuple(claims_of(SessionRecord.of(record, file.parent))),
            )
        except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
            raise ConfigurationError(
                "the baseline is damaged",
                file=str(file),
                key=OPTION,
                found=f"{type(error).__name__}: {error}",
                expected="a record as pytest-dura wrote it",
                remedy="restore the file, or run the baseline's session again",
            ) from None
        if baseline.status not in ("complete", "interrupted"):
            raise ConfigurationError(
                "the baseline's session was killed, or is still running",
                file=str(file),
                key="status",
                found=baseline.status,
                expected="complete, or interrupted, of which the finished campaigns are compared",
                remedy="run the baseline's session to its end",
            )
        return baseline

    def to_json(self, record: SessionRecord | None = None) -> dict[str, Any]:
        """Plain data for the record's key ``baseline``.

        ``tests`` counts what Holm's correction counts, ``comparisons`` are those of
        :func:`compare_claims`.

        Args:
            record: The new session's record; ``None`` as long as it runs.
        """
        told = {key: value for key, value in vars(self).items() if key != "claims"}
        found = [] if record is None else compare_claims(claims_of(record), self.claims)
        return {
            **told,
            "correction": "Holm",
            "tests": sum(one.p_worse is not None for one in found),
            "comparisons": [one.to_json() for one in found],
        }


def worse_than(baseline: Mapping[str, Any]) -> list[str]:
    """What fails a gate that is to fail where something got worse.

    Args:
        baseline: Of :meth:`Baseline.to_json` of a finished session.
    """
    found = baseline["comparisons"]
    if all(one["test"] is None for one in found):
        return ["the gate fails: nothing in this session can be compared with the baseline"]
    return [
        f"the gate fails: {one['requirement']} on {one['case']} is worse than in the baseline"
        for one in found
        if one["word"] == "worse"
    ]


def _seed(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f"{value!r} is no seed")
    return value


def _without_sources(component: dict[str, Any]) -> dict[str, Any]:
    """What is recorded of an earlier component; its files are listed where it is."""
    component.pop("sources", None)
    return component
