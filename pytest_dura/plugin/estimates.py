"""Estimate of what a session will ask of language models, for ``--dura-list``: no server is asked.

One decision of each case is simulated with a stand-in for the server, which shows how many requests
a decision makes and how long its prompts are. All figures are upper bounds but those of tokens.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

from pytest_dura.core.classes import is_subclass
from pytest_dura.core.errors import describe_error
from pytest_dura.evidence.text import counted
from pytest_dura.execution.task import EpisodeTask, stated_model
from pytest_dura.plugin.context import Planned
from pytest_dura.plugin.options import Options
from pytest_dura.requirements.model import FAULTS

if TYPE_CHECKING:
    from pytest_dura.library.cases import Case
    from pytest_dura.llm.port import Answer, Request
    from pytest_dura.llm.settings import Settings
    from pytest_dura.plugin.session import DuraSession

_MODULES = frozenset({"pytest_dura.llm.planner", "pytest_dura.llm.session"})
_MOST_EXCHANGES = 2000
"""Exchanges of a cassette that are looked at."""


@dataclass
class _StandIn:
    """Stand-in for a server: answers nothing, and keeps what it is asked."""

    model: str
    base_url: str = "http://127.0.0.1/v1"
    asked: list[Request] = field(default_factory=list)

    def ask(self, request: Request, budget: float) -> Answer:  # noqa: ARG002 - it is no server
        from pytest_dura.llm.port import Answer

        self.asked.append(request)
        return Answer(failure="empty")

    def probe(self) -> tuple[str, Mapping[str, Any]]:
        return "0" * 64, {"structured": "none", "vision": False, "seed": False}

    def scrub(self, text: str) -> str:
        return text


@dataclass(frozen=True)
class _CaseEstimate:
    """What a case will ask.

    Args:
        episodes: Its episodes, those of pairs and fault-free twins included.
        requests: Of the longest episode.
        prompt: Mean tokens of a request.
        answer: Mean tokens of an answer, as long as the examples in the prompt.
    """

    episodes: int
    requests: int
    prompt: float
    answer: float


def estimate_lines(session: DuraSession) -> Iterator[str]:
    """Lines on what the planned cases will ask of language models; none where no case asks.

    Args:
        session: The session, whose plan is made.
    """
    estimates: list[_CaseEstimate] = []
    reasons: dict[str, None] = {}
    unknown = 0
    for planned in session.plan:
        case = planned.case
        runs = session.options.runs or case.scenario.planned
        episodes = runs * _arms(session, planned)
        try:
            estimate = _estimate(session, case, episodes)
        except Exception as error:  # whatever user code raises; a list is shown all the same
            reasons[describe_error(error)] = None
        else:
            estimates += [] if isinstance(estimate, bool) else [estimate]
            unknown += episodes if estimate is True else 0
    if estimates:
        yield from _lines(session, estimates)
    if unknown:
        yield f"{counted(unknown, 'episode')} ask a language model; how often cannot be estimated"
    for reason in reasons:
        yield f"warning: no estimate of what is asked of language models: {reason}"


def _arms(session: DuraSession, planned: Planned) -> int:
    """How many episodes each run of a case makes: its own, its twins', and those of pairs."""
    known = session.library().requirements
    pairs = (known[name].paired for name in planned.requirements)
    without = {pair.without for pair in pairs if pair is not None}
    if planned.case.faults and session.options.twins:
        without.add(FAULTS)
    return 1 + len(without)


def _estimate(session: DuraSession, case: Case, episodes: int) -> _CaseEstimate | bool:
    """Estimate a case; of others, whether its component says that it asks a language model."""
    target = case.roles(session.runner.roles)["generator"].resolve()
    if _MODULES.isdisjoint(sys.modules):  # whoever asks has imported one of them
        return False
    from pytest_dura.llm.planner import LlmGenerator
    from pytest_dura.llm.session import using
    from pytest_dura.llm.settings import Settings

    with using(_session(_StandIn("model"))):
        task = session.runner.task(case)
    generator = task.spec.roles["generator"]
    if not is_subclass(target, LlmGenerator):
        return stated_model(generator) is not None
    return _estimated(task, Settings.of(generator.params, target.MANEUVERS), episodes)


