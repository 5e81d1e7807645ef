"""Pairs of parameters, from a scenario file to record, page and summary."""

from __future__ import annotations

import pytest

from pytest_dura.__main__ import main

SCENARIO = """
name: corridor/{name}
simulator: corridor:Corridor
duration: 1.0
runs: 6
world: {{wall: {wall}, paint: red}}
variation:
  world.wall: {{min: {wall}, max: {most}}}
  world.paint: {{choice: [red, green]}}
roles: {{generator: "corridor:Reckless"}}
requirements: [GAP-1]
"""


@pytest.fixture
def varied(project):
    """Two scenarios that vary two parameters each."""
    for name, wall in (("often", 90), ("rare", 0.5)):
        text = SCENARIO.format(name=name, wall=wall, most=wall + 0.5)
        project.write(f"scenarios/corridor/{name}.yaml", text)
    for name in ("free", "tight"):
        (project.path / f"scenarios/corridor/{name}.yaml").unlink()
    return project


def test_a_session_says_which_pairs_were_drawn(varied):
    varied.scenarios()
    combinations = varied.evidence().coverage.combinations
    assert combinations.pairs == 2
    assert {pair.scenario for pair in combinations.worst} == {"corridor/often", "corridor/rare"}
    page = (varied.path / "dura-evidence/report.html").read_text()
    summary = (varied.path / "dura-evidence/summary.md").read_text()
    for text in (page, summary):
        assert f"{combinations.met} of {combinations.cells} cells" in text
    assert '<svg class="chart plot"' in page
    assert main(["verify", str(varied.path / "dura-evidence")]) == 0


def test_merged_shards_say_the_same_as_the_whole(varied):
    varied.scenarios()
    for shard in (1, 2):
        varied.scenarios(f"--dura-shard={shard}/2", f"--dura-evidence=of/{shard}")
    parts = [str(varied.path / "of" / str(shard)) for shard in (2, 1)]
    main(["merge", *parts, f"--output={varied.path / 'merged'}"])
    whole, merged = varied.evidence(), varied.evidence("merged")
    assert merged.coverage.combinations == whole.coverage.combinations
