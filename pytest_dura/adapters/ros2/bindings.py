"""Binding of topics: fields of messages to channels, signals and the command, with units."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from pytest_dura.adapters.link.bindings import Binding, Number, part_at
from pytest_dura.adapters.ros2.messages import (
    has_stamp,
    number_type,
    set_stamp,
    set_value,
    value_at,
    zero,
)
from pytest_dura.adapters.ros2.services import ServiceCall
from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.library.documents import Document, read_yaml, validate


class TopicField(Number):
    """A number, or a list of numbers, in the messages of a topic."""

    topic: str = Field(min_length=2, pattern="^/.+")
    """Such as `/odom`; its type stands under `topics`."""
    field: str = Field(min_length=1)
    """Path in the message, such as `twist.twist.linear.x`, `position.0` or `ranges`."""


TopicFields = Annotated[tuple[TopicField, ...], Field(strict=False)]


class TopicBinding(Binding):
    """A binding file of topics.

    A number in a message is ours times `scale`, plus `offset`, as on a wire.
    """

    topics: dict[str, str] = Field(min_length=1)
    """Type of each topic: `/odom: nav_msgs/msg/Odometry`."""
    percept: TopicFields = ()
    """Numbers of the sensor channels; a list of numbers is a channel of its own."""
    command: TopicFields = Field(default=(), min_length=1)
    """Numbers of the action."""
    truth: TopicFields = ()
    """Signals of the truth."""
    clock: str | None = "/clock"
    """Topic of the simulated time; `null` for a world that has none, such as a robot."""
    reset: str | None = None
    """Topic of resets, `std_msgs/msg/String`: seed, time step and the scenario's world as JSON."""
    reset_service: ServiceCall | None = None
    """Service that resets a world, after the topic if there is one."""
    step_service: ServiceCall | None = None
    """Service that lets a world go on for a tick, after the command."""
    best_effort: frozenset[str] = Field(default=frozenset(), strict=False)
    """Topics that are written without repetition, as sensors often are."""

    @classmethod
    def read(cls, file: str | Path) -> TopicBinding:
        """Read a binding file.

        Raises:
            ConfigurationError: For what it must not hold, with the line.
        """
        document = read_yaml(Path(file))
        binding = validate(cls, document)
        binding.checked(document)
        return binding

    def checked(self, document: Document) -> TopicBinding:
        """Check topics, fields, names and units, and return itself.

        Raises:
            ConfigurationError: With the line of the document.
        """
        super().checked(document)
        for key in ("percept", "command", "truth"):
            fields: Sequence[TopicField] = getattr(self, key)
            for index, each in enumerate(fields):
                self._check_field(f"{key}.{index}", each, scalar=key != "percept")
        for topic in sorted(self.best_effort - self.topics.keys()):
            raise self._error("best_effort", f"{topic} is not under `topics`")
        types: dict[str, str] = {}
        for key, call in self.services.items():
            self._check_service(key, call)
            if types.setdefault(call.service, call.type) != call.type:
                raise self._error(key, f"{call.service} has the type {types[call.service]} above")
        return self

    @property
    def services(self) -> dict[str, ServiceCall]:
        """The services that are asked, by key."""
        asked = {"reset_service": self.reset_service, "step_service": self.step_service}
        return {key: call for key, call in asked.items() if call is not None}

    def topics_of(self, *keys: str) -> dict[str, str]:
        """Return the types of the topics that lists need, by topic."""
        fields: list[TopicField] = [each for key in keys for each in getattr(self, key)]
        return {each.topic: self.topics[each.topic] for each in fields}

    def messages(
        self, key: str, values: Any, nanoseconds: int, make: Callable[[str], Any] = zero
    ) -> dict[str, Any]:
        """Make the messages of a list, by topic, stamped where they have a header.

        What a fault removed from a percept is NaN, and no message where the field is an integer.
        """
        messages = {topic: make(name) for topic, name in self.topics_of(key).items()}
        fields: Sequence[TopicField] = getattr(self, key)
        for each, number in zip(fields, self.numbers(key, values), strict=True):
            kind, is_list = number_type(self.topics[each.topic], each.field)
            given = part_at(values, each.name) if is_list else None
            wire = [part * each.scale + each.offset for part in given or ([number] * (not is_list))]
            if not all(map(math.isfinite, wire)) and not kind.startswith("float"):
                messages.pop(each.topic, None)
            elif each.topic in messages:
                set_value(messages[each.topic], each.field, wire if is_list else wire[0], kind)
        for topic, message in messages.items():
            if has_stamp(self.topics[topic]):
                set_stamp(message, nanoseconds)
        return messages

    def values(self, key: str, messages: Mapping[str, Any]) -> dict[str, Any]:
        """Return the numbers of a list by name, from the newest message of each topic."""
        fields: Sequence[TopicField] = getattr(self, key)
        values: dict[str, Any] = {}
        for each in fields:
            there = value_at(messages[each.topic], each.field)
            parts = there if isinstance(there, tuple) else (there,)
            ours = tuple((part - each.offset) / each.scale for part in parts)
            values[each.name] = ours if isinstance(there, tuple) else ours[0]
        return values

    def _check_service(self, key: str, call: ServiceCall) -> None:
        try:
            call.check()
        except ConfigurationError as error:
            raise self._error(
                key, str(error).splitlines()[0], error.remedy or "correct it"
            ) from None

    def _check_field(self, key: str, each: TopicField, *, scalar: bool) -> None:
        if each.topic not in self.topics:
            raise self._error(
                key,
                f"the type of {each.topic} is not under `topics`",
                did_you_mean(each.topic, self.topics),
            )
        try:
            _, is_list = number_type(self.topics[each.topic], each.field)
        except ConfigurationError as error:
            raise self._error(
                key, str(error).splitlines()[0], error.remedy or "correct it"
            ) from None
        if is_list and scalar:
            raise self._error(key, f"{each.field} is a list", "name one of its numbers: `.0`")
