"""LinkGenerator: a component under test at the other end of a wire."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

from pytest_dura.adapters.link.bindings import RESET, Binding
from pytest_dura.adapters.link.conversation import FAULTS, LinkHolder, is_shared
from pytest_dura.adapters.link.frames import Kind
from pytest_dura.adapters.link.transports import transport_class
from pytest_dura.adapters.servers import PORT, project_program
from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.roles import Generator, RoleContext
from pytest_dura.core.state import GeneratorView, Proposal

_STARTING = 60.0
"""Seconds in which the other end has to answer its reset: a program starts before it."""


class LinkGenerator(Generator):
    """Asks a program for each proposal: percept out, command in, in step with the simulator.

    Each process that simulates has a program of its own, which is started once and reset for each
    episode. What is wrong at the other end or on the wire is the component's failure.

    Args:
        transport: Address of the other end, such as ``pipe:./controller``.
        binding: A binding file, relative to where pytest was started.
        timeout: Seconds of wall-clock time that an answer may take.
        clock_tolerance: Seconds by which the other end's clock may be off.
        tolerate: What on the wire is no failure as long as a valid answer comes: ``old``,
            ``doubled``, ``lost``, ``damaged``, ``garbage``.
        files: SHA-256 of the binding and of the program, see :meth:`resolve_parameters`.

    Raises:
        ConfigurationError: For an address or a binding that cannot be used.
    """

    def __init__(
        self,
        transport: str,
        binding: str,
        *,
        timeout: float = 1.0,
        clock_tolerance: float = 0.1,
        tolerate: Sequence[str] = (),
        files: Mapping[str, str] = NOTHING,
    ) -> None:
        check_shared(transport, type(self).__name__, shared=self.instances == "many")
        check_server(transport, "")
        for name in tolerate:
            if name not in FAULTS:
                raise ConfigurationError(
                    f"a link has no fault {name!r}",
                    key="tolerate",
                    found=name,
                    expected=", ".join(FAULTS),
                    remedy=did_you_mean(name, FAULTS),
                )
        check_files(files)
        self._timeout, self._tolerate = timeout, frozenset(tolerate)
        self._binding = Binding.read(binding)
        self._link = LinkHolder(transport, clock_tolerance)

    @classmethod
    def resolve_parameters(cls, params: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the parameters with the digests of the files that episodes are known by."""
        digests = file_digests(str(params.get("transport")), str(params.get("binding")))
        return {**params, "files": digests} if "files" not in params else params

    def reset(self, context: RoleContext) -> None:
        """Reset the other end, by seed, time step and scenario."""
        text = json.dumps(plain(context.scenario), separators=(",", ":"))
        payload = RESET.pack(context.seed, context.dt) + text.encode()
        self._link.take()
        self._link.ask(Kind.RESET, payload, Kind.RESET, max(self._timeout, _STARTING))

    def propose(self, view: GeneratorView) -> Proposal:
        """Send the percept, and propose the command that comes back."""
        percept = self._binding.pack("percept", view.percept)
        answer = self._link.ask(Kind.PERCEPT, percept, Kind.COMMAND, self._timeout, stamp=view.time)
        values, text = self._binding.unpack("command", answer)
        action, wrong = self._binding.action_of(values), self._link.faults.text(self._tolerate)
        return Proposal(action, text, failure=wrong and f"on the link: {wrong}")


class DeviceGenerator(LinkGenerator):
    """As :class:`LinkGenerator`, of a device that exists once, such as a controller on a wire.

    One process, pytest's own, runs its episodes; they count as draws.
    """

    instances = "one"
    repeatable = False


def check_shared(transport: str, name: str, *, shared: bool) -> None:
    """Refuse a wire of which one exists where each process would want its own.

    Raises:
        ConfigurationError: With the class to take.
    """
    if shared and not is_shared(transport):
        device = name.replace("Link", "Device")
        raise ConfigurationError(
            f"a {name} needs a wire for each process that simulates",
            key="transport",
            found=transport,
            expected="a transport such as pipe:PROGRAM",
            remedy=f"take {device}, of which one exists in a session",
        )


def check_server(transport: str, server: str) -> None:
    """Refuse a program that cannot be started for an address.

    Raises:
        ConfigurationError: With the remedy.
    """
    if server:
        project_program(server, "server")
    if (PORT in transport) != (PORT in server) or (server and transport_class(transport).shared):
        raise ConfigurationError(
            "this server cannot be started for this address",
            key="server",
            found=f"transport {transport}, server {server or 'none'}",
            expected=f"an address such as tcp:HOST:PORT, and {PORT} in both or in neither",
            remedy="correct one of them; a program on a pipe is started by its address",
        )


def file_digests(transport: str, binding: str) -> dict[str, str]:
    """Return the SHA-256 of the binding, and of the program of a pipe."""
    name, _, rest = transport.partition(":")
    program = rest.split(" ")[0] if name == "pipe" else ""
    return {
        file: _digest(file) for file in filter(None, (binding, program)) if Path(file).is_file()
    }


def check_files(files: Mapping[str, str]) -> None:
    """Refuse other files than an episode was recorded with.

    Raises:
        ConfigurationError: With the file.
    """
    for file, digest in files.items():
        now = _digest(file) if Path(file).is_file() else "nothing"
        if now != digest:
            raise ConfigurationError(
                "this is another file than the episode was recorded with",
                file=file,
                found=f"SHA-256 {now}",
                expected=f"SHA-256 {digest}",
                remedy="put the recorded file back to replay the episode",
            )


def _digest(file: str) -> str:
    return sha256(Path(file).read_bytes()).hexdigest()


def plain(value: Any) -> Any:
    """Return plain data of a read-only scenario."""
    if isinstance(value, Mapping):
        return {key: plain(part) for key, part in value.items()}
    return [plain(part) for part in value] if isinstance(value, (list, tuple)) else value
