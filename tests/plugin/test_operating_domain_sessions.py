"""Declared exposure and pairs of parameters, from a scenario file to record, page and summary."""

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
{exposure}
"""
DECLARED = "exposure: {weight: 9, source: 'a <census>', parameters: {world.paint: [3, 1]}}"


@pytest.fixture
def varied(project):
    """Two scenarios that declare an exposure, of which the rare one is violated, and one other."""
    rows = [
        ("often", 90, 95, DECLARED),
        ("rare", 0.5, 0.6, "exposure: 1"),
        ("unsaid", 90, 95, ""),
    ]
    for name, wall, most, exposure in rows:
        text = SCENARIO.format(name=name, wall=wall, most=most, exposure=exposure)
        project.write(f"scenarios/corridor/{name}.yaml", text)
    for name in ("free", "tight"):
        (project.path / f"scenarios/corridor/{name}.yaml").unlink()
    return project


def test_a_session_says_what_was_exercised_and_how_violations_weigh(varied):
    varied.scenarios()
    coverage = varied.evidence().coverage
    (entry,) = coverage.exposure
    assert (entry.declared, entry.exercised, entry.undeclared) == (10.0, 1.0, ["corridor/unsaid"])
    assert [(each.scenario, each.runs) for each in entry.scenarios] == [
        ("corridor/often", 6), ("corridor/rare", 6),
    ]  # fmt: skip
    (paint,) = entry.scenarios[0].parameters
    assert (paint.weights, sum(paint.runs), paint.exercised) == ([3, 1], 6, 1.0)
    (safety,) = entry.violations
    # Half of the runs violate, all of them where a tenth of the exposure is.
    assert (safety.runs, safety.violating, safety.weighed) == (12, 6, pytest.approx(0.1))
    assert coverage.combinations.pairs == 3
    assert {pair.scenario for pair in coverage.combinations.worst} == {
        "corridor/often", "corridor/rare", "corridor/unsaid",
    }  # fmt: skip
    page = (varied.path / "dura-evidence/report.html").read_text()
    summary = (varied.path / "dura-evidence/summary.md").read_text()
    said = "safety: 6 of 12 valid runs violate a requirement, 10.0 % when weighed"
    for text in (page, summary):
        assert said in text
        assert "100.0 % of the declared exposure was exercised" in text
    assert "a &lt;census&gt;" in page
    assert '<svg class="chart plot"' in page
    assert main(["verify", str(varied.path / "dura-evidence")]) == 0


def test_no_run_depends_on_the_declared_exposure(varied):
    varied.scenarios()
    digests = [(each.id, each.digest) for each in varied.evidence().episodes]
    for name in ("often", "rare"):
        file = varied.path / f"scenarios/corridor/{name}.yaml"
        file.write_text("\n".join(line for line in file.read_text().splitlines()
                                  if not line.startswith("exposure")))  # fmt: skip
    varied.scenarios("--dura-evidence=plain")
    plain = varied.evidence("plain")
    assert [(each.id, each.digest) for each in plain.episodes] == digests
    assert plain.coverage.exposure is None


def test_merged_shards_say_the_same_as_the_whole(varied):
    varied.scenarios()
    for shard in (1, 2):
        varied.scenarios(f"--dura-shard={shard}/2", f"--dura-evidence=of/{shard}")
    parts = [str(varied.path / "of" / str(shard)) for shard in (2, 1)]
    main(["merge", *parts, f"--output={varied.path / 'merged'}"])
    whole, merged = varied.evidence(), varied.evidence("merged")
    assert merged.coverage.exposure == whole.coverage.exposure
    assert merged.coverage.combinations == whole.coverage.combinations


def test_an_exposure_that_cannot_be_used_names_file_line_and_key(varied):
    file = varied.path / "scenarios/corridor/often.yaml"
    file.write_text(file.read_text().replace("[3, 1]", "[3, 1, 2]"))
    text = varied.scenarios("--collect-only").stderr.str()
    line = 1 + file.read_text().splitlines().index(DECLARED.replace("[3, 1]", "[3, 1, 2]"))
    assert f"often.yaml:{line}: " in text
    assert "exposure.parameters.world.paint" in text
    assert "2 weights" in text
