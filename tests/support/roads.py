"""Driving in tests: worlds, percepts and episodes made by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pytest_dura import Episode, EpisodeSpec, Orchestrator, Policy, Proposal, RoleSpec, Termination
from pytest_dura.core import GeneratorView, Percept, RoleView, StateManager, Tick
from pytest_dura.domains import DOMAINS
from pytest_dura.driving import (
    Body,
    BodyList,
    Command,
    EgoState,
    HighwaySimulator,
    Maneuver,
    route,
    route_map,
    signs,
)
from pytest_dura.driving.sensors import channels
from pytest_dura.faults import parse_fault

SCENARIOS = Path(__file__).parents[2] / "scenarios"

SIX = (
    "intersection/nominal",
    "intersection/congested",
    "intersection/conflicting-traffic",
    "intersection/ghost-obstacle",
    "intersection/trajectory-spoofing",
    "intersection/pedestrian-crossing",
)


def hold(_: Tick) -> Command:
    """Keep the speed."""
    return Command(Maneuver.PROCEED, 0.0)


def always(maneuver: str, acceleration: float | None = None) -> Callable[[Tick], Command]:
    """The same command at every tick."""
    command = Command(Maneuver(maneuver), acceleration)
    return lambda _: command


def begin(
    world: Mapping[str, Any], *, seed: int = 1, dt: float = 0.1, duration: float = 30.0
) -> tuple[HighwaySimulator, list[Tick]]:
    """A simulator at its first tick."""
    simulator = HighwaySimulator()
    simulator.set_time_step(dt)
    return simulator, [simulator.reset({"world": world, "duration": duration}, seed)]


def drive(
    world: Mapping[str, Any],
    ticks: int,
    act: Callable[[Tick], Any] = hold,
    **options: Any,
) -> tuple[HighwaySimulator, list[Tick]]:
    """A simulator driven for some ticks, or until the episode is critical."""
    simulator, seen = begin(world, **options)
    for _ in range(ticks):
        if seen[-1].critical is not None:
            break
        seen.append(simulator.step(simulator.check_action(act(seen[-1]))))
    return simulator, seen


def bodies_at(tick: Tick) -> BodyList:
    """The true bodies."""
    bodies: BodyList = tick.truth["bodies"]
    return bodies


def events_of(ticks: Sequence[Tick], kind: str) -> list[tuple[int, str, str]]:
    """Tick, subject and detail of the events of a kind."""
    return [
        (tick.index, subject, detail)
        for tick in ticks
        for found, subject, detail in tick.events
        if found == kind
    ]


def car(
    name: str, x: float, y: float, heading: float = 0.0, speed: float = 0.0, **size: float
) -> Body:
    """A car that moves along its heading."""
    vx, vy = speed * np.cos(heading), speed * np.sin(heading)
    return Body(
        name, x, y, heading, float(vx), float(vy), size.get("length", 5.0), size.get("width", 2.0)
    )


def car_on(origin: int, turn: str, s: float, speed: float = 0.0, name: str = "V1") -> Body:
    """A car on a route."""
    x, y, heading = (float(value) for value in route(origin, turn).pose(s))
    return car(name, x, y, heading, speed)


def walker(name: str, x: float, y: float, vx: float = 0.0, vy: float = 0.0) -> Body:
    """A pedestrian."""
    heading = float(np.arctan2(vy, vx))
    return Body(name, x, y, heading, vx, vy, 0.6, 0.6)


def channels_of(
    *bodies: Body,
    s: float = 50.0,
    speed: float = 8.0,
    turn: str = "straight",
    acceleration: float = 0.0,
    radar: Sequence[Body] | None = None,
) -> dict[str, Any]:
    """The channels of an ego from the south at ``s`` of its route.

    ``radar`` gives the bodies that radar sees, if not those of lidar.
    """
    way = route(0, turn)
    x, y, heading = (float(value) for value in way.pose(s))
    ego = EgoState(x, y, heading, speed, acceleration, acceleration, 0.0, s, 0.0)

    def made(seen: Sequence[Body]) -> dict[str, Any]:
        return channels(ego, BodyList.of(seen), route_map(way), signs(way), _no_camera)

    found = made(bodies)
    if radar is not None:
        found["radar"] = made(radar)["radar"]
    return found


def _no_camera(view: str) -> Any:
    raise AssertionError(f"nobody should look at the {view} camera")


class Views:
    """Views of percepts made by hand, tick by tick."""

    def __init__(self, dt: float = 0.1) -> None:
        self.state = StateManager(dt)

    def see(self, percept: Mapping[str, Any]) -> None:
        """The next tick; what was proposed at the one before has been carried out."""
        if self.state.proposal is not None:
            self.state.command = self.state.proposal.action
        index = len(self.state.ticks)
        time = index * self.state.dt
        self.state.update(Tick(index, time, {}, percept), Percept(percept))

    def generator(self, percept: Mapping[str, Any]) -> GeneratorView:
        """The Generator's view of the next tick."""
        self.see(percept)
        return self.state.generator_view()

    def role(self, percept: Mapping[str, Any], action: Any = None, **proposal: Any) -> RoleView:
        """Another role's view of the next tick, with this proposal."""
        self.see(percept)
        return self.again(action, **proposal)

    def again(self, action: Any = None, **proposal: Any) -> RoleView:
        """The same tick with another proposal."""
        given = None if action is None else Proposal(Command.of(action), **proposal)
        self.state.proposal = given
        return self.state.role_view()


def spec_of_drive(
    world: Mapping[str, Any],
    *,
    generator: str | RoleSpec = "aggressive",
    faults: Sequence[Mapping[str, Any]] = (),
    seed: int = 5,
    duration: float = 15.0,
    policy: str = "log_only",
    case: str = "intersection/test",
    roles: Mapping[str, RoleSpec | None] | None = None,
    **fields: Any,
) -> EpisodeSpec:
    """The spec of an episode with the domain's own roles."""
    domain = DOMAINS["driving"]
    chosen: dict[str, RoleSpec | None] = {
        n: RoleSpec(path) for n, path in domain.default_roles.items()
    }
    if isinstance(generator, str):
        generator = RoleSpec(domain.short_names["generator"].get(generator, generator))
    chosen["generator"] = generator
    chosen.update(roles or {})
    return EpisodeSpec(
        case=case,
        run=0,
        seed=seed,
        simulator=RoleSpec(domain.simulator),
        roles={name: role for name, role in chosen.items() if role is not None},
        scenario={"name": case, "duration": duration, "world": dict(world)},
        faults=tuple(parse_fault(fault) for fault in faults),
        policy=Policy.parse(policy),
        termination=Termination(duration),
        **fields,
    )


def run(spec: EpisodeSpec) -> Episode:
    """One episode of fresh parts."""
    return Orchestrator.build(spec).run(spec)


def truth_of(episode: Episode) -> dict[str, bytes]:
    """Every ground-truth signal, bit by bit."""
    return {
        name: column.tobytes()
        for name, column in episode.signals.items()
        if not name.startswith("percept.")
    }
