"""Wrong values of one number, in a channel (bias, noise, bit flips, ...) or in the command."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from pytest_dura.faults.model import FaultEffect, Kind, Moment
from pytest_dura.faults.parts import (
    FaultPart,
    Finite,
    NotNegative,
    Positive,
    Quantity,
    Span,
    Suited,
)
from pytest_dura.faults.types.base import (
    NoParameters,
    NumberFault,
    Numeric,
    as_channel_value,
    flip_bits,
    numeric_value,
)
from pytest_dura.faults.types.timing import Held, Receiver, ReceiverFault


def _sized(name: str, quantity: Quantity, per: float = 1.0) -> dict[str, Suited]:
    """Size a parameter by the typical error of its target; nothing where none is declared."""
    usual, most = quantity.fault_error, quantity.largest_error
    if usual is None or most is None:
        return {}
    return {name: Suited(usual * per, Span(-most * per, most * per))}


def _shares(quantity: Quantity) -> tuple[float, float] | None:
    """Return usual and largest error as shares of the greatest value that is reported."""
    usual, most, value = quantity.fault_error, quantity.largest_error, quantity.largest_value
    if usual is None or most is None or not value:
        return None
    return usual / value, most / value


class BiasParameters(FaultPart):
    """Size of the error."""

    offset: Annotated[Finite, Span(-10.0, 10.0)] = Field(
        1.0, description="Added to it, in the field's unit."
    )
    percent: Annotated[Finite, Span(-100.0, 100.0)] = Field(
        0.0, description="Also added: this part of the number itself, in %."
    )


class Bias(NumberFault):
    """A constant error: the number plus ``offset``, plus ``percent`` % of the number itself.

    With both at 0 it is the identity.
    """

    parameters: BiasParameters = BiasParameters()

    @classmethod
    def suited(cls, quantity: Quantity, seconds: float) -> Mapping[str, Suited]:  # noqa: ARG003 - as FaultEffect has it
        """Size the error by the typical one; in percent, by that at the greatest value."""
        by_percent = (
            {}
            if (share := _shares(quantity)) is None
            else {"percent": Suited(0.0, Span(-100.0 * share[1], 100.0 * share[1]))}
        )
        return _sized("offset", quantity) | by_percent

    def changed(self, value: Numeric, moment: Moment) -> Numeric:  # noqa: ARG002 - as NumberFault has it
        """Return the number with its error."""
        return value + (self.parameters.offset + value * (self.parameters.percent / 100.0))


class DriftParameters(FaultPart):
    """Growth of the error."""

    rate: Annotated[Finite, Span(-5.0, 5.0)] = Field(
        0.5, description="In the field's unit per second; may be negative."
    )


class Drift(NumberFault):
    """An error that grows from 0 at the activation: the number plus ``rate`` times the seconds."""

    parameters: DriftParameters = DriftParameters()

    @classmethod
    def suited(cls, quantity: Quantity, seconds: float) -> Mapping[str, Suited]:
        """Let the error become at its end what a bias has."""
        return _sized("rate", quantity, 1.0 / seconds)

    def changed(self, value: Numeric, moment: Moment) -> Numeric:
        """Return the number with what has built up so far."""
        return value + self.parameters.rate * moment.elapsed


class NoiseParameters(FaultPart):
    """Strength and distribution of the noise."""

    sigma: Annotated[NotNegative, Span(0.0, 5.0)] = Field(
        0.5, description="Standard deviation of each distribution, in the field's unit."
    )
    distribution: Literal["gaussian", "uniform", "laplace"] = Field(
        "gaussian", description="Shape of the noise, which has mean 0."
    )


class Noise(NumberFault):
    """A random error of mean 0, drawn anew at each tick. With ``sigma`` 0 it is the identity."""

    parameters: NoiseParameters = NoiseParameters()

    @classmethod
    def suited(cls, quantity: Quantity, seconds: float) -> Mapping[str, Suited]:  # noqa: ARG003 - as FaultEffect has it
        """Half of what a bias has: about one draw in twenty is larger than that."""
        sized = _sized("sigma", quantity, 0.5)
        return {
            name: Suited(default, None if span is None else Span(0.0, span.high))
            for name, (default, span) in sized.items()
        }

    def changed(self, value: Numeric, moment: Moment) -> Numeric:
        """Return the number with this tick's error."""
        sigma, size = self.parameters.sigma, np.shape(value)
        if self.parameters.distribution == "uniform":
            half = math.sqrt(3.0) * sigma
            return value + half * moment.rng.uniform(-1.0, 1.0, size)
        if self.parameters.distribution == "laplace":
            return value + moment.rng.laplace(0.0, sigma / math.sqrt(2.0), size)
        return value + sigma * moment.rng.standard_normal(size)


