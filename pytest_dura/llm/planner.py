"""LlmGenerator: a language model as the component under test in any domain, and its settings."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.roles import Generator, RoleContext
from pytest_dura.core.state import NOTHING, GeneratorView, PastDecision, Proposal
from pytest_dura.llm import session
from pytest_dura.llm.answers import Reading, read_answer
from pytest_dura.llm.port import Answer, Delivery, Message, Request
from pytest_dura.llm.prompts import Prompt

Seconds = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Beside = Literal["reordered", "paraphrased", "injected", "conflict", "blind"]
EVERYTHING: tuple[Beside, ...] = ("reordered", "paraphrased", "injected", "conflict", "blind")


class KnownServer(BaseModel):
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
        return min((item for item in (self.budget, budget) if item is not None), default=None)

    @property
    def known_server(self) -> KnownServer:
        """What is known of the server; the least if it was never asked."""
        return self.server or KnownServer()

    @property
    def again(self) -> tuple[str, ...]:
        """Names of the samples that are asked beside a deciding request."""
        return tuple(
            "again" if number == 1 else f"again_{number}" for number in range(1, self.samples)
        )


_PENDING = "pending"
"""Outcome of a decision that has not landed yet."""


@dataclass(frozen=True)
class Decision:
    """What the model decided, or why it did not.

    Args:
        at: Index of the tick whose percept it rests on.
        time: Simulated seconds of that tick.
        reading: What the answer says.
        seconds: Wall-clock seconds that the answer took.
        ids: Ids of all objects in the prompt.
        beside: What was answered to the requests beside it, by variant.
    """

    at: int
    time: float
    reading: Reading
    seconds: float
    ids: tuple[str, ...]
    beside: Mapping[str, Mapping[str, str]] = NOTHING

    @property
    def outcome(self) -> str:
        """``answered``, or the class of the failure."""
        return self.reading.outcome

    def told(self) -> dict[str, Any]:
        """The decision as an account tells it."""
        said = self.reading.said
        names = {"intent": said["intent"], "maneuver": said["maneuver"]} if said else {}
        cited = list(said["threat_ids"]) if said else []
        perceived = list(self.ids)
        return {
            "outcome": self.outcome, "at": self.at, "perceived": perceived, "cited": cited, **names
        }  # fmt: skip

    def told_anew(self) -> dict[str, Any]:
        """The same where it was made anew, with what was answered beside it."""
        return {**self.told(), "beside": dict(self.beside)}


class LlmGenerator(Generator):
    """Asks a language model every few ticks, and holds what it decided in between.

    A domain's subclass says what the prompt is, how it is put into words, and what an answer's
    words mean. What a call comes to is never an exception: it is read strictly, and a failure of
    any class leads to the fallback policy, counts as a failed proposal and stands in the account.

    Args:
        **params: See :class:`pytest_dura.llm.planner.Settings`.
    """

    MANEUVERS: ClassVar[tuple[str, ...]]
    SCHEMA: ClassVar[Mapping[str, Any]]
    """Of an answer, with at least ``threat_ids``, ``reasoning``, ``intent`` and ``maneuver``."""
    NULL: ClassVar[Mapping[str, str]]
    """Intent and maneuver of the null component: always the same, whatever the prompt."""

    def __init__(self, **params: Any) -> None:
        self.settings = Settings.of(params, self.MANEUVERS)

    @classmethod
    def resolve_parameters(cls, params: Mapping[str, Any]) -> Mapping[str, Any]:
        """The parameters with the model, what its server can do, and a digest of the templates."""
        settings = Settings.of(params, cls.MANEUVERS)
        told: dict[str, Any] = {"prompts": cls.templates_digest(settings)}
        if settings.server is None:
            describe = session.current().describe(settings.model)
            keys = ("structured", "vision", "seed")
            server = {key: describe.capabilities[key] for key in keys}
            told |= {
                "model": describe.model,
                "server": {"fingerprint": describe.fingerprint, **server},
            }
        return {**params, **told}

    @classmethod
    @abstractmethod
    def templates_digest(cls, settings: Settings) -> str:
        """SHA-256 of all templates in use."""

    @abstractmethod
    def prompt(self, view: GeneratorView, past: Sequence[PastDecision]) -> Prompt:
        """What is put before the model.

        Args:
            view: What the component sees.
            past: Its latest decisions and what became of them, oldest first.
        """

    @abstractmethod
    def messages(self, prompt: Prompt) -> tuple[Message, ...]:
        """The prompt in words."""

    @abstractmethod
    def variant(self, name: str, prompt: Prompt) -> Prompt:
        """The prompt of a request beside the deciding one, other than ``again``."""

    @abstractmethod
    def command(self, maneuver: str) -> Any:
        """The action that carries a maneuver out."""

    def extrapolated(self, maneuver: str, view: GeneratorView, *, fresh: bool) -> Any:  # noqa: ARG002 - for those who override it
        """The action at this tick, where actions are extrapolated between two decisions.

        Asked at each tick at which a decision of the model is in force.

        Args:
            maneuver: What the model decided.
            view: What the component sees.
            fresh: Whether the decision comes into force at this tick.
        """
        return self.command(maneuver)

    def told(self, action: Any) -> Mapping[str, Any]:  # noqa: ARG002 - for those who override it
        """What an account tells of an extrapolated action, beside the maneuver that it serves."""
        return {}

    def time_limit(self, budget: float | None) -> float | None:
        """Enough for all requests of a tick, each within its own deadline, and a second more."""
        deadline = self.settings.deadline(budget)
        asked = self.settings.samples + len(self.settings.beside)
        return None if deadline is None else asked * deadline + 1.0

    def reset(self, context: RoleContext) -> None:
        """Begin an episode."""
        self._context = context
        self._deadline = self.settings.deadline(context.time_budget)
        self._session = session.current()
        self._made: list[Decision] = []
        self._since: list[float] = []
        self._anew: list[Decision] = []
        self._landing: tuple[float, Decision] | None = None
        self._next = 0
        self._asked = 0

    def propose(self, view: GeneratorView) -> Proposal:
        """The decision in force, made anew where one is due."""
        realtime = self.settings.clock == "realtime"
        fresh = self._land(view) if realtime else False
        again = bool(view.feedback) and not realtime
        if again or (view.index >= self._next and self._landing is None):
            decision = self._decide(view)
            self._next = view.index + self.settings.decide_every
            if realtime:
                self._landing = (view.time + decision.seconds, decision)
                fresh = self._land(view) or fresh
            else:
                self._enforce(decision, view)
                fresh = True
        return self._proposal(view, fresh=fresh)

    def _land(self, view: GeneratorView) -> bool:
        """Put a decision into force whose answer has come by now, in simulated time."""
        if self._landing is None or view.time < self._landing[0] - view.dt * 1e-6:
            return False
        self._enforce(self._landing[1], view)
        self._landing = None
        return True

    def _enforce(self, decision: Decision, view: GeneratorView) -> None:
        """From now on it is in force; at one tick several may follow each other."""
        self._made.append(decision)
        if self._since[-1:] != [view.time]:
            self._since.append(view.time)
            self._anew = []
        self._anew.append(decision)

    def _decide(self, view: GeneratorView) -> Decision:
        """Ask the model, and beside it what the settings say."""
        remembered = self._since[max(len(self._since) - self.settings.history, 0) :]
        past = [decision for decision in view.past if decision.time in remembered]
        prompt = view.transmit("prompt", self.prompt(view, past))
        delivery = view.transmit("model", Delivery())
        answer = self._ask(prompt, 0, delivery)
        beside = {}
        if self._asked % self.settings.beside_every == 0:
            beside = self._asked_beside(prompt)
        self._asked += 1
        reading = read_answer(answer, self.SCHEMA)
        return Decision(view.index, view.time, reading, answer.seconds, prompt.ids, beside)

    def _ask(self, prompt: Prompt, sample: int, delivery: Delivery) -> Answer:
        request = self.request(prompt, sample)
        server = self.settings.server
        fingerprint = None if server is None else server.fingerprint
        return self._session.ask(request, self._deadline, delivery, fingerprint=fingerprint)

    def request(self, prompt: Prompt, sample: int = 0) -> Request:
        """What is sent to the model for a prompt."""
        server = self.settings.known_server
        return Request(
            model=self.settings.model or "",
            messages=self.messages(prompt),
            schema=self.SCHEMA,
            structured=server.structured,
            temperature=self.settings.temperature,
            max_tokens=self.settings.max_tokens,
            seed=self._context.seed % 2**31 + sample if server.seed else None,
            sample=sample,
        )

    def _asked_beside(self, prompt: Prompt) -> dict[str, dict[str, str]]:
        """What is answered to the same request once more, and to variants of it, by name.

        A variant that is no other prompt, such as one without pictures where there are none, could
        show nothing and is left out.
        """
        found = {}
        for number, name in enumerate(self.settings.again, start=1):
            found[name] = self._said(self._ask(prompt, number, Delivery()))
        for name in self.settings.beside:
            variant = self.variant(name, prompt)
            if variant != prompt:
                found[name] = self._said(self._ask(variant, 0, Delivery()))
        return found

    def _said(self, answer: Answer) -> dict[str, str]:
        reading = read_answer(answer, self.SCHEMA)
        said = {key: reading.said[key] for key in ("intent", "maneuver") if reading.said}
        return {"outcome": reading.outcome, **said}

    def _proposal(self, view: GeneratorView, *, fresh: bool) -> Proposal:
        decision = self._made[-1] if self._made else None
        # Proposed once more at the same tick, it is still the decision that was made there.
        anew = self._since[-1:] == [view.time]
        account: dict[str, Any] = {"decided": anew}
        if decision is None:
            account |= {"outcome": _PENDING, "at": view.index, "age": 0.0, "fallback": True}
            return self._fallback(account, "no answer has come yet")
        account |= {"age": view.time - decision.time, **decision.told()}
        account["fallback"] = not decision.reading.answered
        if anew:
            null = {**account, **self.NULL, "outcome": "answered", "cited": [], "fallback": False}
            null["beside"] = {
                name: {"outcome": "answered", **self.NULL} for name in decision.beside
            }
            account |= {**decision.told_anew(), "seconds": decision.seconds, "null": null}
            replaced = [item.told_anew() for item in self._anew[:-1]]
            account |= {"replaced": replaced} if replaced else {}
        if not decision.reading.answered:
            why = f"{decision.outcome}: {decision.reading.detail}"
            return self._fallback(account, why)
        said = decision.reading.said
        if self.settings.between == "extrapolate":
            action = self.extrapolated(said["maneuver"], view, fresh=fresh)
            account |= self.told(action)
        else:
            action = self.command(said["maneuver"])
        return Proposal(action, said["reasoning"], account=account)

    def _fallback(self, account: Mapping[str, Any], why: str) -> Proposal:
        """What is proposed without a decision of the model's own."""
        policy, last = self.settings.fallback, None
        if policy == "last":
            last = next((item for item in reversed(self._made) if item.reading.answered), None)
            policy = "none" if last is None else last.reading.said["maneuver"]
        action = None if policy == "none" else self.command(policy)
        return Proposal(action, failure=why, account=account)
