"""Episodes that end early, held against whole ones: no verdict on any of them is another one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
from formulas import can_fail, formulas, nodes
from hypothesis import given, settings
from hypothesis import strategies as st
from loops import doing, run_loop
from thermostat import Bias

from pytest_dura import (
    Assessed,
    Assessment,
    ConfigurationError,
    Episode,
    Fault,
    Proposal,
    Recovery,
    RecoveryPlanner,
    SafetyMonitor,
    Simulator,
    Termination,
    Tick,
    stream,
)
from pytest_dura.core import GeneratorView
from pytest_dura.requirements import (
    Boolean,
    EpisodeVerdict,
    Formula,
    Requirement,
    RequirementJudge,
    Temporal,
    judge_campaign,
    judge_episode,
    node_text,
    read_formula,
)
from pytest_dura.requirements import checks as judging

NAMES = ("a", "b")
STEPS = (0.1, 0.05, 0.3, 0.25, 1 / 15, 1 / 3)
RUNS = 2


class Walk(Simulator):
    """Two numbers from -3 to 3: ``a`` goes where the action says, ``b`` wherever it likes."""

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Both near the middle."""
        self._world, self._stream = scenario["world"], stream(seed, "walk")
        self._index, self._a, self._b = 0, 0.0, float(self._stream.integers(-2, 3))
        return self._tick()

    def step(self, action: Any) -> Tick:
        """Go on."""
        self._index += 1
        self._a = float(np.clip(self._a + action, -3, 3))
        self._b = float(np.clip(self._b + self._stream.integers(-1, 2), -3, 3))
        return self._tick()

    def _tick(self) -> Tick:
        return Tick(
            self._index,
            self._index * self.time_step,
            {"a": self._a, "b": self._b},
            {"a": self._a, "b": self._b},
            goal=self._a == self._world["goal"],
            critical="fell" if self._b == self._world["edge"] else None,
        )

    def signals(self, ticks: Sequence[Tick]) -> dict[str, Any]:
        """Both."""
        return {name: np.array([one.truth[name] for one in ticks]) for name in NAMES}

    def percept_signals(self, percepts: Sequence[Any]) -> dict[str, Any]:
        """As perceived."""
        return {"a": np.array([float(one["a"]) for one in percepts])}

    def fallback_action(self) -> float:
        """To stay."""
        return 0.0


def asked_for(step: float) -> st.SearchStrategy[str]:
    """Formulas, of which many are decided by a prefix."""
    small = nodes(NAMES, time_step=step, max_leaves=2, max_window=4)
    implied = st.builds(lambda one, other: Boolean("implies", one, other), small, small)
    throughout = st.builds(
        lambda one, kind, many: Temporal(kind, one, None) if many else one,
        implied,
        st.sampled_from(["always", "eventually"]),
        st.booleans(),
    )
    simple = nodes(NAMES, time_step=step, max_leaves=1)
    ranged = st.builds(
        lambda one, kind: Temporal(kind, one, None),
        simple,
        st.sampled_from(["always", "eventually"]),
    )
    found = st.one_of(throughout, ranged, ranged).map(lambda root: Formula(root, node_text(root)))
    wide = formulas(NAMES, time_step=step, max_window=8)
    return st.one_of(found, wide).map(str).map(ranging).filter(can_fail)


def ranging(text: str) -> str:
    """The formula as a check may be: what stands under no operator is put at the beginning."""
    try:
        return str(read_formula(text))
    except ConfigurationError:
        return f"always[0:0] ({text})"


@st.composite
def situations(draw: st.DrawFn) -> dict[str, Any]:
    """All that an episode depends on but its seed."""
    step = draw(st.sampled_from(STEPS))
    ticks = draw(st.integers(1, 40))
    faults = [
        Fault(
            type="bias",
            id=f"f{i}",
            target=draw(st.sampled_from(NAMES)),
            activation={"at": draw(st.integers(0, 30)) * step},
            duration=draw(st.integers(1, 5)) * step,
            by_chance=draw(st.booleans()),
        )
        for i in range(draw(st.integers(0, 2)))
    ]
    return {
        "step": step,
        "seed": draw(st.integers(0, 999)),
        "end": Termination(
            ticks * step,
            goal=draw(st.booleans()),
            violation=False,
            iterations=draw(st.none() | st.integers(1, 30)),
        ),
        "world": {
            "goal": draw(st.sampled_from([None, 2, 3])),
            "edge": draw(st.sampled_from([None, -3])),
        },
        "faults": faults,
        "policy": draw(st.sampled_from(["log_only", "recover", "halt", "refine(2)"])),
        "checks": draw(st.lists(asked_for(step), min_size=1, max_size=2)),
        "invalid": draw(st.sampled_from([(), (), (), (3,), (0, 1, 2)])),
        "limit": draw(st.sampled_from([2.0, 4.0])),
        "look": draw(st.sampled_from([1, 1, 2, 20])),
        "at_most": draw(st.sampled_from([None, None, 0.3, 0.9])),
    }


