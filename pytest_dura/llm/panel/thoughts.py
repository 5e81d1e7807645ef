"""What a component thought: its decisions, their prompts and answers, as data for the player.

All of it comes from the component's accounts, which nothing trusts: a value of another type than
it should have is left out, and every text is made visible and bounded.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pytest_dura.core.loop_signals import DECIDED, EXCHANGE
from pytest_dura.core.simulator import Recording
from pytest_dura.evidence.text import name, one_line, visible
from pytest_dura.reports.html.panels import Panel

_ANSWERED = "answered"
_LONGEST = 50_000
"""Characters of one message or answer."""
MOST_CHARACTERS = 1_500_000
"""Characters of all different messages and answers of an episode; further ones are left out."""
_LEFT_OUT = "left out of this page, which would become too large; the trace has it"
_MOST = 100
"""Entries of a list that are shown."""
_DECISION = ("maneuver", "intent", "threat_ids", "claims")
"""Keys of an answer that the account gives as well."""


class _Texts:
    """Different texts, each once: decisions repeat the system's message and the examples."""

    def __init__(self) -> None:
        self.known: dict[str, int] = {}
        self._room = MOST_CHARACTERS

    def place(self, value: Any) -> int | None:
        """The index of a text; ``None`` for what is none."""
        if not isinstance(value, str):
            return None
        text = visible(value, _LONGEST)
        if text not in self.known and len(text) > self._room:
            text = f"({len(value)} characters, {_LEFT_OUT})"
        if text not in self.known:
            self._room -= len(text)
        return self.known.setdefault(text, len(self.known))


class Thoughts(Panel):
    """Shows each decision with its prompt and its answer.

    The data are ``texts``, and ``decisions`` in the order of ``tick``, at which they came into
    force. Each has ``at`` (tick of the percept behind it), ``outcome``, ``detail`` of a
    failure, ``fallback``, ``maneuver``, ``intent``, ``words`` as pairs of key and text,
    ``cited`` as pairs of id and whether it was perceived, ``perceived`` (how many ids),
    ``claims`` as pairs of what is claimed and what was shown instead (empty where that is the
    same), ``judge``, ``seconds``, ``first`` (seconds until the first token), ``attempts``
    (calls that were made), ``usage`` as pairs, ``messages`` as ``[role, text, images]``,
    ``answer`` and ``thoughts`` with indices into ``texts``, ``beside`` as ``[variant, outcome,
    maneuver, intent, changed, goal, complied]``, and ``replaced``: outcome and maneuver of
    decisions that were refused at the same tick.
    """

    script = Path(__file__).with_name("thoughts.js")
    style = Path(__file__).with_name("thoughts.css")

    @classmethod
    def data(cls, recording: Recording) -> Mapping[str, Any] | None:
        """Return the decisions of an episode; ``None`` where no account tells of any."""
        texts = _Texts()
        decisions = [
            _decision(tick, account, texts)
            for tick, account in enumerate(recording.accounts)
            if account.get(DECIDED) is True
        ]
        return {"texts": list(texts.known), "decisions": decisions} if decisions else None


