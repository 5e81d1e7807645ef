"""Replies: what a call in another process came to, as plain data, errors included."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pytest_dura.core.boundary import SessionWanted, traceback_of
from pytest_dura.core.calls import COMPONENT
from pytest_dura.core.errors import ConfigurationError, DuraError, describe_error, shorten

_RESULT, _CONFIGURATION, _LOST, _FAILED, _WANTED = b"r", b"c", b"l", b"f", b"w"
_FAILURE = "a process that simulates failed: "
_OWN_FRAMES = 2
"""Lines of a traceback that are of the process that calls."""
_FIELDS = ("problem", "file", "line", "key", "found", "expected", "remedy")
"""Attributes of a ConfigurationError."""


@dataclass(frozen=True)
class Death:
    """End of a process in the middle of a call.

    Args:
        how: Exit code, signal or limit, in words.
        role: Name of the role that was being called; empty where none was.
        tick: At which tick.
    """

    how: str
    role: str = ""
    tick: int = 0

    @property
    def is_of_component(self) -> bool:
        """Whether the component under test was being called."""
        return self.role == COMPONENT

    def __str__(self) -> str:
        where = f" in a call of the {self.role} at tick {self.tick}" if self.role else ""
        return f"its process {self.how}{where}"


class ProcessLostError(DuraError):
    """Error for an episode whose process ended in the middle.

    Args:
        message: What happened.
        death: Whose call was under way, where that is known.
    """

    def __init__(self, message: str, death: Death | None = None) -> None:
        self.death = death
        super().__init__(message)


class CallFailedError(DuraError):
    """Error for a call in another process that raised anything unexpected there."""


class SessionWantedHereError(DuraError):
    """Error for an episode that needs the session's process, see :class:`SessionWanted`."""


class _Shown:
    """Stand-in for a value of another process, with the same ``repr``."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text


def reply_of(function: Callable[..., bytes], *args: Any, **kwargs: Any) -> bytes:
    """Call a function, and return its result, or what it raised, as a reply."""
    try:
        return _RESULT + function(*args, **kwargs)
    except ConfigurationError as error:
        fields = {name: getattr(error, name) for name in _FIELDS}
        if error.found is not None:
            fields["found"] = shorten(error.found)
        return _CONFIGURATION + json.dumps(fields).encode()
    except ProcessLostError as error:
        death = None if error.death is None else asdict(error.death)
        return _LOST + json.dumps([str(error), death]).encode()
    except (SessionWanted, SessionWantedHereError) as error:
        return _WANTED + str(error).encode(errors="replace")
    except CallFailedError as error:  # of a process behind that one
        return _FAILED + str(error).removeprefix(_FAILURE).encode(errors="replace")
    except BaseException as error:  # whatever user code raises is raised where the call came from
        trace = "".join(traceback.format_tb(traceback_of(error))[_OWN_FRAMES:])
        return _FAILED + f"{describe_error(error)}\n{trace}".encode(errors="replace")


def result_of(reply: bytes) -> bytes:
    """Take the result of a call out of its reply.

    Raises:
        ConfigurationError: As it was raised there; its ``found`` only looks like the value there.
        ProcessLostError: If the episode ended the process that it was given to.
        SessionWantedHereError: If it needs the session's own process.
        CallFailedError: For anything else that was raised there, with the traceback of there.
    """
    kind, body = reply[:1], reply[1:]
    if kind == _RESULT:
        return body
    if kind == _CONFIGURATION:
        data = json.loads(body)
        if data["found"] is not None:
            data["found"] = _Shown(data["found"])
        raise ConfigurationError(**data)
    if kind == _LOST:
        message, death = json.loads(body)
        raise ProcessLostError(message, None if death is None else Death(**death))
    if kind == _WANTED:
        raise SessionWantedHereError(body.decode())
    raise CallFailedError(_FAILURE + body.decode(errors="replace"))


_BEGUN: list[Callable[[], None]] = []
"""How this process lets its parent know that the limit of a call begins, if there is one."""


def begin() -> None:
    """Let the limit of the call that this process carries out begin: its imports are over.

    Called by each function with a limit, which has the time of a start until then.
    """
    for tell in _BEGUN:
        tell()


def tell_begun(tell: Callable[[], None]) -> None:
    """Set how the parent of this process learns that the limit of a call begins."""
    _BEGUN[:] = [tell]


_left_behind: list[str] = []
"""What the calls of this process have left behind in it, so that it gives way to another one."""


def give_way(left_behind: Sequence[str]) -> None:
    """Let this process carry out no further call, for what the present one has left behind."""
    _left_behind.extend(left_behind)


def gives_way() -> bool:
    """Whether this process carries out no further call."""
    return bool(_left_behind)


_attached: list[dict[str, Any]] = []
"""What goes back beside the reply of the call that this process carries out."""


def attach(seen: dict[str, Any]) -> None:
    """Let this go back beside the reply, as it is at the end of the call: plain data."""
    _attached[:] = [seen]


def take_attached() -> dict[str, Any]:
    """Return what goes back beside the reply, once."""
    return _attached.pop() if _attached else {}