def _session(server: _StandIn) -> Any:
    from pytest_dura.llm.session import ModelSession

    return ModelSession(environ={}, connect=lambda *_: server)


def _estimated(task: EpisodeTask, settings: Settings, episodes: int) -> _CaseEstimate:
    from pytest_dura.llm.session import using
    from pytest_dura.llm.spending import estimate_tokens

    end = task.spec.termination
    ticks = end.last_index(task.spec.time_step)
    if end.iterations is not None:
        ticks = min(ticks, end.iterations)
    decisions = math.ceil(ticks / settings.decide_every)
    server = _StandIn(settings.model or "model")
    with using(_session(server)):
        spec = replace(task.spec, termination=replace(end, iterations=1))
        replace(task, spec=spec, recorded=False).run()
    if not server.asked:
        raise ValueError(f"{task.spec.case}: the component asked nothing at its first tick")
    beside = math.ceil(decisions / settings.beside_every) * (len(server.asked) - 1)
    prompts = [
        estimate_tokens(*(message.text for message in request.messages)) for request in server.asked
    ]
    examples = [
        estimate_tokens(message.text)
        for message in server.asked[0].messages
        if message.role == "assistant"
    ]
    answer = fmean(examples) if examples else float(settings.max_tokens)
    return _CaseEstimate(episodes, decisions + beside, fmean(prompts), answer)


def _lines(session: DuraSession, estimates: Sequence[_CaseEstimate]) -> Iterator[str]:
    from pytest_dura.llm.spending import Tokens

    options = session.options
    episodes = sum(each.episodes for each in estimates)
    requests = sum(each.episodes * each.requests for each in estimates)
    prompt = sum(each.episodes * each.requests * each.prompt for each in estimates)
    answer = sum(each.episodes * each.requests * each.answer for each in estimates)
    basis = "the first prompt of each case at four characters a token, answers as its examples"
    recorded = _recorded_tokens(session)
    if recorded is not None:
        prompt, answer = requests * recorded[0], requests * recorded[1]
        basis = f"the tokens of {counted(recorded[2], 'answer')} in {recorded[3].name}"
    yield (
        f"language model: at most {requests} requests in {counted(episodes, 'episode')}, "
        f"pairs and twins included; about {prompt:.2g} + {answer:.2g} tokens (prompts + answers)"
    )
    if options.llm_price is not None:
        yield f"    about {options.llm_price.text(Tokens(round(prompt), round(answer)))}"
    yield f"    it rests on the longest episodes, and on {basis}"
    if options.llm == "record":
        yield "    what the cassette has by now is not asked again"
    elif options.llm == "replay":
        yield "    a replay asks no server"


def _recorded_tokens(session: DuraSession) -> tuple[float, float, int, Path] | None:
    """Mean tokens of prompts and answers in the cassette, of how many answers, and its file."""
    config = session.config
    file = session.options.cassette or config.rootpath / str(Options.cassette.default)
    if not file.is_file():
        return None
    from pytest_dura.llm.cassette import Cassette
    from pytest_dura.llm.spending import Tokens

    cassette = Cassette(file, writable=False)
    try:
        answers = [each.answer for each in islice(cassette.exchanges(), _MOST_EXCHANGES)]
    finally:
        cassette.close()
    tokens = [Tokens.of(answer.usage, answered=True) for answer in answers]
    known = [each for each in tokens if not each.uncounted]
    if not known:
        return None
    prompt, answer = (
        fmean(getattr(each, name) for each in known) for name in ("prompt", "completion")
    )
    return prompt, answer, len(known), file
