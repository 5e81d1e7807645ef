"""Settings: the parameters of a language model as Generator, with what a probe knows of servers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.llm.endpoint import own_fields
from pytest_dura.llm.port import Structured, TokensField

Seconds = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Temperature = Annotated[float, Field(ge=0, le=2, allow_inf_nan=False)]
Beside = Literal[
    "reordered", "paraphrased", "reformatted", "neutral", "injected", "unhardened", "conflict",
    "blind",
]  # fmt: skip
EVERYTHING: tuple[Beside, ...] = get_args(Beside)
_ATTACKED: tuple[Beside, ...] = ("injected", "unhardened")


class KnownServer(BaseModel):
    """Properties of a server that determine requests and answers; from the capability probe."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    fingerprint: str = Field("", description="Of the server and the model that it serves.")
    structured: Structured = Field("none", description="How it is asked for a structured answer.")
    vision: bool = Field(False, description="Whether it sees pictures.")
    seed: bool = Field(False, description="Whether it takes a seed.")
    tokens: TokensField = Field(
        "max_tokens", description="The field in which it takes the longest answer."
    )
    temperature: bool = Field(True, description="Whether it takes a temperature of 0.")
    extra_body: dict[str, Any] = Field(
        default_factory=dict, description="Further fields of the body, of the environment."
    )

    @classmethod
    def stated(cls, fingerprint: str, capabilities: Mapping[str, Any]) -> dict[str, Any]:
        """Plain data on a server; what only few servers need is left out for the others."""
        server = {name: capabilities[name] for name in ("structured", "vision", "seed")}
        usual = cls()
        for name in ("tokens", "temperature", "extra_body"):
            if capabilities.get(name, getattr(usual, name)) != getattr(usual, name):
                server[name] = capabilities[name]
        return {"fingerprint": fingerprint, **server}


class Settings(BaseModel):
    """The parameters of the role ``generator`` when it is a language model."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    model: str | None = Field(
        None, max_length=500, description="Name of the model; by default the environment's."
    )
    server: KnownServer | None = Field(None, description="Filled in by the capability probe.")
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
    count_retries: bool = Field(
        False,
        description="Whether the time of requests that were repeated, because the server was not"
        " available, is the component's.",
    )
    temperature: Temperature | None = Field(
        0.0, description="Of the sampling, from 0 to 2; none is sent for a null."
    )
    max_tokens: int = Field(1000, ge=16, le=8192, description="Longest answer, in tokens.")
    max_tokens_field: TokensField | None = Field(
        None, description="The field that has it; by default what the probe found."
    )
    extra_body: dict[str, Any] = Field(
        default_factory=dict, description="Further fields of each request's body."
    )
    stream: bool = Field(
        False, description="Whether answers come in parts, so that the time to the first is known."
    )
    samples: int = Field(
        2, ge=1, le=20, description="How often the same is asked, to see whether answers agree."
    )
    beside: tuple[Beside, ...] = Field(
        EVERYTHING, description="Variants of the prompt that are asked beside it, or `all`."
    )
    beside_every: int = Field(
        10, ge=1, description="Samples and variants are asked beside every n-th decision."
    )
    injections: Literal["in_turn", "all"] = Field(
        "in_turn",
        description="The attackers' texts of `injected` and `unhardened`: the next one at each"
        " decision, or all of them.",
    )
    hardened: bool = Field(
        True,
        description="Whether texts of the scene are enclosed, and the model is warned of them.",
    )
    judge: bool | Annotated[str, Field(min_length=1, max_length=500)] = Field(
        False,
        description="Whether a model judges if the reasoning leads to the maneuver, beside the"
        " decisions that samples and variants go with: `true` for the same model, or a name.",
    )
    judge_server: KnownServer | None = Field(
        None, description="Of a judge with a name; filled in by the capability probe."
    )
    prompt: Literal["full", "brief"] = Field(
        "full",
        description="Brief for a model of a small context: fewer blocks and objects, no examples.",
    )
    history: int = Field(3, ge=0, le=20, description="Earlier decisions in the prompt.")
    images: tuple[str, ...] | None = Field(
        None, description="Cameras whose pictures are shown; by default all, to a model that sees."
    )

    @field_validator("beside", mode="before")
    @classmethod
    def _all(cls, value: Any) -> Any:
        return EVERYTHING if value == "all" else value

    @field_validator("extra_body")
    @classmethod
    def _are_others(cls, fields: dict[str, Any]) -> dict[str, Any]:
        if own := own_fields(fields):
            raise ValueError(f"a request sets {', '.join(own)} itself")
        return fields

    @field_validator("beside")
    @classmethod
    def _once(cls, value: tuple[Beside, ...]) -> tuple[Beside, ...]:
        return tuple(dict.fromkeys(value))

    @classmethod
    def of(cls, params: Mapping[str, Any], maneuvers: Sequence[str]) -> Settings:
        """The settings of a role's parameters.

        Args:
            params: As they were given.
            maneuvers: Those that the fallback may be.

        Raises:
            ConfigurationError: For a parameter that is unknown, or a value that cannot be used.
        """
        try:
            settings = cls.model_validate(dict(params))
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(map(str, first["loc"]))
            known = cls.model_fields.get(str(first["loc"][0]))
            raise ConfigurationError(
                f"the parameter {key!r} of the language model cannot be used: {first['msg']}",
                key=key,
                found=first["input"],
                expected="one of " + ", ".join(cls.model_fields)
                if first["type"] == "extra_forbidden"
                else (known and known.description) or "",
                remedy="correct it where the generator is given",
            ) from None
        allowed = (*maneuvers, "last", "none")
        if settings.fallback not in allowed:
            raise ConfigurationError(
                f"the parameter 'fallback' cannot be {settings.fallback!r}",
                key="fallback",
                found=settings.fallback,
                expected="one of " + ", ".join(allowed),
                remedy="correct it where the generator is given",
            )
        return settings

    def deadline(self, budget: float | None) -> float | None:
        """Seconds for one answer, where a proposal has this time budget."""
        return min((each for each in (self.budget, budget) if each is not None), default=None)

    @property
    def known_server(self) -> KnownServer:
        """Properties of the server; the weakest if it was never probed."""
        return self.server or KnownServer()

    @property
    def further_samples(self) -> tuple[str, ...]:
        """Names of the further samples of a deciding request."""
        return tuple(
            "again" if number == 1 else f"again_{number}" for number in range(1, self.samples)
        )

    def variants(self, attacks: int) -> tuple[str, ...]:
        """Names of the variants that are asked beside a decision.

        Args:
            attacks: Number of the attackers' texts.
        """
        count = attacks if self.injections == "all" else 1
        return tuple(
            name if number == 1 else f"{name}_{number}"
            for name in self.beside
            for number in range(1, (count if name in _ATTACKED else 1) + 1)
        )
