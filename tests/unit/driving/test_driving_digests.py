"""The same spec gives the same episode: in this process, in others, and in any order."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
from roads import SCENARIOS, SIX, run

from pytest_dura import EpisodeSpec, RoleSpec
from pytest_dura.library import expand_cases, load_scenarios

GENERATORS = ("rule_based", "reactive", "random")


@pytest.fixture(scope="module")
def specs() -> list[EpisodeSpec]:
    cases = expand_cases(load_scenarios([SCENARIOS / "intersection"]))
    assert sorted(case.id for case in cases) == sorted(SIX)
    return [
        case.spec(0, 77, {"generator": RoleSpec(GENERATORS[i % 3])}) for i, case in enumerate(cases)
    ]


@pytest.fixture(scope="module")
def digests(specs: list[EpisodeSpec]) -> dict[str, str]:
    found = {spec.id: run(spec) for spec in specs}
    assert all(episode.failure is None for episode in found.values())
    return {name: episode.digest for name, episode in found.items()}


def test_digests_tell_episodes_apart(digests: dict[str, str]) -> None:
    assert len(set(digests.values())) == 6


def test_order_and_other_episodes_make_no_difference(
    specs: list[EpisodeSpec], digests: dict[str, str]
) -> None:
    shuffled = [*specs]
    random.Random(3).shuffle(shuffled)
    assert [spec.id for spec in shuffled] != [spec.id for spec in specs]
    assert {spec.id: run(spec).digest for spec in shuffled} == digests


PROGRAM = """
import json, sys
from pytest_dura import EpisodeSpec, Orchestrator
specs = [EpisodeSpec.from_json(one) for one in json.load(sys.stdin)]
print(json.dumps({s.id: Orchestrator.build(s).run(s).digest for s in specs}))
"""


def test_another_process_with_another_hash_seed_gives_the_same(
    specs: list[EpisodeSpec], digests: dict[str, str]
) -> None:
    environment = {**os.environ, "PYTHONHASHSEED": "4242"}
    environment["PYTHONPATH"] = str(Path(__file__).parents[3])
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM],
        input=json.dumps([spec.to_json() for spec in reversed(specs)]),
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == digests
