"""Ros2Generator: a component under test behind ROS 2 topics."""

from __future__ import annotations

import json
from typing import Any, ClassVar

from pytest_dura.adapters.link.generator import plain
from pytest_dura.adapters.ros2.bindings import TopicBinding
from pytest_dura.adapters.ros2.bus import Bus, BusHolder, text_topic
from pytest_dura.adapters.ros2.messages import CLOCK, TEXT, set_stamp
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.roles import Generator, RoleContext
from pytest_dura.core.state import GeneratorView, Proposal


class Ros2Generator(Generator):
    """Writes the percept's topics and the clock, and proposes the command that is written then.

    A reset is a text of JSON on the binding's topic of resets, if it has one: seed, time step and
    scenario. One process, pytest's own, runs its episodes; they count as draws. That no command
    comes in time is the component's failure.

    Args:
        binding: A binding file of topics, relative to where pytest was started.
        domain: ``ROS_DOMAIN_ID`` of the component.
        timeout: Seconds of wall-clock time that a command may take.

    Raises:
        ConfigurationError: For a binding that cannot be used.
    """

    bus: ClassVar[type[Bus]] = Bus
    instances: ClassVar[Any] = "one"
    repeatable = False

    def __init__(self, binding: str, *, domain: int = 0, timeout: float = 1.0) -> None:
        self._topics, self._timeout = TopicBinding.read(binding), timeout
        for key in self._topics.services:
            raise ConfigurationError("a component behind topics is asked by no service", key=key)
        self._clock = {} if self._topics.clock is None else {self._topics.clock: CLOCK}
        extra = {**self._clock, **text_topic(self._topics.reset)}
        self._held = BusHolder(
            domain,
            self._topics,
            written="percept",
            read=("command",),
            extra=extra,
            kind=self.bus,
        )
        self._read = self._topics.topics_of("command")

    def reset(self, context: RoleContext) -> None:
        """Reset the component."""
        self._bus, self._server = self._held.take()
        if self._topics.reset is not None:
            given = {
                "seed": context.seed, "time_step": context.dt, "scenario": plain(context.scenario)
            }  # fmt: skip
            text = self.bus.message_type(TEXT)(json.dumps(given, separators=(",", ":")))
            self._bus.write({self._topics.reset: text})

    def propose(self, view: GeneratorView) -> Proposal:
        """Write what is perceived, the clock last, and wait for the command."""
        now = round(view.time * 1e9)
        self._bus.drain()
        self._bus.write(self._topics.messages("percept", view.percept, now, self.bus.zero))
        for topic, name in self._clock.items():
            clock = self.bus.zero(name)
            set_stamp(clock, now)
            self._bus.write({topic: clock})
        self._bus.wait(self._read, now, self._timeout, self._server)
        return Proposal(self._topics.action_of(self._topics.values("command", self._bus.newest)))
