"""``python -m pytest_dura compare``: components of several sessions side by side."""

from __future__ import annotations

import json
import shutil

import pytest
from sealing import alter

from pytest_dura.__main__ import main
from pytest_dura.requirements import mcnemar, mcnemar_one_sided

RATE = """
import pytest

@pytest.mark.dura(scenario="corridor/free", runs=12)
@pytest.mark.requirement("OWN-1", text="Rarely touches anything.")
def test_rate(campaign):
    campaign.require("always (gap > 0)", at_most=0.9)
"""
COMPONENTS = """
from pytest_dura import Generator, Proposal

class Account(Generator):
    invents, words = "GHOST", 10
    def propose(self, view):
        usage = {"requests": 2, "prompt": 100, "completion": self.words, "uncounted": 0}
        account = {"decided": True, "at": view.index, "age": 0.0, "outcome": "answered",
                   "fallback": False, "perceived": ["WALL"], "cited": [self.invents],
                   "intent": "hold", "maneuver": "proceed", "seconds": 0.5,
                   "usage": usage}
        return Proposal(self.speed(view), account=account)

class Slow(Account):
    invents = "WALL"
    def speed(self, view):
        return 0.0

class Hasty(Account):
    def speed(self, view):
        return 20.0 if view.percept["gap"] < 10.0 else 0.0

class Calm(Slow):
    def speed(self, view):
        return "wait"

class Talker(Calm):
    invents, words = "GHOST", 50
"""
TALK = """
name: talk/it
simulator: driving
duration: 1.0
runs: 3
world: {ego: {speed: 5.0, distance: 60.0}}
variation: {world.ego.distance: {min: 60.0, max: 61.0}}
requirements: [GAP-1]
"""


@pytest.fixture
def suite(project):
    project.write("test_rate.py", RATE)
    project.write("parts.py", COMPONENTS)
    return project


def keep(project, folder, component, *arguments):
    project.run(f"--dura-generator=parts:{component}", f"--dura-evidence={folder}", *arguments)
    return str(project.path / folder)


