"""Services of ROS 2: their types, and a client that asks them by DDS.

Request and reply are samples of topics, ``rq/<service>Request`` and ``rr/<service>Reply``. Before
its fields each has the identity of the client's writer and a number that counts its requests, as
``rmw_cyclonedds`` writes them (``cdds_request_header_t``); it expects no other middleware to have
them there.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from pytest_dura.adapters.dds import Participant, Reader, Writer
from pytest_dura.adapters.ros2.messages import (
    integer_range,
    number_type,
    sample_type,
    set_value,
    zero,
)
from pytest_dura.adapters.ros2.service_types import SERVICES
from pytest_dura.core.errors import ConfigurationError, did_you_mean


class ServiceCall(BaseModel):
    """A service, and what it is asked."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )

    service: str = Field(min_length=2, pattern="^/.+")
    """Such as `/reset_world`."""
    type: str
    """Such as `std_srvs/srv/Trigger`."""
    request: dict[str, bool | int | float | Literal["seed"]] = {}
    """Numbers of the request by their paths, zeros by default; `seed` is that of the episode."""

    def __str__(self) -> str:
        return f"the service {self.service} ({self.type})"

    def refusal(self, reply: Any) -> str:
        """Why one cannot go on with a reply, in words; empty if one can."""
        if getattr(reply, "success", True):
            return ""
        message = getattr(reply, "message", "")
        return f"{self} answered success: false" + (f", {message!r}" if message else "")

    def check(self) -> None:
        """Check the type, and that the request has the fields.

        Raises:
            ConfigurationError: If not.
        """
        if self.type not in SERVICES:
            raise ConfigurationError(
                f"there is no service type {self.type!r}",
                key="type",
                found=self.type,
                expected=", ".join(SERVICES),
                remedy=did_you_mean(self.type, SERVICES),
            )
        for path, value in self.request.items():
            kind, is_list = number_type(f"{self.type}_Request", path)
            least, greatest = integer_range(kind)
            if kind == "bool":
                fits = isinstance(value, bool)
            elif greatest:
                fits = value == "seed" or (type(value) is int and least <= value <= greatest)
            else:
                fits = type(value) in (int, float)
            if is_list or not fits:
                raise ConfigurationError(f"{path} of {self.type} is a {kind}, and not {value!r}")

    def request_of(self, seed: int, message: Any) -> Any:
        """Fill in a message, and return it; of a seed it has as many bits as there is room for."""
        for path, value in self.request.items():
            kind, _ = number_type(f"{self.type}_Request", path)
            number: Any = seed % (integer_range(kind)[1] + 1) if value == "seed" else value
            set_value(message, path, number, kind)
        return message


class ServiceClient:
    """Client of a service.

    Args:
        participant: Of DDS.
        call: What it asks; another call of the same service may be asked as well.
    """

    def __init__(self, participant: Participant, call: ServiceCall) -> None:
        self._request, reply = (sample_type(f"{call.type}_{e}") for e in ("Request", "Response"))
        self._writer: Writer = participant.writer(f"rq{call.service}Request", self._request)
        self._reader: Reader = participant.reader(f"rr{call.service}Reply", reply)
        self._number = 0

    @property
    def matched(self) -> int:
        """Number of servers."""
        return min(self._writer.matched, self._reader.matched)

    def send(self, call: ServiceCall, seed: int) -> None:
        """Send a request; a reply to one before it counts no longer."""
        self._number += 1
        fields = vars(call.request_of(seed, zero(f"{call.type}_Request")))
        self._writer.write(self._request(self._writer.identity, self._number, **fields))

    def take(self) -> Any:
        """Take the reply to the last request, ``None`` if it has not come."""
        ours = (self._writer.identity, self._number)
        replies = [each for each in self._reader.take() if (each.guid, each.seq) == ours]
        return replies[0] if replies else None
