"""LlmGenerator: a language model as the component under test in any domain, and its settings."""

from __future__ import annotations

import json
import re
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

from pytest_dura.core.loop_signals import EXCHANGE
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.roles import Generator, RoleContext
from pytest_dura.core.state import GeneratorView, PastDecision, Proposal
from pytest_dura.llm import session
from pytest_dura.llm.answers import Reading, read_answer
from pytest_dura.llm.judge import SCHEMA as JUDGE_SCHEMA
from pytest_dura.llm.judge import judge_request, judgement
from pytest_dura.llm.port import Answer, Delivery, Message, Repeats, Request
from pytest_dura.llm.prompts import Prompt
from pytest_dura.llm.settings import KnownServer, Settings
from pytest_dura.llm.usage import usage_of

_PENDING = "pending"
"""Outcome of a decision that has not landed yet."""
_DIRECT = Delivery()
"""How a request reaches its model where no fault acts."""


@dataclass(frozen=True)
class Decision:
    """Decision of the model, or its failure to make one.

    Args:
        at: Index of the tick whose percept it rests on.
        time: Simulated seconds of that tick.
        reading: Of the answer.
        seconds: Wall-clock seconds that the answer took.
        ids: Ids of all objects in the prompt.
        beside: Readings of the answers to the requests beside it, by variant.
        exchange: Request and answer in words, see :func:`exchange_data`.
        claims: What it claims of objects, each with what the prompt shows of it; ``None`` where
            there is no answer.
        copied: Whether it repeats the answer to another prompt, see :class:`Earlier`.
        judged: Answer of the judge, where it was asked.
        usage: Requests and tokens of the decision and of what was asked beside it.
    """

    at: int
    time: float
    reading: Reading
    seconds: float
    ids: tuple[str, ...]
    beside: Mapping[str, Mapping[str, Any]] = NOTHING
    exchange: Mapping[str, Any] = NOTHING
    claims: Sequence[Mapping[str, Any]] | None = None
    judged: Mapping[str, Any] = NOTHING
    usage: Mapping[str, int] = NOTHING
    copied: bool = False

    @property
    def outcome(self) -> str:
        """``answered``, or the class of the failure."""
        return self.reading.outcome

    def account(self, *, fresh: bool) -> dict[str, Any]:
        """Entries of an account: at the tick where the decision is fresh, with its details."""
        content = self.reading.content
        return {
            "outcome": self.outcome,
            "at": self.at,
            "perceived": list(self.ids),
            "cited": list(content["threat_ids"]) if content else [],
            **({key: content[key] for key in ("intent", "maneuver")} if content else {}),
            **(self.details() if fresh else {}),
        }

    def details(self) -> dict[str, Any]:
        """Entries of an account at the tick where the decision is fresh, and at no other."""
        return {
            "beside": dict(self.beside),
            **({} if self.claims is None else {"claims": [dict(each) for each in self.claims]}),
            **({"judged": dict(self.judged)} if self.judged else {}),
            **({"copied": True} if self.copied else {}),
        }


_NAMES_AND_NUMBERS = re.compile(r"[A-Za-z]*\d+(?:\.\d+)?")
_WORDING = ("observations", "reasoning", "threat_ids", "claims")
"""Entries of an answer that say what the decision rests on."""


@dataclass(frozen=True)
class Earlier:
    """An answer to another prompt, that of an example or an earlier one of its own.

    A decision copies it if it gives the same grounds to the letter, whose objects are all in the
    other prompt, and an object or a number of these is not in its own prompt. Equal words for what
    is equal in both situations are no copy.

    Args:
        content: Of the answer.
        prompt: Text of the other prompt, without earlier decisions.
    """

    content: Mapping[str, Any]
    prompt: str

    def copied_by(self, content: Mapping[str, Any], prompt: str) -> bool:
        """Whether the answer to a prompt copies it."""
        if any(content.get(name) != self.content.get(name) for name in _WORDING):
            return False
        grounds = json.dumps([content.get(name) for name in _WORDING])
        named = set(_NAMES_AND_NUMBERS.findall(grounds))
        there, here = (set(_NAMES_AND_NUMBERS.findall(text)) for text in (self.prompt, prompt))
        objects = {name for name in named if name[0].isalpha()}
        return objects <= there and bool(named & (there - here))


