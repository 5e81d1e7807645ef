"""The optional parts of a simulator adapter: whether those that it has are sound.

Each raises ``NotImplementedError`` for a part that the adapter does not have.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from pytest_dura.core.comparing import first_difference, leaves
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.scene_checks import scene_problems, value_problems
from pytest_dura.core.simulator_runs import PURE, CheckedEpisode, EpisodeRuns, over
from pytest_dura.core.state import Lazy, Percept


def check_lazy(runs: EpisodeRuns) -> None:
    """A lazy value read later must be what it would have been, or refuse to be read."""
    at_once, later = runs.fresh(), runs.fresh()
    prompt = at_once.reset(runs.scenario, runs.seeds[0]).channels
    lazy = later.reset(runs.scenario, runs.seeds[0]).channels
    names = [name for name, value in prompt.items() if isinstance(value, Lazy)]
    if not names:
        raise NotImplementedError
    now = {name: leaves(prompt[name].get()) for name in names}
    for action in runs.actions[:3]:
        if over(later.step(later.check_action(action))):
            break
    for name in names:
        try:
            value = leaves(lazy[name].get())
        except ConfigurationError:
            continue
        if first_difference(now[name], value) is not None:
            runs.findings.breach(
                f"lazy channel {name!r} shows another instant if it is read after a step",
                "raise ConfigurationError when it is read too late, or keep what it needs",
            )


def check_time_step(runs: EpisodeRuns) -> None:
    """Another time step is kept to or refused, and what is none is refused."""
    for wrong in (0.0, -0.1, float("nan"), float("inf")):
        simulator = runs.fresh()
        try:
            simulator.set_time_step(wrong)
        except ConfigurationError:
            continue
        runs.findings.breach(
            f"set_time_step({wrong}) is accepted",
            "raise ConfigurationError for what is not a positive number",
        )
    simulator = runs.fresh()
    half = simulator.time_step / 2
    try:
        simulator.set_time_step(half)
    except ConfigurationError:
        runs.findings.not_supported.append(f"a time step of {half:g} s")
        return
    trace = runs.episode(simulator, runs.seeds[0])
    if len(trace.ticks) > 1 and abs(trace.ticks[1].time - half) > 1e-9:
        runs.findings.breach(
            f"after set_time_step({half:g}) the first tick is at {trace.ticks[1].time:g} s",
            "advance by self.time_step, or refuse a step that you cannot take",
        )


def check_snapshot(runs: EpisodeRuns, reference: CheckedEpisode) -> None:
    """A snapshot leads twice to the same rest of the episode."""
    simulator = runs.fresh()
    simulator.reset(runs.scenario, runs.seeds[0])
    middle = (len(reference.ticks) - 1) // 2
    for action in runs.actions[:middle]:
        simulator.step(simulator.check_action(action))
    with suppress(NotImplementedError):
        simulator.render()  # a renderer must not stand in the way
    snapshot = simulator.snapshot()
    rest = runs.actions[middle : len(reference.ticks) - 1]
    for attempt in ("the run on from", "the first return to", "the second return to"):
        expected = reference.copies[middle + 1 :]
        for action, copy in zip(rest, expected, strict=True):
            tick = simulator.step(simulator.check_action(action))
            if (path := first_difference(copy, leaves(tick))) is not None:
                runs.findings.breach(
                    f"{attempt} a snapshot differs at tick {tick.index} in {path}",
                    "snapshot all state, random generators included, and restore copies of it",
                )
                return
        simulator.restore(snapshot)


def check_render(runs: EpisodeRuns, reference: CheckedEpisode) -> None:
    """It gives a picture, and moves nothing on."""
    simulator = runs.fresh()
    simulator.reset(runs.scenario, runs.seeds[0])
    picture = simulator.render()
    if not (
        isinstance(picture, np.ndarray)
        and picture.dtype == np.uint8
        and picture.ndim == 3
        and picture.shape[2] == 3
    ):
        found = f"{getattr(picture, 'dtype', type(picture).__name__)} {np.shape(picture)}"
        runs.findings.breach(
            f"render gives {found}", "return a uint8 array of shape (height, width, 3)"
        )
    elif not picture.any():
        runs.findings.breach(
            "the rendered picture is all black", "render without SDL_VIDEODRIVER=dummy"
        )
    runs.compare(reference, runs.episode(runs.fresh(), runs.seeds[0], at=0), "with rendering")


def check_scene(runs: EpisodeRuns, reference: CheckedEpisode) -> None:
    """What it shows of an episode, and of one that ended at once; and what that leaves behind."""
    one, other = runs.fresh(), runs.fresh()
    shown = []
    for simulator in (one, other):
        ticks = runs.episode(simulator, runs.seeds[0]).ticks
        before = leaves(ticks)
        scene = simulator.scene(ticks, [Percept(tick.channels) for tick in ticks])
        shown.append(leaves(scene))
        if scene is None:
            continue
        if (path := first_difference(before, leaves(ticks))) is not None:
            runs.findings.breach(f"scene changed ticks{path}", "read the ticks, and copy them")
        problems = list(scene_problems(scene, len(ticks))) or value_problems(scene)
        for problem in problems:
            runs.findings.breach(*problem)
    if shown[0] == shown[1] == leaves(None):
        raise NotImplementedError
    if (path := first_difference(*shown)) is not None:
        runs.findings.breach(f"another instance has another scene, in {path}", PURE)
    runs.compare(reference, runs.episode(one, runs.seeds[0]), "an instance, after scene")
    first = other.reset(runs.scenario, runs.seeds[0])
    scene = other.scene([first], [Percept(first.channels)])
    for problem in scene_problems(scene, 1) if scene is not None else ():
        runs.findings.breach(*problem)
