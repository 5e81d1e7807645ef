"""LinkSimulator: a world at the other end of a wire."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

from pytest_dura.adapters.link.bindings import RESET, STATUS, Binding
from pytest_dura.adapters.link.conversation import LinkHolder
from pytest_dura.adapters.link.frames import Kind
from pytest_dura.adapters.link.generator import check_server, check_shared
from pytest_dura.adapters.plain_signals import PlainSignals
from pytest_dura.core.errors import ActionError, ConfigurationError, shorten
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.state import Tick

GOAL, CRITICAL, TRUNCATED = 1, 2, 3
"""Status of a tick, beside 0."""
_ENDED = "the simulator has ended the episode"


class BoundSimulator(PlainSignals):
    """World whose actions, channels and signals are those of a binding.

    Args:
        binding: The binding; it has signals of the truth.
        file: Its file.
        fallback: Numbers of the command where no role proposes a valid one; zeros by default.

    Raises:
        ConfigurationError: Without signals of the truth.
    """

    def __init__(self, binding: Binding, file: str, fallback: Mapping[str, float]) -> None:
        self._binding = binding
        if not binding.truth:
            raise ConfigurationError(
                "the binding of a simulator has no signals of the truth",
                file=file,
                key="truth",
                expected="the signals that requirements read",
                remedy="list them under `truth`",
            )
        self._fallback = {number.name: 0.0 for number in binding.command} | dict(fallback)

    def check_action(self, action: Any) -> Any:
        """Return an action that has a finite number for each of the command.

        Raises:
            ActionError: For any other one.
        """
        if not all(map(math.isfinite, self._binding.numbers("command", action))):
            names = ", ".join(number.name for number in self._binding.command)
            raise ActionError(f"{shorten(action)} is not an action; expected numbers: {names}")
        return action

    def fallback_action(self) -> Any:
        """Return the configured fallback."""
        return self._binding.action_of(self._fallback)


class LinkSimulator(BoundSimulator):
    """Simulates by a program: action out, tick in, in step.

    The answer to a reset and to each command is a tick: its status, the numbers of ``truth`` and
    those of ``percept``. Each instance has a program of its own while it lives.

    Args:
        transport: Address of the other end, such as ``pipe:./tank``.
        binding: A binding file, relative to where pytest was started.
        timeout: Seconds of wall-clock time that a step may take.
        fallback: Numbers of the command where no role proposes a valid one; zeros by default.
        server: Command line of a program of the project that is started where nothing answers at
            the address, and ended with the session. With ``{port}`` in it and in the address, each
            instance has one of its own at a free port.

    Raises:
        ConfigurationError: For an address or a binding that cannot be used.
    """

    def __init__(
        self,
        transport: str,
        binding: str,
        *,
        timeout: float = 10.0,
        fallback: Mapping[str, float] = NOTHING,
        server: str = "",
    ) -> None:
        check_shared(transport, type(self).__name__, shared=self.instances == "many")
        check_server(transport, server)
        super().__init__(Binding.read(binding), binding, fallback)
        self._timeout = timeout
        self._link = LinkHolder(transport, math.inf, server)
        self._index = 0

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Reset the other end, by seed, time step and the scenario's world."""
        self._link.take()
        self._index = 0
        text = json.dumps(dict(scenario.get("world") or {}), separators=(",", ":"))
        return self._tick(Kind.RESET, RESET.pack(seed, self.time_step) + text.encode())

    def step(self, action: Any) -> Tick:
        """Send the command, and take the tick that comes back."""
        self._index += 1
        return self._tick(Kind.COMMAND, self._binding.pack("command", action))

    def close(self) -> None:
        """Let go of the program, which the next episode of this process may use."""
        self._link.give_back()

    def _tick(self, kind: Kind, payload: bytes) -> Tick:
        answer = self._link.ask(kind, payload, Kind.TICK, self._timeout)
        (status,) = STATUS.unpack_from(answer)
        truth, rest = self._binding.split("truth", answer[STATUS.size :])
        percept, text = self._binding.unpack("percept", rest)
        return Tick(
            index=self._index,
            time=self._index * self.time_step,
            truth=MappingProxyType(truth),
            channels=self._binding.channels_of(percept),
            goal=status == GOAL,
            critical=(text or "the simulator has ended the episode")
            if status == CRITICAL
            else None,
            truncated=status == TRUNCATED,
        )


class DeviceSimulator(LinkSimulator):
    """As :class:`LinkSimulator`, of a world that exists once and is not repeated exactly: a rig.

    A subclass declares ``tolerances``, within which a replay counts as the same.
    """

    instances = "one"
    deterministic: ClassVar[bool] = False
    repeatable: ClassVar[bool] = False