def _as_asked(account: Mapping[str, Any]) -> dict[str, Any]:
    """Entries of a variant's account that tell what was asked; nothing was complied with."""
    asked = {key: account[key] for key in ("goal",) if key in account}
    return {**asked, "complied": []} if "complied" in account else asked


class LlmGenerator(Generator):
    """Generator that calls a language model every few ticks, and holds its decision in between.

    A domain's subclass defines the prompt, how it is put into words, and the meaning of an answer's
    terms. No call raises: answers are read strictly, and a failure of any class leads to the
    fallback policy, counts as a failed proposal and stands in the account.

    Args:
        **params: See :class:`pytest_dura.llm.settings.Settings`.
    """

    MANEUVERS: ClassVar[tuple[str, ...]]
    SCHEMA: ClassVar[Mapping[str, Any]]
    """Of an answer, with at least ``threat_ids``, ``reasoning``, ``intent`` and ``maneuver``."""
    NULL: ClassVar[Mapping[str, str]]
    """Intent and maneuver of the null component: always the same, whatever the prompt."""
    ATTACKS: ClassVar[int] = 1
    """Number of the attackers' texts that the domain has."""
    PAST: ClassVar[str] = "HISTORY"
    """Name of the prompt's block on earlier decisions."""

    def __init__(self, **params: Any) -> None:
        self.settings = Settings.of(params, self.MANEUVERS)

    @classmethod
    def resolve_parameters(cls, params: Mapping[str, Any]) -> Mapping[str, Any]:
        """The parameters with the model, properties of its server, and the templates' digest."""
        settings = Settings.of(params, cls.MANEUVERS)
        resolved: dict[str, Any] = {"prompts": cls.templates_digest(settings)}
        if settings.server is None:
            description = session.current().describe(settings.model)
            resolved |= {
                "model": description.model,
                "server": KnownServer.stated(description.fingerprint, description.capabilities),
            }
        if isinstance(settings.judge, str) and settings.judge_server is None:
            judge = session.current().describe(settings.judge)
            resolved["judge_server"] = KnownServer.stated(judge.fingerprint, judge.capabilities)
        return {**params, **resolved}

    @classmethod
    @abstractmethod
    def templates_digest(cls, settings: Settings) -> str:
        """SHA-256 of all templates in use."""

    @abstractmethod
    def prompt(self, view: GeneratorView, past: Sequence[PastDecision]) -> Prompt:
        """The prompt of a tick.

        Args:
            view: What the component sees.
            past: Its latest decisions and their outcomes, oldest first.
        """

    @abstractmethod
    def messages(self, prompt: Prompt) -> tuple[Message, ...]:
        """The prompt in words."""

    @abstractmethod
    def variant(self, name: str, prompt: Prompt) -> Prompt:
        """The prompt of a request beside the deciding one, other than ``again``."""

    def account_beside(self, name: str, prompt: Prompt, reading: Reading) -> Mapping[str, Any]:  # noqa: ARG002 - for overrides
        """Further entries of an account on the answer to a variant.

        Args:
            name: Of the variant.
            prompt: Of the variant.
            reading: Of the answer.
        """
        return {}

    @property
    def _asked_beside(self) -> int:
        """Number of earlier decisions of the episode with requests beside them."""
        return self._prompts // self.settings.beside_every

    def shown(self, prompt: Prompt) -> Mapping[str, Mapping[str, Any]]:
        """What a prompt shows of each object, by id, under the names that claims have."""
        return dict.fromkeys(prompt.ids, NOTHING)

    def answer_schema(self) -> Mapping[str, Any]:
        """The JSON schema that is sent with a request: of what its prompt asks for."""
        return self.SCHEMA

    def meaning(self, maneuver: str) -> str:  # noqa: ARG002 - for those who override it
        """What a maneuver does, in words for the judge; it has its name in any case."""
        return ""

    @abstractmethod
    def command(self, maneuver: str) -> Any:
        """The action that carries a maneuver out."""

    def extrapolated(self, maneuver: str, view: GeneratorView, *, fresh: bool) -> Any:  # noqa: ARG002 - for those who override it
        """The action at this tick, where actions are extrapolated between two decisions.

        Called at each tick at which a decision of the model is in force.

        Args:
            maneuver: Of the decision.
            view: What the component sees.
            fresh: Whether the decision comes into force at this tick.
        """
        return self.command(maneuver)

    def action_account(self, action: Any) -> Mapping[str, Any]:  # noqa: ARG002 - for overrides
        """Entries of an account on an extrapolated action, beside its maneuver."""
        return {}

    def time_limit(self, budget: float | None) -> float | None:
        """Enough for all requests of a tick, each within its own deadline, and a second more."""
        deadline = self.settings.deadline(budget)
        if deadline is None:
            return None
        requests = self.settings.samples + len(self.settings.variants(self.ATTACKS))
        requests += bool(self.settings.judge)
        repeats = Repeats(session.current().retries, self.settings.count_retries)
        return requests * repeats.time_for(deadline) + 1.0

    def reset(self, context: RoleContext) -> None:
        """Begin an episode."""
        self._context = context
        self._deadline = self.settings.deadline(context.time_budget)
        self._session = session.current()
        self._decisions: list[Decision] = []
        self._decision_times: list[float] = []
        """Times at which a decision came into force, each once."""
        self._latest: list[Decision] = []
        """Decisions that came into force at the last of these times."""
        self._pending: tuple[float, Decision] | None = None
        self._earlier: list[Earlier] = []
        self._next = 0
        self._prompts = 0

    def propose(self, view: GeneratorView) -> Proposal:
        """The decision in force, made anew where one is due."""
        realtime = self.settings.clock == "realtime"
        fresh = self._land(view) if realtime else False
        refused = bool(view.feedback) and not realtime
        if refused or (view.index >= self._next and self._pending is None):
            decision = self._decide(view)
            self._next = view.index + self.settings.decide_every
            if realtime:
                self._pending = (view.time + decision.seconds, decision)
                fresh = self._land(view) or fresh
            else:
                self._enforce(decision, view)
                fresh = True
        return self._proposal(view, fresh=fresh)

    def _land(self, view: GeneratorView) -> bool:
        """Put a decision into force whose answer has come by now, in simulated time."""
        if self._pending is None or view.time < self._pending[0] - view.dt * 1e-6:
            return False
        self._enforce(self._pending[1], view)
        self._pending = None
        return True

    def _enforce(self, decision: Decision, view: GeneratorView) -> None:
        """Put a decision into force; at one tick several may follow each other."""
        self._decisions.append(decision)
        if self._decision_times[-1:] != [view.time]:
            self._decision_times.append(view.time)
            self._latest = []
        self._latest.append(decision)

    def _decide(self, view: GeneratorView) -> Decision:
        """Make the deciding request, and the requests beside it that the settings demand."""
        times = self._decision_times
        remembered = times[max(len(times) - self.settings.history, 0) :]
        past = [decision for decision in view.past if decision.time in remembered]
        prompt = view.transmit("prompt", self.prompt(view, past))
        delivery = view.transmit("model", Delivery())
        request = self.request(prompt)
        answer = self._ask(request, self._fingerprint, delivery)
        self._answers = [answer]
        reading = read_answer(answer, self.SCHEMA)
        copied = self._is_copied(reading, prompt)
        beside: dict[str, dict[str, str]] = {}
        judged: dict[str, Any] = {}
        if self._prompts % self.settings.beside_every == 0:
            beside = self._answers_beside(prompt)
            judged = self._judgement(reading)
        self._prompts += 1
        exchange = exchange_data(request, answer, self._session.scrub_text)
        claims = None
        if reading.answered:
            shown = self.shown(prompt)
            claims = [
                {**claim, **({"shown": dict(shown[claim["id"]])} if claim["id"] in shown else {})}
                for claim in reading.content.get("claims", ())
            ]
            self._earlier.append(Earlier(reading.content, self._situation(prompt)))
        return Decision(
            view.index, view.time, reading, answer.seconds, prompt.ids,
            beside, exchange, claims, judged, usage_of(self._answers), copied,
        )  # fmt: skip

    def _situation(self, prompt: Prompt) -> str:
        """The prompt's own texts, without examples and without earlier decisions."""
        blocks = tuple(block for block in prompt.blocks if block.name != self.PAST)
        messages = self.messages(replace(prompt, blocks=blocks))
        return f"{messages[0].text}\n{messages[-1].text}"

    def _is_copied(self, reading: Reading, prompt: Prompt) -> bool:
        """Whether an answer repeats an example's, or an earlier one of its own."""
        if not reading.answered:
            return False
        situation = self._situation(prompt)
        examples = [
            Earlier(json.loads(answered.text), asked.text)
            for asked, answered in pairwise(self.messages(prompt))
            if answered.role == "assistant"
        ]
        known = [*examples, *self._earlier]
        return any(each.copied_by(reading.content, situation) for each in known)

    def _judgement(self, reading: Reading) -> dict[str, Any]:
        """Ask the judge, where there is one, whether the reasoning leads to the maneuver."""
        if not self.settings.judge or not reading.answered:
            return {}
        named = isinstance(self.settings.judge, str)
        known = self.settings.judge_server if named else self.settings.server
        server = known or KnownServer()
        maneuver = reading.content["maneuver"]
        request = judge_request(
            str(self.settings.judge) if named else self.settings.model or "",
            reading.content["reasoning"],
            maneuver,
            self.meaning(maneuver),
            structured=server.structured,
            temperature=0.0 if server.temperature else None,
            seed=self._context.seed % 2**31 if server.seed else None,
            tokens=server.tokens,
            extra=server.extra_body,
        )
        fingerprint = None if known is None else known.fingerprint
        answer = self._ask(request, fingerprint)
        self._answers.append(answer)
        return judgement(read_answer(answer, JUDGE_SCHEMA))

    def _ask(
        self, request: Request, fingerprint: str | None, delivery: Delivery = _DIRECT
    ) -> Answer:
        return self._session.ask(
            request,
            self._deadline,
            delivery,
            fingerprint=fingerprint,
            count_retries=self.settings.count_retries,
        )

    @property
    def _fingerprint(self) -> str | None:
        server = self.settings.server
        return None if server is None else server.fingerprint

    def request(self, prompt: Prompt, sample: int = 0) -> Request:
        """The request for a prompt."""
        server, settings = self.settings.known_server, self.settings
        return Request(
            model=settings.model or "",
            messages=self.messages(prompt),
            schema=self.answer_schema(),
            structured=server.structured,
            temperature=settings.temperature
            if server.temperature
            else settings.temperature or None,
            max_tokens=settings.max_tokens,
            seed=self._context.seed % 2**31 + sample if server.seed else None,
            sample=sample,
            tokens=settings.max_tokens_field or server.tokens,
            extra={**server.extra_body, **settings.extra_body},
            stream=settings.stream,
        )

    def _answers_beside(self, prompt: Prompt) -> dict[str, dict[str, Any]]:
        """Answers to further samples of a request, and to variants of it, by name.

        A variant that equals the prompt, such as one without pictures where there are none, could
        show nothing and is left out.
        """
        requests = {
            name: self.request(prompt, number)
            for number, name in enumerate(self.settings.further_samples, start=1)
        }
        variants = {}
        for name in self.settings.variants(self.ATTACKS):
            variant = self.variant(name, prompt)
            if variant != prompt:
                variants[name], requests[name] = variant, self.request(variant)
        answers = self._session.ask_all(
            list(requests.values()),
            self._deadline,
            fingerprint=self._fingerprint,
            count_retries=self.settings.count_retries,
        )
        self._answers += answers
        beside = {}
        for name, answer in zip(requests, answers, strict=True):
            reading = read_answer(answer, self.SCHEMA)
            decided = {
                key: reading.content[key] for key in ("intent", "maneuver") if reading.content
            }
            beside[name] = {"outcome": reading.outcome, **decided}
            if self._is_copied(reading, variants.get(name, prompt)):
                beside[name]["copied"] = True
            if name in variants:
                beside[name] |= self.account_beside(name, variants[name], reading)
        return beside

    def _proposal(self, view: GeneratorView, *, fresh: bool) -> Proposal:
        decision = self._decisions[-1] if self._decisions else None
        # Proposed once more at the same tick, it is still the decision that was made there.
        decided = self._decision_times[-1:] == [view.time]
        account: dict[str, Any] = {"decided": decided}
        if decision is None:
            account |= {"outcome": _PENDING, "at": view.index, "age": 0.0, "fallback": True}
            return self._fallback(account, "no answer has come yet")
        account |= {"age": view.time - decision.time, **decision.account(fresh=False)}
        account["fallback"] = not decision.reading.answered
        if decided:
            null = {**account, **self.NULL, "outcome": "answered", "cited": [], "fallback": False}
            null["beside"] = {
                name: {**_as_asked(each), "outcome": "answered", **self.NULL}
                for name, each in decision.beside.items()
            }
            account |= {**decision.details(), "seconds": decision.seconds, "null": null}
            usage = sum((Counter(each.usage) for each in self._latest), Counter())
            account["usage"] = {name: usage[name] for name in decision.usage}
            account[EXCHANGE] = decision.exchange
            replaced = [earlier.account(fresh=True) for earlier in self._latest[:-1]]
            account |= {"replaced": replaced} if replaced else {}
        if not decision.reading.answered:
            return self._fallback(account, f"{decision.outcome}: {decision.reading.detail}")
        content = decision.reading.content
        if self.settings.between == "extrapolate":
            action = self.extrapolated(content["maneuver"], view, fresh=fresh)
            account |= self.action_account(action)
        else:
            action = self.command(content["maneuver"])
        return Proposal(action, content["reasoning"], account=account)

    def _fallback(self, account: Mapping[str, Any], failure: str) -> Proposal:
        """The proposal without a decision of the model's own."""
        policy, last = self.settings.fallback, None
        if policy == "last":
            answered = (each for each in reversed(self._decisions) if each.reading.answered)
            last = next(answered, None)
            policy = "none" if last is None else last.reading.content["maneuver"]
        action = None if policy == "none" else self.command(policy)
        return Proposal(action, failure=failure, account=account)


