"""DDS by Eclipse Cyclone (``pip install pytest-dura[dds]``): writers and readers of topics.

Each process has a participant of its own; the environment variable ``CYCLONEDDS_URI`` says over
which network. Samples are reliable and in order; what was written before both ends were there is
not repeated.
"""

from __future__ import annotations

from collections.abc import Mapping
from time import monotonic, sleep
from typing import Any

from pytest_dura.core.errors import ConfigurationError

_RETRANSMITTING = 1
"""Seconds for which a writer waits for a reader that does not keep up."""
_PAUSE = 0.002
"""Seconds between two looks for the other end."""
_NEWEST_OF = 512
"""Samples that are taken at once."""


class Participant:
    """What takes part in a domain: its topics, their writers and readers.

    Args:
        domain: Number of the domain, 0 to 232.

    Raises:
        ConfigurationError: Without the package, and where there is no network for it.
    """

    def __init__(self, domain: int) -> None:
        try:
            import cyclonedds
            from cyclonedds import core, pub, sub, topic, util
            from cyclonedds.domain import DomainParticipant
        except ImportError:
            raise ConfigurationError(
                "DDS needs the package cyclonedds",
                key="transport",
                remedy="pip install 'pytest-dura[dds]'",
            ) from None
        self._core, self._pub, self._sub, self._topic = core, pub, sub, topic
        self._seconds = util.duration
        del cyclonedds
        try:
            self._participant: Any = DomainParticipant(domain)
        except core.DDSException as error:
            raise ConfigurationError(
                f"no participant in the DDS domain {domain}: {error}",
                key="transport",
                remedy="correct CYCLONEDDS_URI, the configuration of the network",
            ) from None
        self._qos = core.Qos(
            core.Policy.Reliability.Reliable(util.duration(seconds=_RETRANSMITTING)),
            core.Policy.History.KeepAll,
        )
        self._waiting: Any = core.WaitSet(self._participant)

    def writer(self, name: str, kind: Any) -> Writer:
        """Make a writer of a topic."""
        topic = self._topic.Topic(self._participant, name, kind)
        return Writer(self._pub.DataWriter(self._participant, topic, qos=self._qos))

    def reader(self, name: str, kind: Any, *, best_effort: bool = False) -> Reader:
        """Make a reader of a topic, whose samples :meth:`wait` waits for.

        Args:
            name: Of the topic.
            kind: Type of its samples.
            best_effort: Whether it takes those of writers, too, that repeat nothing.
        """
        core = self._core
        topic = self._topic.Topic(self._participant, name, kind)
        effort = core.Qos(core.Policy.Reliability.BestEffort, core.Policy.History.KeepAll)
        qos = effort if best_effort else self._qos
        reader = self._sub.DataReader(self._participant, topic, qos=qos)
        any_one = core.SampleState.Any | core.ViewState.Any | core.InstanceState.Any
        condition = core.ReadCondition(reader, any_one)
        self._waiting.attach(condition)
        return Reader(reader, condition)

    def wait(self, seconds: float) -> None:
        """Wait until a reader has something, for so long at most."""
        self._waiting.wait(self._seconds(nanoseconds=max(round(seconds * 1e9), 0)))

    def close(self) -> None:
        """Leave the domain."""
        self._waiting = self._participant = None


class Writer:
    """Writer of a topic."""

    def __init__(self, writer: Any) -> None:
        self._writer: Any = writer

    @property
    def matched(self) -> int:
        """Number of readers."""
        return len(self._writer.get_matched_subscriptions())

    @property
    def identity(self) -> int:
        """Number that no other writer has."""
        handle: int = self._writer.instance_handle
        return handle % 2**64

    def write(self, sample: Any) -> None:
        """Write a sample."""
        self._writer.write(sample)


class Reader:
    """Reader of a topic."""

    def __init__(self, reader: Any, condition: Any) -> None:
        self._reader, self._condition = reader, condition

    @property
    def matched(self) -> int:
        """Number of writers."""
        return len(self._reader.get_matched_publications())

    def take(self) -> list[Any]:
        """Take what has come; that a writer has gone, which comes as a sample, too, is left out."""
        from cyclonedds.internal import InvalidSample

        samples = self._reader.take(_NEWEST_OF)
        return [sample for sample in samples if not isinstance(sample, InvalidSample)]


def wait_for_all(ends: Mapping[str, Writer | Reader], seconds: float) -> list[str]:
    """Wait until each writer and reader has another end; returns the names of those without."""
    until = monotonic() + seconds
    while missing := [name for name, end in ends.items() if not end.matched]:
        if monotonic() > until:
            break
        sleep(_PAUSE)
    return missing
