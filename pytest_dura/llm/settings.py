"""Settings: the parameters of a language model's planner, checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from pytest_dura.core.errors import ConfigurationError

Seconds = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Beside = Literal["reordered", "paraphrased", "injected", "conflict", "blind"]
EVERYTHING: tuple[Beside, ...] = ("reordered", "paraphrased", "injected", "conflict", "blind")


class Server(BaseModel):
    """What of a server determines its answers, or how it is asked; from the capability probe."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    fingerprint: str = Field("", description="Of the server and the model that it serves.")
    structured: Literal["json_schema", "json_object_schema", "json_object", "none"] = Field(
        "none", description="How it is asked for a structured answer."
    )
    vision: bool = Field(False, description="Whether it sees pictures.")
    seed: bool = Field(False, description="Whether it takes a seed.")


class Settings(BaseModel):
    """The parameters of the role ``generator`` when it is a language model."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    model: str | None = Field(
        None, max_length=500, description="Name of the model; by default the environment's."
    )
    server: Server | None = Field(None, description="Filled in by the capability probe.")
    prompts: str | None = Field(None, description="Digest of the templates; filled in.")
    templates: str | None = Field(
        None, description="A directory whose files replace templates of the same name."
    )
    decide_every: int = Field(10, ge=1, description="Ticks from one decision to the next.")
    between: Literal["hold", "extrapolate"] = Field(
        "hold",
        description="Between two decisions: hold the maneuver, or extrapolate its acceleration.",
    )
    clock: Literal["frozen", "realtime"] = Field(
        "frozen",
        description="The simulation waits for an answer, or the decision lands after its latency.",
    )
    fallback: str = Field(
        "wait",
        description="What is proposed without a decision: a maneuver; `last`, the last one that"
        " was decided; `none`, nothing at all.",
    )
    budget: Seconds | None = Field(
        None, description="Seconds for one answer, at most the episode's time budget."
    )
    temperature: float = Field(
        0.0, ge=0, le=2, allow_inf_nan=False, description="Of the sampling, from 0 to 2."
    )
    max_tokens: int = Field(600, ge=16, le=8192, description="Longest answer, in tokens.")
    samples: int = Field(
        2, ge=1, le=20, description="How often the same is asked, to see whether answers agree."
    )
    beside: tuple[Beside, ...] = Field(
        EVERYTHING, description="Variants of the prompt that are asked beside it, or `all`."
    )
    beside_every: int = Field(
        10, ge=1, description="Samples and variants are asked beside every n-th decision."
    )
    history: int = Field(3, ge=0, le=20, description="Earlier decisions in the prompt.")
    images: tuple[str, ...] | None = Field(
        None, description="Cameras whose pictures are shown; by default all, to a model that sees."
    )

    @field_validator("beside", mode="before")
    @classmethod
    def _all(cls, value: Any) -> Any:
        return EVERYTHING if value == "all" else value

    @field_validator("beside")
    @classmethod
    def _once(cls, value: tuple[Beside, ...]) -> tuple[Beside, ...]:
        return tuple(dict.fromkeys(value))

    @classmethod
    def of(cls, params: Mapping[str, Any], maneuvers: Sequence[str]) -> Settings:
        """The settings of a role's parameters.

        Args:
            params: As they were given.
            maneuvers: What the fallback may be.

        Raises:
            ConfigurationError: For a parameter that is unknown, or a value that cannot be used.
        """
        try:
            found = cls.model_validate(dict(params))
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(map(str, first["loc"]))
            raise ConfigurationError(
                f"the parameter {key!r} of the language model cannot be used: {first['msg']}",
                key=key,
                found=first["input"],
                expected="one of " + ", ".join(cls.model_fields)
                if first["type"] == "extra_forbidden"
                else cls._described(str(first["loc"][0])),
                remedy="correct it where the generator is given",
            ) from None
        allowed = (*maneuvers, "last", "none")
        if found.fallback not in allowed:
            raise ConfigurationError(
                f"the parameter 'fallback' cannot be {found.fallback!r}",
                key="fallback",
                found=found.fallback,
                expected="one of " + ", ".join(allowed),
                remedy="correct it where the generator is given",
            )
        return found

    @classmethod
    def _described(cls, name: str) -> str:
        known = cls.model_fields.get(name)
        return "" if known is None else known.description or ""

    def deadline(self, budget: float | None) -> float | None:
        """Seconds for one answer, where a proposal has this time budget."""
        return min((one for one in (self.budget, budget) if one is not None), default=None)

    @property
    def known_server(self) -> Server:
        """What is known of the server; the least if it was never asked."""
        return self.server or Server()

    @property
    def again(self) -> tuple[str, ...]:
        """Names of the samples that are asked beside a deciding request."""
        return tuple(
            "again" if number == 1 else f"again_{number}" for number in range(1, self.samples)
        )