_ROOM_OF_ANSWER, _ROOM_OF_THOUGHTS, _ROOM_OF_MESSAGES = 10_000, 10_000, 40_000
"""Characters of JSON; an account that is longer than ``loop_signals.LONGEST`` is none."""


def exchange_data(
    request: Request, answer: Answer, scrub: Callable[[str], str] = str
) -> dict[str, Any]:
    """Request and answer in words, as plain data of bounded size for an account.

    Texts that do not fit are shortened and say so, the earliest messages first; of pictures there
    is the name.

    Args:
        request: The deciding request.
        answer: To it.
        scrub: Takes secrets out of a text.
    """
    room = _ROOM_OF_MESSAGES
    messages: list[dict[str, Any]] = []
    for message in reversed(request.messages):
        text = _fitted(scrub(message.text), room)
        room -= len(json.dumps(text))
        images = [image.name for image in message.images]
        messages.insert(0, {"role": message.role, "text": text, "images": images})
    return {
        "messages": messages,
        "answer": _fitted(answer.text, _ROOM_OF_ANSWER),
        "detail": answer.detail,
        "finish": answer.finish,
        "usage": dict(answer.usage),
        "seconds": answer.seconds,
        "attempts": answer.attempts,
        **({"thoughts": _fitted(answer.thoughts, _ROOM_OF_THOUGHTS)} if answer.thoughts else {}),
        **({} if answer.first_token is None else {"first_token": answer.first_token}),
    }


def _fitted(text: str, room: int) -> str:
    """As much of a text as fits into so many characters of JSON."""
    if len(json.dumps(text)) <= room:
        return text
    note = f"... ({len(text)} characters)"
    room -= len(note)
    kept = text[: max(room, 0)]
    while kept and (size := len(json.dumps(kept))) > room:
        kept = kept[: min(len(kept) * room // size, len(kept) - 1)]
    return kept + note
