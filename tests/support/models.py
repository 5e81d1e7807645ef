"""Language models of a test: what they answer is a function of the request."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from pytest_dura.core import RoleSpec, Termination
from pytest_dura.execution import run_episode
from pytest_dura.library import case_with_faults, load_library
from pytest_dura.llm import Answer, Request, session

PLANNER = "pytest_dura.llm.driving.planner:LlmPlanner"
ALONE = {"samples": 1, "beside": ()}
"""Parameters of a planner that asks nothing beside the deciding requests."""
CAPABILITIES = {"structured": "json_schema", "enforced": True, "vision": False, "seed": True}


def said(maneuver="proceed", intent="hold", ids=(), **changes):
    """The text of a good answer."""
    answer = {
        "observations": "what there is",
        "threat_ids": list(ids),
        "reasoning": "because",
        "intent": intent,
        "maneuver": maneuver,
        "confidence": 50,
    }
    return json.dumps(answer | changes)


class Model:
    """A server in this process; ``answers`` maps the request and its number to text or Answer."""

    model, base_url = "scripted", "http://127.0.0.1:1/v1"

    def __init__(self, answers: Callable[[Request, int], Any], **capabilities: Any) -> None:
        self.answers, self.capabilities = answers, CAPABILITIES | capabilities
        self.requests: list[Request] = []
        self.budgets: list[float] = []

    def ask(self, request: Request, budget: float, repeats: Any = None) -> Answer:
        self.requests.append(request)
        self.budgets.append(budget)
        answer = self.answers(request, len(self.requests) - 1)
        return answer if isinstance(answer, Answer) else Answer(answer, seconds=0.2)

    def probe(self) -> tuple[str, Mapping[str, Any]]:
        return "f00d", self.capabilities

    def scrub(self, text: str) -> str:
        return text


@contextmanager
def answering(answers, **capabilities):
    """Context in which this model answers; gives the model."""
    model = answers if isinstance(answers, Model) else Model(answers, **capabilities)
    with session.using(session.ModelSession(environ={}, connect=lambda *_: model)):
        yield model


_LIBRARY: list[Any] = []


def llm_episode(
    answers, params=None, *, case="intersection/nominal", faults=(), seconds=3.0, run=0, **fields
):
    """An episode of the planner with a model of the test; gives episode and model."""
    if not _LIBRARY:
        _LIBRARY.append(load_library(()))
    scenario = _LIBRARY[0].scenarios[case]
    with answering(answers) as model:
        generator = RoleSpec(PLANNER, ALONE | (params or {}))
        spec = case_with_faults(scenario, list(faults) or "none").spec(
            run, 0, {"generator": generator}
        )
        spec = replace(spec, termination=Termination(seconds), **fields)
        return run_episode(spec, recorded=True), model
