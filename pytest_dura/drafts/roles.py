"""Python roles that a language model drafts: what it is given, and the file that a person reads."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping, Sized
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

import pytest_dura
from pytest_dura.core.component import plain_copy
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.percepts import Percept
from pytest_dura.core.roles import STANDARD_ROLES, Assessed, Assessment, Recovery, RoleContext
from pytest_dura.core.simulator_process import simulating
from pytest_dura.core.state import Alert, GeneratorView, PastDecision, Proposal, RoleView
from pytest_dura.core.text import one_line
from pytest_dura.drafts.asking import Conversation, object_schema
from pytest_dura.drafts.earning import Suite
from pytest_dura.drafts.role_checks import MODULES, Basis, fields_of, first_of, read_role
from pytest_dura.drafts.rounds import Judged, Outcome, outcomes_of
from pytest_dura.library.domain_reference import declared

ROLES = ("generator", "recovery_planner", "safety_monitor")
"""Roles that can be drafted."""
_LINES, _WIDTH = 150, 110
_SCENARIOS = 8
"""Scenarios whose first percept is looked at."""
SCHEMA = object_schema({
    "reason": {"type": "string", "maxLength": 600},
    "lines": {
        "type": "array", "maxItems": _LINES, "items": {"type": "string", "maxLength": _WIDTH},
    },
})  # fmt: skip
"""Of an answer: lines, since servers bound texts, and no server one of a whole file."""
NOT_REVIEWED = "Drafted, not reviewed: nothing imports this file; a person does, who has read it."

_SYSTEM = """\
You write one Python class for tests of a cyber-physical system, from the sentence of a person:
a {base}. {about}
It is checked, and then a person reads it and decides whether it is used:
- one class, a subclass of {base} alone, with {method}(self, view). It may have __init__, whose
  parameters each have a default, reset(self, context), which forgets the run before, and
  methods of its own; constants are numbers and texts
- no decorators, no functions outside of the class, no try, while, with, raise or assert
- imports by name, and none but these:
  import math
{imports}
- plain ASCII, at most {lines} lines of {width} characters

{method} is given {view}
and returns {output}
The percept has these channels, as in view.percept["{channel}"]:
{channels}
An action is one as {action} is. Further:
{used}

