"""A session whose planner, fault and condition name driving's channel `objects`."""

from __future__ import annotations

import pytest
from outputs import output

PLANNER = """
from pytest_dura import Generator, Proposal

class Onlooker(Generator):
    def propose(self, view):
        assert "objects" in view.percept
        return Proposal("proceed" if len(view.percept["NAME"]) else "accelerate")
"""
SCENARIO = """
name: cross/{name}
simulator: driving
seed: 3
duration: 5
runs: 1
policy: log_only
roles: {{safety_monitor: null, security_assessor: null, performance_oracle: null,
  recovery_planner: null}}
faults: [{{type: ghost-obstacle, target: {name}, activation: {{when: {name}.count >= 0}}}}]
requirements: [SPEED-1]
"""
REQUIREMENTS = """
requirements:
  - {id: SPEED-1, text: It moves., kind: performance, check: eventually (speed > 1)}
"""
MARKED = """
import pytest

@pytest.mark.dura(scenario="cross/lidar", runs=1, faults=[
    {"type": "ghost-obstacle", "target": "objects", "activation": {"at": 1.0}}])
@pytest.mark.requirement("SPEED-1")
def test_it(episode):
    assert episode.faults[0].target == "lidar"
    assert episode.read_by == {"ghost-obstacle": ("generator",)}
"""


@pytest.fixture
def crossing(project):
    project.write("onlooker.py", PLANNER.replace("NAME", "objects"))
    project.write("scenarios/requirements_speed.yaml", REQUIREMENTS)
    for name in ("lidar", "objects"):
        project.write(f"scenarios/{name}.yaml", SCENARIO.format(name=name))
    return project


def test_a_planner_that_reads_objects_is_reached_by_a_ghost_among_them(crossing):
    planner = "--dura-generator=onlooker:Onlooker"
    result = crossing.scenarios(planner, select="cross/objects")
    (episode,) = crossing.evidence().episodes
    (fault,) = episode.faults
    assert episode.validity == "valid"
    assert (fault.target, fault.read_by) == ("lidar", ("generator",))
    assert fault.manifested_at is not None
    assert result.ret == 0, output(result)
    assert crossing.run("--dura-replay=cross/objects#0", planner).ret == 0


def test_a_marker_and_the_command_line_take_the_second_name(crossing):
    crossing.write("tests/test_marked.py", MARKED)
    planner = "--dura-generator=onlooker:Onlooker"
    assert crossing.run(planner, "tests/test_marked.py").ret == 0
    digests = set()
    for name in ("lidar", "objects"):
        fault = f'{{"type": "delay", "target": "{name}", "activation": {{"at": 1.0}}}}'
        crossing.scenarios(planner, f"--dura-faults={fault}", select="cross/lidar")
        (episode,) = crossing.evidence().episodes
        assert episode.faults[0].target == "lidar"
        digests.add(episode.digest)
    assert len(digests) == 1


def test_the_list_names_the_alias(crossing):
    assert "length and width in m; alias: objects" in output(crossing.run("--dura-list"))
