"""Short ways to run one episode in a test, of parts made in the test itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from thermostat import Thermostat

from pytest_dura import (
    Episode,
    EpisodeSpec,
    Generator,
    Orchestrator,
    Policy,
    Proposal,
    Role,
    RoleSpec,
    Simulator,
    Termination,
)
from pytest_dura.core import GeneratorView


class Says(Generator):
    """A component whose answer is a function of its view."""

    def __init__(self, answer: Callable[[GeneratorView], Any]) -> None:
        self.answer = answer
        self.views: list[GeneratorView] = []

    def propose(self, view: GeneratorView) -> Proposal:
        self.views.append(view)
        return self.answer(view)


class Does(Role):
    """A role, of any base when mixed in, whose output is a function of its view."""

    def __init__(self, output: Callable[[Any], Any]) -> None:
        self.output = output
        self.seen: list[int] = []

    def run(self, view: Any) -> Any:
        self.seen.append(view.index)
        return self.output(view)


def doing(base: type[Role], output: Callable[[Any], Any], **declared: Any) -> Any:
    """A role of that base with that output, and class attributes such as ``after``."""
    return type(f"Doing{base.__name__}", (Does, base), declared)(output)


def spec_of(
    roles: Mapping[str, Any], *, seconds: float = 1.0, policy: str = "recover", **fields: Any
) -> EpisodeSpec:
    """A spec of opaque parts."""
    termination = fields.pop("termination", Termination(seconds))
    return EpisodeSpec(
        case="room/test",
        run=0,
        seed=fields.pop("seed", 3),
        simulator=fields.pop("simulator", RoleSpec.of(Thermostat)),
        roles={name: RoleSpec.of(role) for name, role in roles.items()},
        policy=Policy.parse(policy),
        termination=termination,
        **fields,
    )


def run_loop(
    generator: Any,
    *,
    simulator: Simulator | None = None,
    judge: Any = None,
    metrics: Mapping[str, Any] | None = None,
    seconds: float = 1.0,
    policy: str = "recover",
    spec: Mapping[str, Any] | None = None,
    recorded: bool = False,
    **roles: Any,
) -> Episode:
    """One episode of role instances; ``spec`` holds further fields of the EpisodeSpec."""
    if callable(generator) and not isinstance(generator, Role):
        generator = Says(generator)
    parts = {"generator": generator, **roles}
    episode_spec = spec_of(parts, seconds=seconds, policy=policy, **(spec or {}))
    loop = Orchestrator(simulator or Thermostat(), parts, judge, metrics or {}, recorded=recorded)
    return loop.run(episode_spec)
