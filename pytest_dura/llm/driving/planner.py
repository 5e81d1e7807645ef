"""LlmPlanner: a language model as a tactical planner at a junction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.roles import RoleContext
from pytest_dura.core.seeding import stream
from pytest_dura.core.state import GeneratorView, PastDecision
from pytest_dura.driving.maneuvers import (
    MAX_ACCELERATION,
    MAX_BRAKING,
    Command,
    Maneuver,
    acceleration_for,
)
from pytest_dura.driving.scene import Scene
from pytest_dura.llm.driving.blocks import driving_prompt
from pytest_dura.llm.driving.images import VIEWS
from pytest_dura.llm.driving.twins import conflict, injected
from pytest_dura.llm.driving.vocabulary import MANEUVERS, SCHEMA
from pytest_dura.llm.driving.wording import driving_templates
from pytest_dura.llm.planner import LlmGenerator
from pytest_dura.llm.port import Message
from pytest_dura.llm.prompts.prompt import Prompt
from pytest_dura.llm.prompts.templates import Templates
from pytest_dura.llm.prompts.variants import blind, paraphrased, reordered
from pytest_dura.llm.settings import Settings


class LlmPlanner(LlmGenerator):
    """Chooses one of the maneuvers from what the sensors report, put into words and pictures.

    Args:
        **params: See :class:`pytest_dura.llm.settings.Settings`.
    """

    MANEUVERS: ClassVar[tuple[str, ...]] = tuple(MANEUVERS)
    SCHEMA: ClassVar[Mapping[str, Any]] = SCHEMA
    NULL: ClassVar[Mapping[str, str]] = {"intent": "hold", "maneuver": Maneuver.PROCEED.value}

    def __init__(self, **params: Any) -> None:
        super().__init__(**params)
        self._templates = _templates(self.settings)
        if self.settings.prompts not in (None, self._templates.digest):
            raise ConfigurationError(
                "the templates of the prompt are not those that this planner was settled with",
                key="prompts",
                found=self._templates.digest,
                expected=self.settings.prompts,
                remedy="bring the templates back, or run the session anew",
            )

    @classmethod
    def templates_digest(cls, settings: Settings) -> str:
        """SHA-256 of all templates in use."""
        return _templates(settings).digest

    def reset(self, context: RoleContext) -> None:
        """Begin an episode."""
        super().reset(context)
        self._accelerations: list[tuple[float, float]] = []

    def prompt(self, view: GeneratorView, past: Sequence[PastDecision]) -> Prompt:
        """The sensors' blocks and pictures, and what became of the latest decisions."""
        seen = tuple(VIEWS) if self.settings.images is None else self.settings.images
        images = seen if self.settings.known_server.vision else ()
        return driving_prompt(view, past, images=images)

    def messages(self, prompt: Prompt) -> tuple[Message, ...]:
        """System, examples, and the blocks with the pictures before them."""
        return self._templates.messages(prompt)

    def variant(self, name: str, prompt: Prompt) -> Prompt:
        """The prompt of a metamorphic twin, or of the negative control."""
        if name == "reordered":
            return reordered(prompt, stream(self._context.seed, f"llm:reordered:{self._asked}"))
        return {
            "paraphrased": paraphrased, "injected": injected, "conflict": conflict, "blind": blind
        }[name](prompt)  # fmt: skip

    def command(self, maneuver: str) -> Command:
        """The maneuver, whose acceleration follows speed and stop line at each tick."""
        return Command(Maneuver(maneuver))

    def extrapolated(self, maneuver: str, view: GeneratorView, *, fresh: bool) -> Command:
        """A first-order hold of the acceleration that the last two decisions asked for.

        It goes on along the line through the two, for as long as they lie apart and within the
        vehicle's envelope.
        """
        command = self.command(maneuver)
        if fresh:
            scene = Scene.of(view.percept)
            asked = acceleration_for(command, scene.speed, scene.to_stop_line)
            if math.isfinite(asked):
                # What was refused at this very tick is no decision to go on from.
                before = [one for one in self._accelerations if one[0] < view.time]
                self._accelerations = [*before[-1:], (view.time, asked)]
        if not self._accelerations:
            return command
        (earlier, first), (time, last) = self._accelerations[0], self._accelerations[-1]
        slope = (last - first) / (time - earlier) if time > earlier else 0.0
        value = last + slope * min(view.time - time, time - earlier)
        return Command(command.maneuver, max(-MAX_BRAKING, min(MAX_ACCELERATION, value)))

    def told(self, action: Command) -> Mapping[str, Any]:
        """Its acceleration, where it has one of its own."""
        return {} if action.acceleration is None else {"acceleration": action.acceleration}


def _templates(settings: Settings) -> Templates:
    return driving_templates(None if settings.templates is None else Path(settings.templates))
