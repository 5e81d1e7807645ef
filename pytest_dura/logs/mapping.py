"""Mapping: which topic and field of a log is which signal, in YAML."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from pytest_dura.core.errors import ConfigurationError, did_you_mean, list_names
from pytest_dura.library.documents import Document, read_yaml, validate
from pytest_dura.library.scenario import Entry
from pytest_dura.logs.reading import Topic
from pytest_dura.logs.worlds import LOG_WORLDS

TIME_NAMES = ("time", "timestamp", "stamp", "t")
"""Names of the column of stamps, in lower case; another one is named by `time.column`."""
Method = Literal["hold", "linear", "nearest"]
StampUnit = Literal["auto", "s", "ms", "us", "ns"]


_FIELDS = {"difference": 2, "yaw": 4}
"""Fields that a combination takes, where it does not take any number."""


class SignalEntry(Entry):
    """Where a signal comes from."""

    topic: str = ""
    """Topic; empty in a table."""
    field: str | list[str] = ""
    """Dotted name of the field, or several with `combine`; default: the name of the signal."""
    combine: Literal["norm", "sum", "difference", "yaw"] | None = None
    """What is made of several fields: the root of the sum of their squares, their sum, the first
    less the second, or the yaw in rad of a quaternion x, y, z, w."""
    unit: str = ""
    """Unit of the signal, as formulas read it."""
    recorded_in: str = ""
    """Unit of the field, which is converted; default: what the log says, else `unit`."""
    scale: float = 1.0
    """Factor on the field, before the unit is converted."""
    offset: float = 0.0
    """What is added to it then."""
    frame: str = ""
    """Frame of reference, in words."""
    method: Method = "hold"
    """Value between two samples: the earlier one, a straight line, or the nearer one."""
    longest_gap: float | None = Field(default=None, gt=0)
    """Seconds from sample to sample beyond which nothing is known between them; default: 1.5 times
    the usual distance."""
    rate_at_most: float | None = Field(default=None, gt=0)
    """Greatest change in a second, in the unit of the signal, by which a gap is bounded."""

    def fields(self, name: str) -> list[str]:
        """List the fields."""
        given = self.field or name
        return [given] if isinstance(given, str) else list(given)


class TimeEntry(Entry):
    """How stamps are read."""

    stamps: Literal["header", "receipt"] | None = None
    """Stamps of the messages themselves, or those of the recorder; default: those of the messages
    where each topic has them."""
    column: str = ""
    """Column of the stamps, in a table; default: `time`, `timestamp`, `stamp` or `t`."""
    unit: StampUnit = "auto"
    """Unit of the stamps; default: by their magnitude and distance."""


def _is_a_world(world: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    if len(world) > 1:
        raise ValueError("a log has one world")
    return {name: LOG_WORLDS[name].check(options or {}) for name, options in world.items()}


def _are_names(signals: dict[str, SignalEntry]) -> dict[str, SignalEntry]:
    for name in signals:
        if not re.fullmatch(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*", name) or name == "time":
            raise ValueError(f"formulas cannot name a signal {name!r}")
    return signals


class LogMapping(Entry):
    """A mapping file."""

    time_step: float | None = Field(default=None, gt=0, le=60)
    """Seconds from sample to sample of the episode; default: the usual distance of the samples of
    the fastest signal in the first log."""
    time: TimeEntry = TimeEntry()
    """Stamps."""
    signals: Annotated[dict[str, SignalEntry], AfterValidator(_are_names)] = Field(
        default_factory=dict
    )
    """Signals by name; without any, each field of a table is a signal of its name."""
    world: Annotated[dict[str, dict[str, Any]], AfterValidator(_is_a_world)] = Field(
        default_factory=dict
    )
    """Domain whose signals follow from the poses in the log, with what it has to know: `driving:
    {axes: left-handed}`."""


def read_mapping(given: object, key: str = "mapping") -> LogMapping:
    """Read a mapping from a file, or from plain data.

    Args:
        given: A path, plain data, or a mapping.
        key: What gave it, for messages.

    Raises:
        ConfigurationError: For a file that cannot be read, and keys and values that do not fit.
    """
    if given is None:
        return LogMapping()
    if isinstance(given, LogMapping):
        return given
    if isinstance(given, (str, Path)):
        return validate(LogMapping, read_yaml(Path(given)))
    if isinstance(given, dict):
        return validate(LogMapping, Document(data=given))
    raise ConfigurationError(
        "this is not a mapping of a log",
        key=key,
        found=type(given).__name__,
        expected="the path of a YAML file, or plain data",
        remedy="write one by `python -m pytest_dura logs inspect FILE`",
    )


def bound(mapping: LogMapping, topics: list[Topic], file: str) -> dict[str, SignalEntry]:
    """Bind signals to the topics of a log.

    Raises:
        ConfigurationError: For a topic or field that the log lacks, and one of another type.
    """
    known = {topic.name: topic for topic in topics}
    if not mapping.signals:
        if set(known) != {""}:
            raise ConfigurationError(
                "a log with topics needs a mapping that names its signals",
                file=file,
                key="signals",
                found=f"topics {list_names(list(known))}" if known else "no topic",
                expected="a signal with `topic` and `field`",
                remedy="write a first one by `python -m pytest_dura logs inspect FILE`",
            )
        own = mapping.time.column
        return {
            name: SignalEntry(field=name)
            for name in known[""].fields
            if name != own
            and name.lower() not in TIME_NAMES
            and (name.replace(".", "_") if mapping.world else name).isidentifier()
        }
    for name, entry in mapping.signals.items():
        key = f"signals.{name}"
        if entry.topic not in known:
            raise _lacks(file, f"{key}.topic", "topic", entry.topic, known)
        topic = known[entry.topic]
        for part in entry.fields(name):
            if part in topic.others:
                raise ConfigurationError(
                    f"the field {part!r} is not a number",
                    file=file,
                    key=f"{key}.field",
                    found=topic.others[part],
                    expected=f"one of {list_names(list(topic.fields))}",
                    remedy="bind a field that holds numbers",
                )
            if part not in topic.fields:
                raise _lacks(file, f"{key}.field", "field", part, topic.fields)
        count, due = len(entry.fields(name)), _FIELDS.get(entry.combine or "")
        if (entry.combine is None) != (count == 1) or count != (due or count):
            raise ConfigurationError(
                "several fields go with `combine`, and one without it",
                file=file,
                key=f"{key}.combine",
                found=f"{list_names(entry.fields(name))} with {entry.combine or 'no `combine`'}",
                expected=f"{due} fields for `{entry.combine}`"
                if due
                else "`field: [x, y]` with `combine: norm`, or one field",
                remedy="correct it",
            )
    return dict(mapping.signals)


def _lacks(file: str, key: str, what: str, name: str, known: Iterable[str]) -> ConfigurationError:
    names = [each for each in known if each]  # the columns of a table are of a topic without a name
    expected, remedy = f"a log with a {what}", "name another log"
    if names:
        expected, remedy = f"one of {list_names(names)}", did_you_mean(name, names)
    elif name:
        expected, remedy = f"none: the log has no {what}s", f"leave `{what}` out"
    return ConfigurationError(
        f"the log has no {what} {name!r}",
        file=file,
        key=key,
        found=name or "nothing",
        expected=expected,
        remedy=remedy,
    )


def converted(name: str, entry: SignalEntry, values: Any, recorded: str, file: str) -> Any:
    """Convert values of a field into the unit of the signal.

    Args:
        name: Of the signal.
        entry: Its entry.
        values: Of the field.
        recorded: Unit that the log has of it; empty without one.
        file: The log, for messages.

    Raises:
        ConfigurationError: For a unit that is unknown or does not fit.
    """
    values = values * entry.scale + entry.offset
    source = entry.recorded_in or recorded or entry.unit
    if not entry.unit or source == entry.unit:
        return values
    try:
        import pint
    except ImportError:
        raise ConfigurationError(
            "units are converted by the package pint, which is not installed",
            file=file,
            key=f"signals.{name}.unit",
            found=f"{source} for {entry.unit}",
            expected="pint",
            remedy="pip install 'pytest-dura[logs]'",
        ) from None
    try:
        registry: Any = pint.get_application_registry()  # type: ignore[no-untyped-call]
        return registry.Quantity(values, source).to(entry.unit).magnitude
    except Exception as error:  # of the library, of many kinds
        raise ConfigurationError(
            f"the unit of the field does not fit that of the signal {name!r}",
            file=file,
            key=f"signals.{name}.unit",
            found=f"{source}: {error}",
            expected=f"a unit that converts to {entry.unit}",
            remedy="correct `unit`, or say `recorded_in` where the log is wrong",
        ) from None
