"""Count of the requests that a session makes of language models at most, for ``--dura-list``.

One decision of each case is simulated with a stand-in for the server, which shows how many requests
a decision makes; no server is asked.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from pytest_dura.core.classes import is_subclass
from pytest_dura.core.errors import describe_error
from pytest_dura.evidence.text import counted
from pytest_dura.guests import ListedCase
from pytest_dura.llm.stated import stated_model

if TYPE_CHECKING:
    from pytest_dura.llm.port import Answer, Repeats, Request
    from pytest_dura.llm.session import Mode

_MODULES = frozenset({"pytest_dura.llm.planner", "pytest_dura.llm.session"})


@dataclass
class _StandIn:
    """Stand-in for a server: answers nothing, and keeps what it is asked."""

    model: str
    base_url: str = "http://127.0.0.1/v1"
    asked: list[Request] = field(default_factory=list)

    def ask(self, request: Request, budget: float, repeats: Repeats | None = None) -> Answer:  # noqa: ARG002 - it is not a server
        from pytest_dura.llm.port import Answer

        self.asked.append(request)
        return Answer(failure="empty")

    def probe(self) -> tuple[str, Mapping[str, Any]]:
        return "0" * 64, {"structured": "none", "vision": False, "seed": False}

    def scrub(self, text: str) -> str:
        return text


@dataclass(frozen=True)
class _CaseCount:
    """Requests of a case.

    Args:
        episodes: Its episodes, those of pairs and fault-free twins included.
        requests: Of the longest episode.
    """

    episodes: int
    requests: int


def request_lines(cases: Iterable[ListedCase], mode: Mode) -> Iterator[str]:
    """Lines on the requests of the planned cases to language models; none where no case asks.

    Args:
        cases: Those of the session's plan.
        mode: Who answers.
    """
    counts: list[_CaseCount] = []
    reasons: dict[str, None] = {}
    unknown = 0
    for case in cases:
        try:
            count = _count(case)
        except Exception as error:  # whatever user code raises; a list is shown all the same
            reasons[describe_error(error)] = None
            continue
        if isinstance(count, bool):
            unknown += case.episodes if count else 0
        else:
            counts.append(count)
    if counts:
        episodes = sum(each.episodes for each in counts)
        requests = sum(each.episodes * each.requests for each in counts)
        yield (
            f"language model: at most {counted(requests, 'request')} in "
            f"{counted(episodes, 'episode')}, pairs and twins included, if each episode lasts its "
            "whole time"
        )
        if mode == "record":
            yield "    what the cassette has by now is not asked again"
        elif mode == "replay":
            yield "    a replay asks no server"
    if unknown:
        yield f"{counted(unknown, 'episode')} ask a language model; how often is not known"
    for reason in reasons:
        yield f"warning: requests to language models cannot be counted: {reason}"


def _count(case: ListedCase) -> _CaseCount | bool:
    """Count the requests of a case; of others, whether its component asks a language model."""
    target = case.component()
    if _MODULES.isdisjoint(sys.modules):  # a session that asks has imported one of them
        return False
    from pytest_dura.llm.planner import LlmGenerator
    from pytest_dura.llm.session import ModelSession, using
    from pytest_dura.llm.settings import Settings

    with using(ModelSession(environ={}, connect=lambda *_: _StandIn("model"))):
        task = case.task()
    generator = task.spec.roles["generator"]
    if not is_subclass(target, LlmGenerator):
        return stated_model(generator) is not None
    settings = Settings.of(generator.params, target.MANEUVERS)
    end = task.spec.termination
    ticks = end.last_index(task.spec.time_step)
    if end.iterations is not None:
        ticks = min(ticks, end.iterations)
    decisions = math.ceil(ticks / settings.decide_every)
    server = _StandIn(settings.model or "model")
    with using(ModelSession(environ={}, connect=lambda *_: server)):
        spec = replace(task.spec, termination=replace(end, iterations=1))
        replace(task, spec=spec, recorded=False).run()
    if not server.asked:
        raise ValueError(f"{task.spec.case}: the component asked nothing at its first tick")
    beside = math.ceil(decisions / settings.beside_every) * (len(server.asked) - 1)
    return _CaseCount(case.episodes, decisions + beside)