class GainParameters(FaultPart):
    """Scale of the number."""

    factor: Annotated[Finite, Span(0.0, 3.0, neutral=1.0)] = Field(
        1.5, description="Without unit; 1 is the identity."
    )


class Gain(NumberFault):
    """A wrong scale: the number times ``factor``. The identity is at 1."""

    parameters: GainParameters = GainParameters()

    @classmethod
    def suited(cls, quantity: Quantity, seconds: float) -> Mapping[str, Suited]:  # noqa: ARG003 - as FaultEffect has it
        """Size the error at the greatest value by the typical one."""
        if (share := _shares(quantity)) is None:
            return {}
        usual, most = share
        return {"factor": Suited(1.0 + usual, Span(1.0 - most, 1.0 + most, neutral=1.0))}

    def changed(self, value: Numeric, moment: Moment) -> Numeric:  # noqa: ARG002 - as NumberFault has it
        """Return the number, scaled."""
        return value * self.parameters.factor


class StuckAtParameters(FaultPart):
    """Reported number."""

    value: Annotated[Finite, Span(-10.0, 10.0)] = Field(
        0.0, description="Reported whatever is true, in the field's unit."
    )


class StuckAt(NumberFault):
    """The number is ``value``, whatever is true."""

    parameters: StuckAtParameters = StuckAtParameters()

    @classmethod
    def suited(cls, quantity: Quantity, seconds: float) -> Mapping[str, Suited]:  # noqa: ARG003 - as FaultEffect has it
        """Report a value of the range, the one nearest to 0."""
        if quantity.ends is None:
            return {}
        low, high = quantity.ends
        nearest = min(max(0.0, low), high)
        return {"value": Suited(nearest, Span(low, high, neutral=nearest))}

    def changed(self, value: Numeric, moment: Moment) -> Numeric:  # noqa: ARG002 - as NumberFault has it
        """Return the given number."""
        stuck: Numeric = np.full(np.shape(value), self.parameters.value)[()]
        return stuck


class BitFlipParameters(FaultPart):
    """Number of flipped bits."""

    bits: Annotated[int, Span(0, 8)] = Field(
        1, ge=0, le=32, description="Bits inverted at each tick; 0 is the identity."
    )


class BitFlip(FaultEffect):
    """So many bits of the 64-bit float are inverted, drawn anew at each tick.

    The result is finite: where the draw gives infinity or no number, as many bits are drawn anew
    from the sign and the mantissa. A channel that keeps shorter floats has those flipped.
    """

    parameters: BitFlipParameters = BitFlipParameters()

    acts_on: ClassVar[Kind] = "number"

    def apply(self, memory: Any, value: Any, moment: Moment) -> Any:  # noqa: ARG002 - as FaultEffect has it
        """Return the number with its bits flipped."""
        bits, rng = self.parameters.bits, moment.rng
        given = numeric_value(value)
        if not isinstance(given, np.ndarray):
            return float(flip_bits(value if isinstance(value, np.floating) else given, bits, rng))
        kept = value if value.dtype.kind == "f" else given
        flipped = np.array([flip_bits(number, bits, rng) for number in kept.ravel()], kept.dtype)
        return as_channel_value(flipped.reshape(kept.shape))