def compare(capsys, *arguments):
    capsys.readouterr()  # what the sessions printed
    code = main(["compare", *arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_components_stand_side_by_side_in_pairs_of_equal_seeds(suite, capsys):
    first, second = keep(suite, "slow", "Slow"), keep(suite, "hasty", "Hasty")
    third = keep(suite, "other", "Hasty", "--dura-seed=7")
    file = suite.path / "all.json"
    code, out, _ = compare(capsys, first, second, third, f"--json={file}")
    assert code == 0
    hit = suite.evidence("hasty").verdicts[0].violations
    assert 2 < hit < 12
    lines = [" ".join(line.split()) for line in out.splitlines()]
    head = next(line for line in lines if line.startswith("A Slow"))
    assert head.startswith(f"A Slow {first} {suite.evidence('slow').created[:10]}")
    assert "the hashes of each bundle hold" in out
    other = suite.evidence("other").verdicts[0].violations
    assert f"OWN-1 on corridor/free supported 0/12 supported {hit}/12 supported {other}/12" in lines
    share = f"{100 * hit / 12:.1f}"
    assert f"collided % 0.0 {share} {100 * other / 12:.1f}" in lines
    # Two of these runs have equal seeds, the third has none of theirs.
    assert "B against A: 12 pairs of valid runs with equal seeds and conditions" in lines
    assert "C against A: 0 pairs of valid runs with equal seeds and conditions" in lines
    assert "not paired" not in out
    # As with a baseline; the first component stands first.
    assert "requirement and case A B p Holm test" in lines
    row = next(line for line in lines if line.startswith("OWN-1 on corridor/free worse"))
    assert row.split()[4:6] == ["0/12", f"{hit}/12"]
    data = json.loads(file.read_text())
    assert [side["component"] for side in data["sides"]] == ["Slow", "Hasty", "Hasty"]
    paired, apart = (contrast["verdicts"][0] for contrast in data["contrasts"])
    assert (paired["test"], apart["test"]) == ("McNemar", "Fisher")
    assert paired["p_worse"] == mcnemar_one_sided(hit, 0)
    # Holm's method counts the verdicts of both contrasts.
    assert paired["p_worse_holm"] in (
        2 * paired["p_worse"],
        max(paired["p_worse"], apart["p_worse"]),
    )
    collided = [each for each in data["contrasts"][0]["measures"] if each["name"] == "collided"]
    pooled, by_case = collided
    assert (pooled["case"], pooled["p_value"]) == (None, None)
    assert (by_case["pairs"], by_case["more"], by_case["less"]) == (12, hit, 0)
    assert by_case["p_value"] == mcnemar(hit, 0)
    assert not data["contrasts"][1]["measures"]


def test_failure_modes_and_times_of_decisions_stand_side_by_side(suite, capsys):
    suite.write("scenarios/talk.yaml", TALK)
    folders = [
        keep(
            suite,
            component,
            component,
            "--dura-scenarios",
            "--dura-select=talk/*",
            "-k",
            "talk",
        )
        for component in ("Calm", "Talker")
    ]
    _, out, _ = compare(capsys, *folders, "--all")
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert "threat ids unperceived % 0.0 (null -) 100.0 (null -)" in lines
    assert "answers s, median 0.50 0.50" in lines
    # 10 decisions in each of 3 runs.
    assert "used: requests 60 60" in lines
    assert "used: prompt 3000 3000" in lines
    assert "used: completion 300 1500" in lines
    assert "threat ids unperceived, runs with it % 3 0.0 100.0 3 0 ~ ~" in lines
    (case,) = [line for line in lines if line.startswith("on talk/it 3 0.0 100.0 3 0")]
    assert case.split()[-2] == "0.25"


def test_a_single_component_has_nothing_to_be_compared_with(suite, capsys):
    folder = keep(suite, "slow", "Slow")
    code, _, error = compare(capsys, folder)
    assert code == 2
    assert "too few components to compare" in error
    assert f"found:    'Slow of {folder}'" in error


def test_runs_of_equal_seeds_in_another_world_are_no_pairs(suite, capsys):
    folder = keep(suite, "slow", "Slow", "--dura-runs=2")
    shutil.copytree(folder, suite.path / "second")

    def change(record):
        record["component_under_test"]["name"] = "\x1b[31mRed"
        for key in ("episodes", "judgements", "verdicts", "cases"):
            for entry in record[key]:
                entry["component"] = "\x1b[31mRed"
        record["episodes"][0]["spec"]["scenario"]["world"]["wall"] = 77.0

    alter(suite.path / "second", change)
    code, out, _ = compare(capsys, folder, str(suite.path / "second"))
    assert code == 0
    assert "B against A: 1 pair of valid runs with equal seeds and conditions" in out
    assert "not paired: the runs of corridor/free differ in scenario.world.wall" in out
    assert "\x1b" not in out
    assert "\\x1b[31mRed" in out


def altered(**changes):
    return lambda record: record.update(changes)


def renamed_case(record):
    for entry in (*record["episodes"], *record["verdicts"]):
        entry["case"] = "elsewhere/free"
    for case in record["cases"]:
        case["id"] = "elsewhere/free"


def other_simulator(record):
    for episode in record["episodes"]:
        episode["spec"]["simulator"]["path"] = "elsewhere:World"


CHANGES = [
    (altered(schema_version="2"), "written by another version of pytest-dura", "'2'"),
    (altered(status="running"), "this session was killed, or still runs", "'running'"),
    (renamed_case, "these components share no case", "elsewhere/free"),
    (other_simulator, "were run in different simulators", "elsewhere:World"),
    (lambda record: record.pop("verdicts"), "this record is damaged", "verdicts"),
]
SPOILT = [
    (lambda second: (second / "summary.md").write_text("all is well"), "summary.md: changed"),
    (lambda second: (second / "evidence.json").unlink(), "there is no evidence here"),
    (shutil.rmtree, "there is no such directory"),
]


def test_a_bundle_that_cannot_be_compared_is_one_error(suite, capsys):
    folder = keep(suite, "slow", "Slow", "--dura-runs=1")
    for number, (change, problem, found) in enumerate(CHANGES):
        second = suite.path / f"second-{number}"
        shutil.copytree(folder, second)
        alter(second, change)
        code, out, error = compare(capsys, folder, str(second))
        assert (code, out) == (2, "")
        assert problem in error.splitlines()[0]
        assert found in error
    for number, (spoil, problem) in enumerate(SPOILT):
        second = suite.path / f"spoilt-{number}"
        shutil.copytree(folder, second)
        spoil(second)
        code, out, error = compare(capsys, folder, str(second))
        assert (code, out) == (2, "")
        assert problem in error.splitlines()[0]


def test_the_same_bundle_twice_is_an_error(suite, capsys):
    folder = keep(suite, "slow", "Slow", "--dura-runs=1")
    code, _, error = compare(capsys, folder, f"{folder}/")
    assert code == 2
    assert "the same evidence is named twice" in error