An example of the form alone:
{example}
Answer with one JSON object {{"reason": "why it is as it is", "lines": ["each line of the file"]}},
and nothing else.
"""
_EXAMPLES = {
    "generator": '''\
from pytest_dura import Generator, GeneratorView, Proposal{imports}


class Idle(Generator):
    """Leaves the plant to itself."""

    def propose(self, view: GeneratorView) -> Proposal:
        return Proposal({action}, "does nothing")
''',
    "recovery_planner": '''\
from pytest_dura import Recovery, RecoveryPlanner, RoleView{imports}


class Idle(RecoveryPlanner):
    """Leaves the plant to itself."""

    def run(self, view: RoleView) -> Recovery:
        return Recovery({action}, "idle", "; ".join(view.reasons))
''',
    "safety_monitor": '''\
from pytest_dura import Assessed, Assessment, RoleView, SafetyMonitor


class Settling(SafetyMonitor):
    """Refuses what is proposed before some time has passed."""

    def __init__(self, seconds: float = 1.0):
        self.seconds = seconds

    def run(self, view: RoleView) -> Assessment:
        margin = view.time - self.seconds
        if margin < 0:
            return Assessment(Assessed.UNSAFE, margin, (f"{{-margin:.1f}} s too early",))
        return Assessment(Assessed.SAFE, margin)
''',
}


def sampled(suite: Suite) -> tuple[Percept, Any]:
    """Take the first percept of scenarios, and an action: what a draft will be given.

    Raises:
        ConfigurationError: If no simulator of the suite can be asked here.
    """
    channels: dict[str, Any] = {}
    aliases: dict[str, str] = {}
    action = None
    for case in suite.cases[:_SCENARIOS]:
        spec = suite.runner.task(case).spec
        factory = spec.simulator.factory()
        if getattr(factory, "instances", "many") == "one":  # such as a test rig
            continue
        with simulating(factory):
            world = spec.simulator.create()
            try:
                world.set_time_step(spec.time_step)
                tick = world.reset(plain_copy(spec.scenario), spec.seed)
                percept = Percept(tick.channels, aliases=world.channel_aliases)
                seen = {name: percept[name] for name in percept}
                action = world.fallback_action()
            finally:
                world.close()
        aliases |= percept.aliases
        for name, value in seen.items():
            if name not in channels or (isinstance(value, Sized) and len(value)):
                channels[name] = value
    if not channels:
        raise ConfigurationError(
            "no percept is known, from which a role could be drafted",
            key="--scenario",
            found=f"{len(suite.cases)} scenarios",
            expected="one whose simulator exists more than once",
            remedy="name another one",
        )
    return Percept(channels, aliases=aliases), action


def basis_of(role: str, percept: Percept, action: Any) -> Basis:
    """Gather what a draft of a role rests on."""
    base = STANDARD_ROLES[role]
    view: Any = RoleView(0, 0.0, 0.1, percept, (percept,), Proposal(action), {}, command=action)
    output: type = Recovery
    others: tuple[type, ...] = (Proposal, Alert)
    if role == "generator":
        past = (PastDecision(0.0, action, "", action, "proposal"),)
        view, output, others = GeneratorView(0, 0.0, 0.1, percept, past=past), Proposal, ()
    elif role == "safety_monitor":
        output, others = Assessment, (Assessed, Proposal, Alert)
    parts = [action, *(getattr(action, name) for name in fields_of(action))]
    own = [type(each) for each in parts if type(each).__module__ not in ("builtins", "numpy")]
    kinds = (base, type(view), output, *others, RoleContext, *own)
    classes = {kind.__name__: kind for kind in kinds}
    method = "propose" if role == "generator" else "run"
    return Basis(base, method, output, view, classes)


def asked_for(role: str, suite: Suite) -> tuple[Basis, dict[str, Any]]:
    """Return what a draft of a role rests on, and what a model is asked for.

    Raises:
        ConfigurationError: If no simulator of the suite can be asked for a percept.
    """
    percept, action = sampled(suite)
    basis = basis_of(role, percept, action)
    tables = {table.title: table.rows for table in declared(suite.domain)}
    about = {name: [each for each in row if each] for name, *row in tables.get("channels", ())}
    channels = "\n".join(
        f"- {name}: {'; '.join([shape(percept[name]), *about.get(name, ())])}" for name in percept
    )
    actions = [" ".join(filter(None, row)) for row in tables.get("actions", ())]
    places: dict[str, list[str]] = {}
    for name, kind in basis.classes.items():
        ours = name in pytest_dura.__all__
        places.setdefault("pytest_dura" if ours else kind.__module__, []).append(name)
    listed = {name: names for name, names in MODULES.items() if name != "math"} | places
    imports = [f"  from {place} import {', '.join(names)}" for place, names in listed.items()]
    own = "".join(
        f"\nfrom {place} import {', '.join(sorted(names))}"
        for place, names in places.items()
        if place != "pytest_dura"
    )
    example = _EXAMPLES[role].format(imports=own, action=written(action))
    about_base = (inspect.getdoc(basis.base) or "").partition("\n")[0]
    listed_apart = {basis.base, type(basis.view), basis.output, RoleContext}
    used = [described(each) for each in basis.classes.values() if each not in listed_apart]
    system = _SYSTEM.format(
        base=basis.base.__name__, about=about_base, method=basis.method,
        view=described(type(basis.view)), output=described(basis.output), channels=channels,
        imports="\n".join(imports), lines=_LINES, width=_WIDTH, channel=next(iter(percept)),
        action=written(action), example=example,
        used="\n".join(f"- {each}" for each in [*used, *actions]),
    )  # fmt: skip
    return basis, {"system": system, "schema": SCHEMA}


def described(kind: type) -> str:
    """Write what a class holds, and what it says of itself, on one line."""
    if issubclass(kind, Enum):
        return f"{kind.__name__}: {', '.join(kind.__members__)}"
    if is_dataclass(kind):
        held = [f"{each.name}: {each.type}" for each in fields(kind)]
    else:
        held = [*getattr(kind, "_fields", ())]
    about = " ".join((inspect.getdoc(kind) or "").split())
    return f"{kind.__name__}({', '.join(held)}): {about}"


def shape(value: Any, depth: int = 3) -> str:
    """Write what a value of a percept is made of."""
    if isinstance(value, np.ndarray):
        return f"array of shape {value.shape}"
    kind, names = type(value).__name__, fields_of(value) if depth else ()
    parts = [(name, getattr(value, name)) for name in names]
    if parts:
        held = [
            name if isinstance(part, (int, float, str)) else f"{name}: {shape(part, depth - 1)}"
            for name, part in parts
        ]
        return f"{kind}({', '.join(held)})"
    first = first_of(value)
    return kind if first is None or not depth else f"{kind} of {shape(first, depth - 1)}"


def written(value: Any) -> str:
    """Write an action as code."""
    if isinstance(value, Enum):
        return f"{type(value).__name__}.{value.name}"
    if isinstance(value, np.ndarray):
        return repr(value.tolist())
    names = fields_of(value)
    held = ", ".join(f"{name}={written(getattr(value, name))}" for name in names)
    return f"{type(value).__name__}({held})" if names else repr(value)


@dataclass
class RoleDrafting:
    """Rounds of a conversation on a role.

    Args:
        conversation: With the model, on one sentence.
        rounds: Times that the model is asked, at most.
        role: The role.
        basis: What the draft rests on.
    """

    conversation: Conversation
    rounds: int
    role: str
    basis: Basis
    passed: list[tuple[str, str]] = field(default_factory=list, init=False)
    """Of the draft that passed the digest of its prompt, and its code."""

    def outcomes(self) -> Iterator[Outcome]:
        """Yield what became of the draft of each round."""
        return outcomes_of(self.conversation, self.rounds, self._judged)

    def _judged(self, content: Mapping[str, Any], digest: str) -> Judged:
        name, code, problems = read_role(content["lines"], self.basis)
        if not problems:
            self.passed.append((digest, code))
        yield name, not problems, "; ".join(problems) or "checked, and neither imported nor run"

    def text(self) -> str:
        """Text of the file: whose draft it is in lines of comment, then the code."""
        (digest, code), talk = self.passed[0], self.conversation
        model = talk.described
        # Python reads an encoding in the first two lines alone: these two name none.
        head = [
            NOT_REVIEWED,
            "A language model wrote what stands below these lines. It was parsed, and never run.",
            f"Role: {self.role} of {talk.domain.name}",
            f"Sentence: {one_line(talk.sentence, 500)}",
            f"Model: {one_line(model.model)}, server {one_line(model.fingerprint)}",
            f"Prompt: sha256:{digest}",
        ]
        return "".join(f"# {line}\n" for line in head) + "\n" + code
