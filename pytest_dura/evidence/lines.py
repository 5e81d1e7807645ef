"""Lines: what items report on the way into the record, one fact each.

Items report episodes, judgements and how faults spread, and the facts that these rest on. A line
loses its secrets before it leaves the process that made it, and which items report it, how often
and in which order makes no difference to the record.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from pytest_dura.core.codec import decode, encode
from pytest_dura.core.measures import MeasureInfo
from pytest_dura.core.metrics import TracedFault
from pytest_dura.evidence.case_model import CasePlan, RepeatEntry
from pytest_dura.evidence.conclusions.verdicts import test_function
from pytest_dura.evidence.entry import JsonObject
from pytest_dura.evidence.model import Fact
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.requirements.hazards import Hazard
from pytest_dura.requirements.judgements import Doubt, Judgement
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.monitoring.quality import MonitorQuality


@dataclass(frozen=True)
class EpisodeLine:
    """An episode, as :func:`~pytest_dura.evidence.episodes.episode_record` builds it."""

    entry: JsonObject


@dataclass(frozen=True)
class FaultTrace:
    """How far a fault of an episode got."""

    component: str
    episode: str
    fault: TracedFault


@dataclass(frozen=True)
class KeptTrace:
    """A file of an episode's trace, of one digest, as in the record's ``trace``."""

    id: str
    component: str
    digest: str
    trace: JsonObject


@dataclass(frozen=True)
class UsedComponent:
    """A component under test, of :func:`describe_component`, and SHA-256 of its files by name."""

    description: JsonObject
    sources: dict[str, str]


class ClaimedCase(CasePlan):
    """Case of what an item is to decide, which may never run."""


class RepeatedCase(RepeatEntry):
    """Result of repeating an episode of a case."""

    case: str
    """Id of the case."""
    component: str
    """Name of the component under test."""


@dataclass(frozen=True)
class SearchedRun:
    """Which session simulated a run of a search, where earlier ones may have."""

    run: str
    origin: JsonObject


@dataclass(frozen=True)
class SignalUnit:
    """Unit of a signal, by its name in formulas, as a domain declares it."""

    signal: str
    unit: str


RemarkKind = Literal["problem", "objection", "note", "retried"]


@dataclass(frozen=True)
class Remark:
    """A sentence on the session, or the node id of an item that passed when it was run again.

    A problem is a doubt about the whole session and begins with ``infrastructure:``, an objection
    another reason why it does not pass; a note casts no doubt.
    """

    kind: RemarkKind
    text: str


Line = (
    EpisodeLine | FaultTrace | KeptTrace | Judgement | RecordedSearch | MonitorQuality
    | UsedComponent | CasePlan | ClaimedCase | RepeatedCase | MeasureInfo | Hazard | Requirement
    | SearchedRun | SignalUnit | Remark | Doubt | Fact
)  # fmt: skip
_SHORT = 2000
"""Up to so many characters lines are not compressed, which would take longer than to send them."""
_KINDS: dict[str, type[Any]] = {kind.__name__: kind for kind in Line.__args__}


def without_secrets(lines: Iterable[Line], redact: Callable[[Any], Any]) -> list[Line]:
    """Copy lines without secrets.

    Args:
        lines: The lines.
        redact: Removes secrets from plain data.
    """
    return _read(_plain(lines, redact))


def pack_lines(lines: Iterable[Line], redact: Callable[[Any], Any]) -> str:
    """Write lines without secrets as a text that may cross processes."""
    text = json.dumps(_plain(lines, redact), allow_nan=False)
    if len(text) <= _SHORT:  # such as the one line of most items
        return text
    return base64.b64encode(zlib.compress(text.encode(), 1)).decode()


def unpack_lines(text: str) -> list[Line]:
    """Read the lines of :func:`pack_lines`."""
    plain = text if text.startswith("[") else zlib.decompress(base64.b64decode(text))
    return _read(json.loads(plain))


def _plain(lines: Iterable[Line], redact: Callable[[Any], Any]) -> list[Any]:
    known = list(lines)
    return [[type(line).__name__ for line in known], redact(list(map(encode, known)))]


def _read(plain: Sequence[Sequence[Any]]) -> list[Line]:
    return [decode(_KINDS[name], data) for name, data in zip(*plain, strict=True)]


def asked_by(line: Line, item: str, recorded_as: str = "", attempt: int = 1) -> Line:
    """Put the item that asks into a judgement or a search; a claim has its own.

    Args:
        line: The line.
        item: Node id of the item.
        recorded_as: Node id of the first of several items that repeat one test on the same
            parameters; empty where nothing repeats it.
        attempt: Number of the attempt at the item, from 1.
    """
    first = recorded_as or item
    if isinstance(line, RecordedSearch):
        return replace(line, item=first)
    if not isinstance(line, Judgement) or line.item:
        return line
    decides = test_function(item) if line.kind == "test" else first
    return replace(line, item=item, decides=decides, recorded_as=recorded_as, attempt=attempt)
