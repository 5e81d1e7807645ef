"""What the types of the catalogue share: what they act on, and their example."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

from pytest_dura.core.state import NOTHING
from pytest_dura.faults.model import Fault, Kind, Moment
from pytest_dura.faults.parts import FaultPart
from pytest_dura.faults.types.numbers import Numeric, number, settled


class NoParameters(FaultPart):
    """None: the type has no parameters."""


class ListedFault(Fault):
    """Base of the types that know no domain.

    ``lasting`` and ``typical`` are the duration in s and the parameters of the fault where only
    its name is given; it begins two seconds into the episode.
    """

    lasting: ClassVar[float | str] = 4.0
    typical: ClassVar[Mapping[str, Any]] = NOTHING

    @classmethod
    def example(cls) -> dict[str, Any]:
        """Two seconds into the episode."""
        found: dict[str, Any] = {"activation": {"at": 2.0}, "duration": cls.lasting}
        return found | ({"parameters": dict(cls.typical)} if cls.typical else {})


class NumberFault(ListedFault):
    """Base of the types whose new value depends on a number alone (or on each one of an array)."""

    acts_on: ClassVar[Kind] = "number"

    def apply(self, memory: Any, value: Any, moment: Moment) -> Any:  # noqa: ARG002 - as Fault has it
        """The number as the fault makes it."""
        return settled(self.changed(number(value), moment))

    @abstractmethod
    def changed(self, value: Numeric, moment: Moment) -> Numeric:
        """The new number; with an array, as many of them."""
