"""Command ``serve``: a component or a simulator of this project, at the other end of a wire."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable
from time import monotonic
from typing import Any

from pytest_dura.adapters.link.bindings import RESET, STATUS, Binding
from pytest_dura.adapters.link.conversation import Link
from pytest_dura.adapters.link.frames import Frame, Kind
from pytest_dura.adapters.link.simulator import CRITICAL, GOAL, TRUNCATED
from pytest_dura.adapters.link.transports import LinkLostError, open_transport
from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.core.percepts import Percept
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import Generator, RoleContext
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import GeneratorView, Proposal, Tick

SUMMARY = "serve a component or a simulator at the other end of a pipe or another wire"
_WAIT = 0.5
"""Seconds of one wait for a frame; the idle time is looked at in between."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "target", metavar="PATH", help="package.module:Name of a Generator or a Simulator"
    )
    parser.add_argument(
        "--transport", metavar="ADDRESS", required=True, help="such as pipe: or udp:127.0.0.1:5000"
    )
    parser.add_argument("--binding", metavar="FILE", required=True, help="the binding file (YAML)")
    parser.add_argument(
        "--params", metavar="JSON", type=json.loads, default={}, help="keyword parameters"
    )
    parser.add_argument(
        "--idle", metavar="SECONDS", type=float, help="end after so long without a frame"
    )


def run(options: argparse.Namespace) -> Iterable[str]:
    """Serve until the conversation ends; nothing is printed."""
    sys.path.insert(0, "")
    target = _Target(RoleSpec(options.target, options.params), Binding.read(options.binding))
    link = Link(open_transport(options.transport, peer=True))
    try:
        serve(link, target.answer, options.idle)
    except LinkLostError:
        pass  # who asked has gone
    finally:
        link.transport.close()
    return ()


def serve(
    link: Link,
    answer: Callable[[Frame], tuple[Kind, bytes]],
    idle: float | None = None,
    clock: Callable[[], float] = monotonic,
) -> None:
    """Answer frames until one ends the conversation, or none comes for a while.

    Args:
        link: This end of the wire.
        answer: Takes a frame; returns the kind and the payload of its answer.
        idle: Seconds without a frame after which it ends; ``None`` for never.
        clock: Time of this end in s, for the stamps.

    Raises:
        LinkLostError: If the wire is cut.
    """
    last, begun = monotonic(), clock()
    while idle is None or monotonic() - last < idle:
        frame = link.receive(_WAIT)
        if frame is None:
            continue
        last = monotonic()
        if frame.kind is Kind.END:
            return
        try:
            (kind, payload), failed = answer(frame), False
        except Exception as error:  # of the component: the other end names it
            kind, failed = _KINDS.get(frame.kind, Kind.COMMAND), True
            payload = describe_error(error).encode()
        stamp = clock() - begun
        link.send(kind, payload, answers=frame.number, stamp=stamp, failed=failed)


_KINDS = {Kind.RESET: Kind.RESET, Kind.PERCEPT: Kind.COMMAND, Kind.COMMAND: Kind.TICK}


class _Target:
    """What is served.

    Args:
        spec: How it is built, anew for each episode.
        binding: What payloads hold.

    Raises:
        ConfigurationError: For what is neither a component nor a simulator.
    """

    def __init__(self, spec: RoleSpec, binding: Binding) -> None:
        self._spec, self._binding = spec, binding
        self._part: Any = None
        self._dt = 0.1
        if not isinstance(spec.create(), (Generator, Simulator)):
            raise ConfigurationError(
                f"{spec.path} cannot be served",
                found=spec.path,
                expected="a Generator or a Simulator",
            )

    def answer(self, frame: Frame) -> tuple[Kind, bytes]:
        """Return kind and payload of the answer to a frame."""
        if frame.kind is Kind.RESET:
            return self._reset(frame.payload)
        if frame.kind is Kind.PERCEPT and isinstance(self._part, Generator):
            return Kind.COMMAND, self._proposed(frame)
        if frame.kind is Kind.COMMAND and isinstance(self._part, Simulator):
            values, _ = self._binding.unpack("command", frame.payload)
            action = self._part.check_action(self._binding.action_of(values))
            return Kind.TICK, self._packed(self._part.step(action))
        raise ValueError(f"a {frame.kind.name} cannot be answered before a RESET, or at all")

    def _reset(self, payload: bytes) -> tuple[Kind, bytes]:
        seed, self._dt = RESET.unpack_from(payload)
        scenario = json.loads(payload[RESET.size :] or b"{}")
        self._part = self._spec.create()
        if isinstance(self._part, Simulator):
            self._part.set_time_step(self._dt)
            world = type(self._part).check_scenario(scenario)
            return Kind.TICK, self._packed(self._part.reset({"world": world}, seed))
        self._part.reset(RoleContext(seed, self._dt, scenario))
        return Kind.RESET, b""

    def _proposed(self, frame: Frame) -> bytes:
        values, _ = self._binding.unpack("percept", frame.payload)
        percept, time = Percept(self._binding.channels_of(values)), frame.stamp / 1e6
        view = GeneratorView(round(time / self._dt), time, self._dt, percept)
        proposal: Proposal = self._part.propose(view)
        if proposal.failure:
            raise RuntimeError(proposal.failure)
        return self._binding.pack("command", proposal.action) + proposal.explanation.encode()

    def _packed(self, tick: Tick) -> bytes:
        status = GOAL if tick.goal else TRUNCATED if tick.truncated else 0
        status = CRITICAL if tick.critical is not None else status
        numbers = self._binding.pack("truth", tick.truth)
        numbers += self._binding.pack("percept", Percept(tick.channels))
        return STATUS.pack(status) + numbers + (tick.critical or "").encode()
