"""Messages of a trace: signals, decisions and events as JSON, tick by tick."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pytest_dura.evidence.text import visible
from pytest_dura.evidence.traces.trace import Trace

Message = tuple[int, str]
"""Nanoseconds of simulated time, and JSON in ASCII."""

LONGEST = 1000
"""Characters of a text that a viewer shows; the columns have all of it."""
_PERCEPT = "percept."
_INFO, _WARNING, _ERROR = 2, 3, 4
_LEVELS = {
    **dict.fromkeys(("infrastructure", "component_failure", "critical", "halt"), _ERROR),
    **dict.fromkeys(("unsafe", "alert", "performance_fail", "fault_manifested"), _WARNING),
}


def nanoseconds(time: float) -> int:
    """Of a moment, or of the start where it is none that a file could hold."""
    return round(time * 1e9) if 0.0 <= time < 1e9 else 0


def moment(time: int) -> str:
    """Nanoseconds as Foxglove's time."""
    return f'{{"sec":{time // 10**9},"nsec":{time % 10**9}}}'


class Texts:
    """Texts as JSON, harmless and bounded, each made once."""

    def __init__(self) -> None:
        self._made: dict[str, str] = {}

    def __call__(self, text: str) -> str:
        """The text as a JSON string."""
        made = self._made.get(text)
        if made is None:
            made = self._made[text] = json.dumps(self.shown(text))
        return made

    def any(self, value: Any) -> str:
        """Plain data as JSON, all of its texts so."""
        return json.dumps(self._plain(value), sort_keys=True)

    @staticmethod
    def shown(text: str) -> str:
        """The text itself, harmless and bounded."""
        plain = len(text) <= LONGEST and text.isascii() and text.isprintable()
        return text if plain else visible(text, LONGEST, hashed=True)

    def _plain(self, value: Any) -> Any:
        if isinstance(value, str):
            return self.shown(value)
        if isinstance(value, Mapping):
            return {self.shown(str(key)): self._plain(one) for key, one in value.items()}
        return [*map(self._plain, value)] if isinstance(value, (list, tuple)) else value


def signal_messages(trace: Trace, texts: Texts) -> Iterator[Message]:
    """One for each tick: the truth, and what was perceived; ``null`` where there is no number."""
    truth: list[tuple[str, list[str]]] = []
    percept: list[tuple[str, list[str]]] = []
    for name, column in trace.signals.items():
        own = percept if name.startswith(_PERCEPT) else truth
        own.append((texts(name.removeprefix(_PERCEPT)), _numbers(column)))
    time = trace.time.tolist()
    rows = zip(
        _rows([name for name, _ in truth], [column for _, column in truth], len(time)),
        _rows([name for name, _ in percept], [column for _, column in percept], len(time)),
        strict=True,
    )
    for tick, (shown, perceived) in enumerate(rows):
        told = f'"tick":{tick},"time":{_number(time[tick])},"truth":{shown},"percept":{perceived}'
        yield nanoseconds(time[tick]), f"{{{told}}}"


def _rows(names: Sequence[str], columns: Sequence[Sequence[str]], length: int) -> Iterator[str]:
    """Objects with these fields, one for each row."""
    if not names:
        yield from ["{}"] * length
        return
    # Names are data, and in a template a percent sign would be read.
    template = "{" + ",".join(f"{name.replace('%', '%%')}:%s" for name in names) + "}"
    for row in zip(*columns, strict=True):
        yield template % row


def _numbers(column: Any) -> list[str]:
    values = column.tolist()
    if column.dtype.kind == "f" and not np.isfinite(column).all():
        return [_number(value) for value in values]
    if column.dtype.kind == "b":
        return [str(value).lower() for value in values]
    return [*map(repr, values)]


def _number(value: float) -> str:
    return repr(value) if math.isfinite(value) else "null"


def decision_messages(trace: Trace, texts: Texts) -> Iterator[Message]:
    """One for each decision, at the time of the tick that it was made at."""
    recording = trace.recording
    time = trace.time.tolist()
    columns = {name: column for name, column in trace.decisions.items() if column.ndim == 1}
    length = min([len(time), *map(len, columns.values())]) if columns else 0
    shown = [
        [*map(texts, column.tolist())] if column.dtype.kind == "U" else _numbers(column)
        for column in columns.values()
    ]
    decisions = _rows([*map(texts, columns)], [one[:length] for one in shown], length)
    monitors = [(name, one) for name, one in recording.flags.items() if len(one) >= length]
    flags = _rows(
        [texts(name) for name, _ in monitors], [_numbers(one[:length]) for _, one in monitors],
        length,
    )  # fmt: skip
    said = [
        (*map(texts, column[:length]), *['""'] * (length - len(column)))
        for column in (recording.explanations, recording.reasons, recording.recoveries)
    ]
    accounts = map(texts.any, recording.accounts[:length])
    told = (*accounts, *["{}"] * (length - len(recording.accounts)))
    rows = zip(decisions, flags, *said, told, strict=True)
    for tick, (own, flag, explanation, reason, recovery, account) in enumerate(rows):
        message = (
            f'"tick":{tick},"time":{_number(time[tick])},"columns":{own},'
            f'"explanation":{explanation},"reason":{reason},"recovery":{recovery},"flags":{flag},'
            f'"account":{account}'
        )
        yield nanoseconds(time[tick]), f"{{{message}}}"


def event_messages(trace: Trace, texts: Texts) -> Iterator[Message]:
    """Events as log messages: ``kind subject: detail``."""
    for event in trace.events:
        time = nanoseconds(_time_of(event))
        kind, subject, detail = (str(event.get(key, "")) for key in ("kind", "subject", "detail"))
        message = f"{kind} {subject}" + (f": {detail}" if detail else "")
        told = (
            f'"timestamp":{moment(time)},"level":{_LEVELS.get(kind, _INFO)},'
            f'"message":{texts(message)},"name":{texts(kind)},"file":"","line":0'
        )
        yield time, f"{{{told}}}"


def _time_of(event: Mapping[str, Any]) -> float:
    time = event.get("time")
    return float(time) if isinstance(time, (int, float)) else 0.0
