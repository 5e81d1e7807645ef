"""Faults on the way to a language model: of its prompt, and of how its server is reached."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator

from pytest_dura.core.errors import did_you_mean
from pytest_dura.faults.model import FaultEffect, Kind, Moment
from pytest_dura.faults.parts import FaultPart, NotNegative, RefusedError, Span
from pytest_dura.llm.driving.blocks import BLOCKS
from pytest_dura.llm.port import Delivery, ServerFault
from pytest_dura.llm.prompts import Prompt, reordered, shuffled

How = Literal["refused", "http_429", "http_500", "cut", "garbage", "error_text"]


class ModelFailureParameters(FaultPart):
    """How the server fails."""

    how: How = Field(
        "http_500",
        description="The connection is `refused`; the status is 429 or 500; the answer is `cut` in"
        " the middle, or `garbage` that is no JSON; or status 200 comes with an error"
        " (`error_text`).",
    )


class ModelFailure(FaultEffect):
    """The model's server fails instead of answering; it is not asked then.

    The failure is made where the client meets the network, so that it is read as a real one.
    """

    parameters: ModelFailureParameters = ModelFailureParameters()

    acts_on: ClassVar[Kind] = "model"
    default_target: ClassVar[str | None] = "model"

    def apply(self, memory: Any, value: Delivery, moment: Moment) -> Delivery:  # noqa: ARG002 - as FaultEffect has it
        """The delivery, failing in this way; what failed before stays as it failed."""
        how: ServerFault = self.parameters.how
        return value if value.fault else replace(value, fault=how)


class ModelDelayParameters(FaultPart):
    """How much later answers come."""

    # Twice the time that a scenario gives the component, unless it says otherwise.
    seconds: Annotated[NotNegative, Span(0.0, 10.0)] = Field(
        1.0, description="Seconds that each answer takes longer."
    )


class ModelDelay(FaultEffect):
    """The model's answers take longer; past the time budget they are none."""

    parameters: ModelDelayParameters = ModelDelayParameters()

    acts_on: ClassVar[Kind] = "model"
    default_target: ClassVar[str | None] = "model"

    def apply(self, memory: Any, value: Delivery, moment: Moment) -> Delivery:  # noqa: ARG002 - as FaultEffect has it
        """The delivery, so much later; delays add up."""
        seconds = self.parameters.seconds
        return replace(value, delay=value.delay + seconds) if seconds else value


Names = Annotated[tuple[str, ...], Field(strict=False)]
"""Names of blocks; a list in a scenario file."""


class PromptFault(FaultEffect):
    """Base of the faults that change a prompt before it is put into words."""

    acts_on: ClassVar[Kind] = "prompt"
    default_target: ClassVar[str | None] = "prompt"


class DropParameters(FaultPart):
    """Which blocks are lost."""

    KNOWN: ClassVar[tuple[str, ...]] = BLOCKS

    blocks: Names = Field(
        ("LIDAR",), description="Names of the blocks, in capitals; an empty list drops none."
    )

    @field_validator("blocks")
    @classmethod
    def _are_known(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        """Refuse misspelt names: such a fault would change no prompt."""
        for name in names:
            if name not in cls.KNOWN:
                raise RefusedError(
                    f"the prompt has no block {name!r}",
                    "names of " + ", ".join(cls.KNOWN),
                    did_you_mean(name.upper(), cls.KNOWN, "name blocks of the prompt"),
                )
        return names


class PromptDrop(PromptFault):
    """Blocks of the prompt are lost on the way to the model, names and all.

    The names are those of the built-in driving planner. A planner with other blocks takes a
    subclass, by its import path, whose parameters have its own names as ``KNOWN``.
    """

    parameters: DropParameters = DropParameters()

    typical: ClassVar[Mapping[str, Any]] = {"blocks": ["LIDAR"]}

    def apply(self, memory: Any, value: Prompt, moment: Moment) -> Prompt:  # noqa: ARG002 - as FaultEffect has it
        """The prompt without them."""
        dropped = set(self.parameters.blocks)
        kept = tuple(block for block in value.blocks if block.name not in dropped)
        return value if len(kept) == len(value.blocks) else replace(value, blocks=kept)


class ReorderParameters(FaultPart):
    """Parts whose order changes."""

    objects: bool = Field(True, description="Whether the objects within each block do.")
    blocks: bool = Field(False, description="Whether the blocks themselves do.")


class PromptReorder(PromptFault):
    """The objects of each block of the prompt, or its blocks, stand in another order.

    Nothing is lost or added: a component whose decision rests on the order shows it. The order is
    drawn anew for each prompt.
    """

    parameters: ReorderParameters = ReorderParameters()

    def apply(self, memory: Any, value: Prompt, moment: Moment) -> Prompt:  # noqa: ARG002 - as FaultEffect has it
        """The prompt in another order."""
        if self.parameters.objects:
            value = reordered(value, moment.rng)
        if self.parameters.blocks and len(value.blocks) > 1:
            value = replace(value, blocks=shuffled(value.blocks, moment.rng))
        return value


class ParaphraseParameters(FaultPart):
    """The wording to use."""

    wording: Literal["own", "paraphrased"] = Field(
        "paraphrased", description="A folder of the templates; `own` changes nothing."
    )


class PromptParaphrase(PromptFault):
    """The prompt says the same in other words, in the system's message and in every block."""

    parameters: ParaphraseParameters = ParaphraseParameters()

    def apply(self, memory: Any, value: Prompt, moment: Moment) -> Prompt:  # noqa: ARG002 - as FaultEffect has it
        """The prompt with the other wording."""
        wording = self.parameters.wording
        if wording in ("own", value.wording):
            return value
        return replace(value, wording=wording)