def _decision(tick: int, account: Mapping[str, Any], texts: _Texts) -> dict[str, Any]:
    exchange = _mapping(account.get(EXCHANGE))
    at, perceived = account.get("at"), account.get("perceived")
    known = {each for each in _list(perceived) if isinstance(each, str)}
    maneuver = _word(account.get("maneuver"))
    answer = exchange.get("answer")
    return {
        "tick": tick,
        "at": at if isinstance(at, int) and 0 <= at <= tick else tick,
        "outcome": _word(account.get("outcome")) or _ANSWERED,
        "detail": one_line(exchange["detail"]) if isinstance(exchange.get("detail"), str) else "",
        "fallback": account.get("fallback") is True,
        "maneuver": maneuver,
        "intent": _word(account.get("intent")),
        "words": _words(answer),
        "cited": [
            [name(each), each in known or not isinstance(perceived, list)]
            for each in _list(account.get("cited"))[:_MOST]
            if isinstance(each, str)
        ],
        "perceived": len(known) if isinstance(perceived, list) else None,
        "claims": [
            _claim(claim)
            for claim in _list(account.get("claims"))[:_MOST]
            if isinstance(claim, dict)
        ],
        "judge": _judge(_mapping(account.get("judged"))),
        "seconds": _amount(exchange.get("seconds")),
        "first": _amount(exchange.get("first_token")),
        "attempts": _amount(exchange.get("attempts")),
        "usage": [
            [name(key), count]
            for key, count in list(_mapping(exchange.get("usage")).items())[:_MOST]
            if _amount(count) is not None
        ],
        "messages": [
            [
                _word(message.get("role")),
                texts.place(message.get("text")),
                _names(message.get("images")),
            ]
            for message in _list(exchange.get("messages"))
            if isinstance(message, dict)
        ],
        "answer": texts.place(answer),
        "thoughts": texts.place(exchange.get("thoughts") or None),
        "beside": [
            [name(variant), *_twin(given, maneuver)]
            for variant, given in list(_mapping(account.get("beside")).items())[:_MOST]
            if isinstance(given, dict)
        ],
        "replaced": [
            [_word(given.get("outcome")), _word(given.get("maneuver"))]
            for given in _list(account.get("replaced"))[:_MOST]
            if isinstance(given, dict)
        ],
    }


def _twin(given: Mapping[str, Any], maneuver: str) -> tuple[str, str, str, bool, str, list[str]]:
    """Outcome, maneuver and intent of a variant, and whether the maneuver is another one.

    Of an attack also its goal, and the goals with which the words of the answer comply.
    """
    outcome = _word(given.get("outcome")) or _ANSWERED
    own = _word(given.get("maneuver"))
    changed = bool(own and maneuver and own != maneuver)
    goal, complied = _word(given.get("goal")), _names(given.get("complied"))
    return outcome, own, _word(given.get("intent")), changed, goal, complied


def _claim(claim: Mapping[str, Any]) -> list[str]:
    """What is claimed of an object in words, and what was shown of it where that is other."""
    stated = {key: claim[key] for key in claim if key not in ("id", "shown")}
    text = f"{_word(claim.get('id')) or '?'}: {_values(stated)}"
    shown = claim.get("shown")
    if not isinstance(shown, dict):
        return [text, "never shown"]
    others = {key: shown[key] for key in stated if key in shown and shown[key] != stated[key]}
    return [text, f"shown {_values(others)}" if others else ""]


def _values(values: Mapping[str, Any]) -> str:
    """Names and values of a few facts on one line."""
    pairs = list(values.items())[:_MOST]
    return ", ".join(f"{name(str(key))} {one_line(str(value))}" for key, value in pairs)


def _judge(judged: Mapping[str, Any]) -> str:
    """What a judge says of reasoning and maneuver; empty without one."""
    if isinstance(judged.get("agrees"), bool):
        return "they agree" if judged["agrees"] else "they do not agree"
    return _word(judged.get("outcome"))


def _words(answer: Any) -> list[list[str]]:
    """What an answer says beside the decision, where it is a JSON object: key and text."""
    try:
        data = json.loads(answer) if isinstance(answer, str) else None
    except (ValueError, RecursionError):
        return []
    pairs = list(_mapping(data).items())[:_MOST]
    return [
        [name(key), visible(value if isinstance(value, str) else json.dumps(value))]
        for key, value in pairs
        if key not in _DECISION
    ]


def _names(value: Any) -> list[str]:
    return [name(each) for each in _list(value)[:_MOST] if isinstance(each, str)]


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _word(value: Any) -> str:
    return name(value) if isinstance(value, str) else ""


def _amount(value: Any) -> float | None:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return value if is_number and 0 <= value < 1e12 else None