def answer(situation: Mapping[str, Any]) -> Any:
    """A component that goes by what it perceives, and fails at some ticks."""

    def of(view: GeneratorView) -> Proposal:
        if view.index in situation["invalid"]:
            return Proposal(None)
        seen = view.percept["a"] + (view.percept["b"] if view.index % 2 else 0)
        return Proposal(float(np.sign(np.sin(seen * 3 + view.index))))

    return of


def watching(limit: float) -> Any:
    """A monitor that refuses what leads far from the middle."""

    def watch(view: Any) -> Assessment:
        value = abs(view.percept["a"])
        return Assessment(Assessed.UNSAFE if value >= limit else Assessed.SAFE, limit - value)

    return doing(SafetyMonitor, watch)


def run(situation: Mapping[str, Any], seed: int, *, early: bool) -> Episode:
    """One episode, which ends early where it may."""
    requirements = [Requirement(f"R{i}", check=one) for i, one in enumerate(situation["checks"])]
    end = replace(situation["end"], decided=early)
    with patch.object(judging, "FIRST_LOOK", situation["look"]):
        return run_loop(
            answer(situation),
            simulator=Walk(),
            judge=RequirementJudge(requirements) if early else None,
            policy=situation["policy"],
            spec={
                "termination": end,
                "faults": tuple(situation["faults"]),
                "time_step": situation["step"],
                "seed": seed,
                "scenario": {"world": situation["world"]},
            },
            fault_injector=Bias(-2.0),
            safety_monitor=watching(situation["limit"]),
            recovery_planner=doing(RecoveryPlanner, lambda _: Recovery(-1.0, "back")),
        )


def check_prefix(ended: Episode, whole: Episode) -> None:
    """What it saw is what the whole one saw by then."""
    if ended.termination != "decided":
        assert (ended.termination, ended.ticks) == (whole.termination, whole.ticks)
    for name, column in ended.signals.items():
        assert np.array_equal(column, whole.signals[name][: ended.ticks])
    for name, column in ended.decisions.items():
        assert np.array_equal(column, whole.decisions[name][: ended.ticks - 1])


def judged(requirement: Requirement, ended: Episode, whole: Episode) -> list[EpisodeVerdict]:
    """The verdicts on both, which are the same."""
    own, other = (judge_episode(requirement, one) for one in (ended, whole))
    assert (own.verdict, own.vacuous, own.time) == (other.verdict, other.vacuous, other.time)
    if own.verdict == "satisfied" and own.margin is not None and other.margin is not None:
        assert own.margin <= other.margin
    return [replace(one, episode=str(ended.spec.seed)) for one in (own, other)]


def test_verdicts_on_episodes_that_end_early_are_those_of_whole_ones() -> None:
    ways: Counter[str] = Counter()

    @settings(max_examples=25, derandomize=True, deadline=None)
    @given(situations())
    def law(situation: dict[str, Any]) -> None:
        requirements = [
            Requirement(f"R{i}", check=one, at_most=situation["at_most"], confidence=0.6)
            for i, one in enumerate(situation["checks"])
        ]
        found: dict[str, list[list[EpisodeVerdict]]] = {one.id: [] for one in requirements}
        for seed in range(situation["seed"], situation["seed"] + RUNS):
            ended, whole = (run(situation, seed, early=early) for early in (True, False))
            assert ended.failure is whole.failure is None
            check_prefix(ended, whole)
            for one in requirements:
                found[one.id].append(judged(one, ended, whole))
                ways[f"{found[one.id][-1][0].verdict} {ended.termination}"] += 1
        for one in requirements:
            own, other = (
                judge_campaign(one, "c", list(verdicts), planned=RUNS)
                for verdicts in zip(*found[one.id], strict=True)
            )
            assert own.bound == other.bound
            # The share of valid proposals is that of the time until then.
            if "made a valid proposal" not in own.reason + other.reason:
                assert own.verdict == other.verdict

    law()
    # The law says something only if many examples end early, in either way.
    assert min(ways[f"{word} decided"] for word in ("satisfied", "violated")) > 4, ways
