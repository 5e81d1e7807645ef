"""Asking a language model for requirements: prompt, schema of the answer, and what was refused."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import ComponentEnvironmentError, ConfigurationError
from pytest_dura.core.loop_signals import PROPOSAL_PREFIX, TRUTH
from pytest_dura.domains import Domain
from pytest_dura.llm.answers import Reading, read_answer
from pytest_dura.llm.port import Message, Request
from pytest_dura.llm.servers import ModelDescription
from pytest_dura.llm.session import ModelSession
from pytest_dura.requirements.model import KINDS, Requirement

MOST = 6
"""Drafts in one answer."""
_BOUNDS = 6
_MOST_TOKENS = 2000
BUDGET = 300.0
"""Seconds for an answer."""


def object_schema(properties: Mapping[str, Any]) -> dict[str, Any]:
    """Schema of an object that has these properties and no others."""
    return {
        "type": "object",
        "properties": dict(properties),
        "required": list(properties),
        "additionalProperties": False,
    }


def _text(most: int) -> dict[str, Any]:
    return {"type": "string", "maxLength": most}


SCHEMA: Mapping[str, Any] = object_schema({
    "requirements": {
        "type": "array",
        "maxItems": MOST,
        "items": object_schema({
            "reason": _text(600),
            "id": _text(40),
            "text": _text(300),
            "kind": {"type": "string", "enum": list(KINDS)},
            "bounds": {
                "type": "array",
                "maxItems": _BOUNDS,
                "items": object_schema({
                    "signal": _text(80), "value": {"type": "number"}, "unit": _text(20),
                }),
            },
            "check": _text(400),
        }),
    },
})  # fmt: skip
"""Of an answer; the reason stands before the check that it leads to."""

_SYSTEM = """\
You write requirements for tests of a cyber-physical system. From the sentence of a person
you write requirements that a program decides on recorded runs. Each has:
- reason: why the bound is what it is, and what the sentence leaves open
- id: letters, digits and hyphens, such as {example}
- text: what is required, in one sentence
- kind: one of {kinds}
- bounds: each number that the check compares a signal with, with the unit of that signal
- check: a formula of signal temporal logic

A formula compares signals with numbers (>, >=, <, <=, ==, !=), has + - * / abs(...), joins
by and, or, not, implies, and ranges over time by always, eventually and `a until b`, each
with a window of seconds if need be, as in `always[0, 2] (...)`. What holds throughout is
`always (...)`, what holds under a condition `always (condition implies ...)`. A signal whose
unit is {truth} is 0 or 1. A formula reads these signals and no others:
{signals}

Answer with one JSON object {{"requirements": [...]}} of at most {most} requirements, and
nothing else.
"""


@dataclass(frozen=True)
class Bound:
    """A number that a draft says its check compares a signal with."""

    signal: str
    value: float
    unit: str


@dataclass(frozen=True)
class Draft:
    """A requirement as a model wrote it.

    Args:
        requirement: The requirement; its source is empty.
        bounds: The numbers that it compares signals with, as stated.
    """

    requirement: Requirement
    bounds: tuple[Bound, ...] = ()

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Draft:
        """Make it of an entry of an answer."""
        names = ("id", "text", "kind", "check", "reason")
        given: dict[str, Any] = {name: " ".join(str(data[name]).split()) for name in names}
        bounds = (Bound(each["signal"], each["value"], each["unit"]) for each in data["bounds"])
        return cls(Requirement(**given), tuple(bounds))


@dataclass
class Conversation:
    """What a model is asked for a sentence, round by round.

    Args:
        session: Through which it is asked.
        domain: Whose signals drafts may read.
        sentence: What is required, in a person's words.
        seconds: Limit of an answer.
        about: What goes on from the description of drafts; empty for requirements.
        system: What is asked for, in place of requirements; empty for these.
        schema: Of the answer.
    """

    session: ModelSession
    domain: Domain
    sentence: str
    seconds: float = BUDGET
    about: str = ""
    system: str = ""
    schema: Mapping[str, Any] = field(default_factory=lambda: SCHEMA)
    described: ModelDescription = field(init=False)
    messages: tuple[Message, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Probe the server, and begin the conversation."""
        self.described = self.session.describe()
        system = self.system or _SYSTEM.format(
            kinds=", ".join(KINDS), signals=signal_lines(self.domain), most=MOST, truth=TRUTH,
            example="GAP-1",
        )  # fmt: skip
        self.messages = (Message("system", system + self.about), Message("user", self.sentence))

    @property
    def prompt_digest(self) -> str:
        """SHA-256 of the messages that were sent last."""
        texts = [[message.role, message.text] for message in self.messages]
        return hashlib.sha256(canonical(texts)).hexdigest()

    def ask(self) -> tuple[Reading, str]:
        """Ask for drafts; returns what was read, and the text of the answer.

        Raises:
            ConfigurationError: If there can be no answer, such as one that a cassette lacks.
        """
        can = self.described.capabilities
        request = Request(
            model=self.described.model,
            messages=self.messages,
            schema=self.schema,
            structured=can.get("structured", "none"),
            temperature=0.0 if can.get("temperature", True) else None,
            max_tokens=_MOST_TOKENS,
            seed=0 if can.get("seed") else None,
            tokens=can.get("tokens", "max_tokens"),
            extra=can.get("extra_body", {}),
        )
        try:
            answer = self.session.ask(request, self.seconds, fingerprint=self.described.fingerprint)
        except ComponentEnvironmentError as error:
            raise ConfigurationError(
                f"the model gives no draft: {error}",
                key="--dura-llm",
                remedy="ask its server again with --dura-llm=record",
            ) from None
        return read_answer(answer, self.schema), answer.text

    def send_back(self, answer: str, refused: Sequence[str]) -> None:
        """Add to the conversation what was refused, and why."""
        listed = "\n".join(f"- {each}" for each in refused)
        self.messages += (
            Message("assistant", answer or "(no text)"),
            Message(
                "user",
                f"These were refused:\n{listed}\nAnswer again, with better ones for these alone.",
            ),
        )


def signal_lines(domain: Domain) -> str:
    """List the signals that a draft may read, with unit and meaning."""
    declared = (
        ("", domain.signals),
        ("percept.", domain.percept_signals),
        (PROPOSAL_PREFIX, domain.proposal_signals),
    )
    return "\n".join(
        f"- {prefix}{signal.name} [{signal.unit}] {signal.meaning}".rstrip()
        for prefix, signals in declared
        for signal in signals or ()
    )
