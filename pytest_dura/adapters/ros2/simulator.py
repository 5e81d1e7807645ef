"""Ros2Simulator: a world behind ROS 2 topics, such as Gazebo behind its bridge, or a robot."""

from __future__ import annotations

import json
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

from pytest_dura.adapters.link.simulator import BoundSimulator
from pytest_dura.adapters.ros2.bindings import TopicBinding
from pytest_dura.adapters.ros2.bus import Bus, BusHolder, Ros2Error, text_topic
from pytest_dura.adapters.ros2.messages import TEXT, stamp_of
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.state import Tick


class Ros2Simulator(BoundSimulator):
    """Writes the command's topics, and reads channels and truth from others, in step.

    A reset is a text of JSON on the binding's topic of resets, and a call of its service of resets,
    where it has them. A step is the command, and a call of its service of steps; it is over when
    the clock has come to its time, and each topic has a message stamped then or later, or written
    since the command if it has no header. Without a clock it is over when each has a new message.

    One process, pytest's own, runs its episodes. A subclass declares ``tolerances``, within which a
    replay counts as the same.

    Args:
        binding: A binding file of topics, relative to where pytest was started.
        domain: ``ROS_DOMAIN_ID`` of the world.
        timeout: Seconds of wall-clock time that a step may take, and the answer of a service.
        fallback: Numbers of the command where no role proposes a valid one; zeros by default.
        server: Command line of a program of the project that is started where the topics are not
            there, and ended with the session.

    Raises:
        ConfigurationError: For a binding that cannot be used.
    """

    bus: ClassVar[type[Bus]] = Bus
    instances = "one"
    deterministic: ClassVar[bool] = False
    repeatable: ClassVar[bool] = False

    def __init__(
        self,
        binding: str,
        *,
        domain: int = 0,
        timeout: float = 10.0,
        fallback: Mapping[str, float] = NOTHING,
        server: str = "",
    ) -> None:
        self._topics = TopicBinding.read(binding)
        super().__init__(self._topics, binding, fallback)
        self._timeout = timeout
        extra = text_topic(self._topics.reset)
        self._held = BusHolder(
            domain,
            self._topics,
            written="command",
            read=("percept", "truth"),
            extra=extra,
            services=tuple(self._topics.services.values()),
            server=server,
            kind=self.bus,
        )
        self._clock = () if self._topics.clock is None else (self._topics.clock,)
        self._read = self._topics.topics_of("percept", "truth")
        self._index = self._start = 0

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Reset the world; the time of its clock is 0 from here on."""
        self._bus, self._server = self._held.take(*self._clock)
        self._index = self._start = 0
        self._bus.drain()
        if self._topics.reset is not None:
            world = dict(scenario.get("world") or {})
            given = {"seed": seed, "time_step": self.time_step, "world": world}
            text = self.bus.message_type(TEXT)(json.dumps(given, separators=(",", ":")))
            self._bus.write({self._topics.reset: text})
        self._seed = seed
        self._bus.ask(self._topics.reset_service, seed, self._timeout, self._server)
        self._bus.wait(self._clock, 0, self._timeout, self._server)
        self._start = self._now()
        self._bus.wait(self._read, self._start, self._timeout, self._server)
        return self._tick()

    def step(self, action: Any) -> Tick:
        """Write the command, and take the messages of the next tick.

        Raises:
            Ros2Error: If they do not come in time, the clock has gone on by itself, or the service
                fails.
        """
        command = self._topics.messages("command", action, self._due(), self.bus.zero)
        self._index += 1
        self._bus.drain()
        self._bus.write(command)
        self._bus.ask(self._topics.step_service, self._seed, self._timeout, self._server)
        due = self._due()
        self._bus.wait((*self._read, *self._clock), due, self._timeout, self._server)
        if self._clock and self._now() > due + round(self.time_step * 0.5e9):
            raise Ros2Error(
                f"the world is not in step: {self._clock[0]} is at {self._now() / 1e9:g} s, and "
                f"the tick at {due / 1e9:g} s"
            )
        return self._tick()

    def close(self) -> None:
        """Let go of the topics, which the next episode of this process may use."""
        self._held.give_back()

    def _due(self) -> int:
        return self._start + round(self._index * self.time_step * 1e9)

    def _now(self) -> int:
        return stamp_of(self._bus.newest[self._clock[0]]) if self._clock else 0

    def _tick(self) -> Tick:
        newest = self._bus.newest
        return Tick(
            index=self._index,
            time=self._index * self.time_step,
            truth=MappingProxyType(self._topics.values("truth", newest)),
            channels=self._topics.channels_of(self._topics.values("percept", newest)),
        )
