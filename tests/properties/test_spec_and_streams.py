"""Laws of specs, seeds and schedules."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura import (
    ConfigurationError,
    EpisodeSpec,
    Fault,
    Orchestrator,
    Policy,
    RoleSpec,
    Termination,
    derive_seed,
    stream,
)
from pytest_dura.core import first_difference, leaves

numbers = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**53), 2**53)
plain = st.recursive(
    st.none() | st.booleans() | numbers | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=8,
)
objects = st.dictionaries(st.text(max_size=5), plain, max_size=3)
positive = st.floats(1e-3, 1e3)
policies = st.sampled_from([Policy("recover"), Policy("halt"), Policy("log_only")]) | st.builds(
    Policy, st.just("refine"), st.integers(1, 99)
)
role_specs = st.builds(RoleSpec, st.text(max_size=12), objects)
specs = st.builds(
    EpisodeSpec,
    case=st.text(max_size=12),
    run=st.integers(0, 10**6),
    seed=st.integers(0, 2**53 - 1),
    simulator=role_specs,
    roles=st.dictionaries(st.text(max_size=8), role_specs, max_size=4),
    scenario=st.fixed_dictionaries({}, optional={"world": objects, "name": st.text(max_size=5)}),
    faults=st.lists(
        st.builds(
            Fault,
            type=st.text(max_size=8),
            id=st.text(max_size=8),
            target=st.text(max_size=8),
            activation=objects,
            duration=st.none() | positive | objects,
            parameters=st.none() | objects,
            by_chance=st.booleans(),
        ),
        max_size=3,
    ).map(tuple),
    policy=policies,
    termination=st.builds(
        Termination, positive, st.booleans(), st.booleans(), st.none() | st.integers(1, 999)
    ),
    time_step=positive,
    time_budget=st.none() | positive,
    timeouts=st.none() | st.lists(st.integers(-1, 999), max_size=4).map(tuple),
)


@given(specs)
@settings(derandomize=True, max_examples=60, deadline=None)
def test_a_spec_that_is_written_and_read_back_is_equal(spec: EpisodeSpec) -> None:
    again = EpisodeSpec.from_json(json.loads(json.dumps(spec.to_json())))
    assert again == spec
    assert again.key == spec.key


@given(specs)
@settings(derandomize=True, max_examples=30, deadline=None)
def test_a_replay_has_the_key_of_the_episode_that_it_replays(spec: EpisodeSpec) -> None:
    assert replace(spec, timeouts=(1, 2)).key == spec.key
    assert replace(spec, seed=spec.seed + 1).key != spec.key


@settings(derandomize=True)
@given(policies)
def test_a_policy_is_its_name(policy: Policy) -> None:
    assert Policy.parse(str(policy)) == policy


@settings(derandomize=True)
@given(st.integers(0, 2**53 - 1), st.text(max_size=10), st.text(max_size=10))
def test_streams_are_told_apart_by_name_alone(seed: int, name: str, other: str) -> None:
    draws = stream(seed, name).random(4)
    np.testing.assert_array_equal(draws, stream(seed, name).random(4))
    assert (draws == stream(seed, other).random(4)).all() == (name == other)
    assert (draws != stream(seed + 1, name).random(4)).any()


@settings(derandomize=True)
@given(st.integers(), st.lists(st.text(max_size=5) | st.integers(), max_size=3))
def test_derived_seeds_are_stable_and_fit_a_double(base: int, names: list[object]) -> None:
    seed = derive_seed(base, *names)
    assert 0 <= seed < 2**53
    assert float(seed) == seed
    assert seed == derive_seed(base, *names)
    assert seed != derive_seed(base + 1, *names)


def test_seeds_and_streams_are_those_of_every_release() -> None:
    # Recorded evidence is replayed from them: a change here breaks every replay.
    assert derive_seed(0) == 3375077322127629
    assert derive_seed(7, "intersection/nominal", 3) == 8130606202997539
    assert stream(7, "traffic").integers(0, 2**32, 3).tolist() == [556304942, 784452825, 80306034]


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="at least 0"):
        stream(-1, "traffic")


@given(st.permutations(["generator", "safety_monitor", "performance_oracle", "night_watch"]))
@settings(derandomize=True, max_examples=10, deadline=None)
def test_the_order_in_which_roles_are_declared_does_not_matter(names: list[str]) -> None:
    parts = {
        "generator": "Controller",
        "safety_monitor": "HeatMonitor",
        "performance_oracle": "Meter",
        "night_watch": "NightWatch",
    }
    roles = {name: RoleSpec(f"thermostat:{parts[name]}") for name in names}
    part = RoleSpec("thermostat:Thermostat")
    spec = EpisodeSpec("room/x", 0, 1, part, roles, termination=Termination(0.5))
    spec_sorted = replace(spec, roles=dict(sorted(roles.items())))
    assert Orchestrator.build(spec).run(spec).digest == (
        Orchestrator.build(spec_sorted).run(spec_sorted).digest
    )


@settings(derandomize=True)
@given(st.floats(0.01, 0.5), st.integers(1, 400))
def test_a_limit_of_n_steps_is_reached_at_tick_n(step: float, count: int) -> None:
    assert Termination(count * step).last_index(step) == count
    assert Termination((count - 0.5) * step).last_index(step) == count


@settings(derandomize=True)
@given(plain, plain)
def test_leaves_tell_values_apart(one: object, other: object) -> None:
    same = json.dumps(one, sort_keys=True) == json.dumps(other, sort_keys=True)
    assert (first_difference(leaves(one), leaves(other)) is None) is same
