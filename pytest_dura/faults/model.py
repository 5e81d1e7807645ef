"""Fault: type x target x activation x duration x parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from pytest_dura.faults.activation import Activation
from pytest_dura.faults.duration import Duration
from pytest_dura.faults.parts import FaultPart
from pytest_dura.faults.targets import Target

if TYPE_CHECKING:
    from pytest_dura.faults.channels import Channel

Kind = Literal["number", "any", "command", "objects", "image", "pose", "signs", "prompt", "model"]
"""What a type of fault can act on: a number in a channel or command, any value at all, a command,
a list of objects, a picture, a pose, the texts of signs, what is put before a model, or how that
model is reached."""


@dataclass(frozen=True)
class Moment:
    """What a fault may look at when it acts.

    Args:
        time: Simulated seconds.
        dt: Seconds per tick.
        elapsed: Seconds since this activation.
        channels: All channels, after the faults that were declared earlier. For a command fault,
            as the component saw them.
        history: What stood at the target at earlier ticks, as ``(time, value)``, the present tick
            last; as far back as :attr:`Fault.memory` says.
        random: Makes the fault's random numbers of this tick. Each tick has a stream of its own,
            so that what is drawn at one shifts no other.
    """

    time: float
    dt: float
    elapsed: float
    channels: Mapping[str, Any]
    history: Sequence[tuple[float, Any]]
    random: Callable[[], np.random.Generator]

    @cached_property
    def rng(self) -> np.random.Generator:
        """The random numbers of this fault at this tick."""
        return self.random()


class Fault(FaultPart, ABC):
    """One entry of the catalogue. Subclasses add ``parameters`` and say what they do to a value.

    ``acts_on`` is what the type can act on, ``default_target`` where it does so unless told
    otherwise (``None``: the domain says), and ``reference`` the entry of a threat or failure
    catalogue that it corresponds to, where that was read.
    """

    type: str
    id: str = Field(min_length=1)
    target: str = Field(description="A channel, a field such as `odometry.speed`, or `command`.")
    activation: Activation
    duration: Duration | None = Field(
        None,
        description="In s; `once` (one tick); {min, max} (drawn); {until, at_most};"
        " {on, off, lasting} (intermittent); null for permanent.",
    )

    acts_on: ClassVar[Kind]
    default_target: ClassVar[str | None] = None
    reference: ClassVar[str] = ""

    @classmethod
    @abstractmethod
    def example(cls) -> dict[str, Any]:
        """Activation and duration of the fault where only its name is given."""

    @property
    def by_chance(self) -> bool:
        """Whether it is drawn whether the fault has any effect."""
        return self.activation.by_chance or self.hits_by_chance

    @property
    def hits_by_chance(self) -> bool:
        """Whether an active fault may leave every value as it is, because its hits are drawn."""
        return False

    @property
    def memory(self) -> float:
        """Seconds before the present of which it needs the target's values; 0 for none."""
        return 0.0

    @property
    def place(self) -> Target:
        """The target, read."""
        return Target.parse(self.target)

    def check_parameters(self, channel: Channel) -> None:
        """Refuse parameters that do not suit the channel, which the target does.

        Raises:
            ConfigurationError: With what would.
        """

    def begin(self, value: Any, moment: Moment) -> Any:  # noqa: ARG002 - for those who override it
        """What the fault remembers from its activation on: ``None`` if it cannot act yet.

        It is asked again at each tick until it can.
        """
        return True

    @abstractmethod
    def apply(self, memory: Any, value: Any, moment: Moment) -> Any:
        """The target's new value. The very object that was there means that nothing was changed.

        Values are not to be written into; ``memory`` may be.
        """