class OutOfRangeParameters(FaultPart):
    """Valid range, and distance of the report beyond it."""

    low: Finite = Field(description="Lower end of the valid range, in the field's unit.")
    high: Finite = Field(description="Upper end of the valid range, in the field's unit.")
    excess: Annotated[Positive, Span(0.1, 100.0, neutral=0.1)] = Field(
        10.0, description="Beyond the limit by this, in the field's unit."
    )
    side: Literal["above", "below"] = Field("above", description="Beyond which limit.")

    @model_validator(mode="after")
    def _a_range(self) -> OutOfRangeParameters:
        if self.low > self.high:
            raise ValueError(f"low is above high ({self.low:g} > {self.high:g})")
        if self.low <= self.reported <= self.high or not math.isfinite(self.reported):
            raise ValueError(f"{self.reported:g} is no number beyond the range; change the excess")
        return self

    @property
    def reported(self) -> float:
        """Value beyond the limit."""
        return self.high + self.excess if self.side == "above" else self.low - self.excess


class OutOfRange(NumberFault):
    """A value that cannot be: ``high + excess``, or ``low - excess`` with side ``below``."""

    parameters: OutOfRangeParameters

    typical: ClassVar[Mapping[str, Any]] = {"low": 0.0, "high": 100.0}

    @classmethod
    def suited(cls, quantity: Quantity, seconds: float) -> Mapping[str, Suited]:  # noqa: ARG003 - as FaultEffect has it
        """Report a value beyond the declared range, by a tenth of it."""
        if quantity.ends is None:
            return {}
        low, high = quantity.ends
        width = high - low
        excess = Suited(0.1 * width, Span(0.01 * width, width, neutral=0.01 * width))
        return {"low": Suited(low), "high": Suited(high), "excess": excess}

    def changed(self, value: Numeric, moment: Moment) -> Numeric:  # noqa: ARG002 - as NumberFault has it
        """Return the value beyond the limit."""
        beyond: Numeric = np.full(np.shape(value), self.parameters.reported)[()]
        return beyond


class LossOfEffectivenessParameters(FaultPart):
    """Lost part of the command."""

    percent: Annotated[float, Field(ge=0, le=100, allow_inf_nan=False), Span(0.0, 100.0)] = Field(
        50.0, description="Lost part of the command, in %; 0 is the identity, 100 is no effect."
    )


class LossOfEffectiveness(NumberFault):
    """The actuator does less than it is commanded: the command times ``1 - percent / 100``."""

    parameters: LossOfEffectivenessParameters = LossOfEffectivenessParameters()

    acts_on: ClassVar[Kind] = "command"

    def changed(self, value: Numeric, moment: Moment) -> Numeric:  # noqa: ARG002 - as NumberFault has it
        """Return the rest of the command."""
        return value * (1.0 - self.parameters.percent / 100.0)


class LagParameters(FaultPart):
    """Time constant of the actuator."""

    s: Annotated[NotNegative, Span(0.0, 3.0)] = Field(
        0.5, description="Time constant, in s: after a step it has gone 63 %; 0 is the identity."
    )


class Lag(ReceiverFault):
    """The actuator follows the command as a first-order lag does, from the last command on.

    After t seconds of a constant command, exp(-t / s) of the way to it is left.
    """

    parameters: LagParameters = LagParameters()

    acts_on: ClassVar[Kind] = "command"

    def received(self, receiver: Receiver, value: Any, moment: Moment) -> Any:
        """Return the position of the actuator at this tick."""
        if self.parameters.s == 0.0:
            return value
        left = math.exp(-moment.dt / self.parameters.s)
        # Exact where nothing is left to go: the command itself.
        return as_channel_value(
            numeric_value(value) + left * (numeric_value(receiver.shown) - numeric_value(value))
        )


class StuckCommand(Held):
    """The command of the activation stays, whatever is commanded then."""

    acts_on: ClassVar[Kind] = "command"


class Inversion(NumberFault):
    """The actuator does the opposite: the command with its sign inverted."""

    parameters: NoParameters = NoParameters()

    acts_on: ClassVar[Kind] = "command"

    def changed(self, value: Numeric, moment: Moment) -> Numeric:  # noqa: ARG002 - as NumberFault has it
        """Return the opposite."""
        return -value
