"""`--dura-argument`: the user's own argument over the generated assurance case."""

from __future__ import annotations

import hashlib

import pytest
import yaml
from outputs import output

from pytest_dura.evidence import merge_bundles, verify_bundle

ARGUMENT = """
G1:
  text: The corridor robot may be let loose in the hall.
  supportedBy: [S1]
S1:
  text: By what it must never do.
  supportedBy: ["requirement:GAP-1"]
"""


@pytest.mark.parametrize("workers", [[], ["-n", "2"]], ids=["one process", "xdist"])
def test_the_users_goal_stands_on_top_and_its_file_is_an_input(project, workers):
    project.write("safety/argument.yaml", ARGUMENT)
    result = project.run("corridor/tight", "--dura-argument=safety/argument.yaml", *workers)
    assert result.ret == 0
    case = yaml.safe_load((project.path / "dura-evidence/assurance-case.gsn.yaml").read_text())
    assert case["G1"]["text"] == "The corridor robot may be let loose in the hall."
    assert case["S1"]["supportedBy"]
    assert "may be let loose" in (project.path / "dura-evidence/assurance-case.svg").read_text()
    digest = hashlib.sha256(ARGUMENT.encode()).hexdigest()
    (told,) = [one for one in project.evidence().inputs if one.kind == "argument"]
    assert (told.path, told.sha256) == ("safety/argument.yaml", digest)
    assert project.evidence().argument.path == "safety/argument.yaml"


def test_an_argument_over_shards_stands_on_top_of_the_merged_whole_alone(project):
    text = ARGUMENT.replace('["requirement:GAP-1"]', '["requirement:GO-1", "requirement:GAP-1"]')
    project.write("argument.yaml", text)
    bundles = [project.path / f"shard-{index}" for index in (1, 2, 3)]
    for index, one in enumerate(bundles, 1):
        # No shard but the first has anything of GO-1, and the last one nothing at all.
        result = project.scenarios(
            f"--dura-shard={index}/3", f"--dura-evidence={one}", "--dura-argument=argument.yaml"
        )
        assert result.ret == 0
        assert "let loose" not in (one / "assurance-case.gsn.yaml").read_text()
    merged = merge_bundles(bundles, project.path / "whole")
    assert merged.passed
    case = yaml.safe_load((project.path / "whole/assurance-case.gsn.yaml").read_text())
    assert case["G1"]["text"] == "The corridor robot may be let loose in the hall."
    assert len(case["S1"]["supportedBy"]) == 2
    assert verify_bundle(project.path / "whole").problems == []


@pytest.mark.parametrize(
    "text, told",
    [
        (
            ARGUMENT.replace("GAP-1", "GAP-9"),
            ["this requirement is not part of", "requirement:GAP"],
        ),
        (ARGUMENT + "G1: {text: again}\n", ["argument.yaml", "G1"]),
        ("- no mapping", ["argument.yaml"]),
    ],
)
def test_an_argument_that_cannot_be_used_is_one_error_before_anything_runs(project, text, told):
    project.write("argument.yaml", text)
    result = project.run("corridor/tight", "--dura-argument=argument.yaml")
    assert result.ret == 4
    assert all(one in output(result) for one in told)
    assert "Traceback" not in output(result)


def test_an_argument_that_is_not_there(project):
    result = project.run("corridor/tight", "--dura-argument=nowhere.yaml")
    assert result.ret == 4
    assert "this is not a file" in output(result)


def test_an_argument_that_turns_out_not_to_fit_fails_the_gate_in_one_line(project):
    project.write("argument.yaml", ARGUMENT.replace("requirement:GAP-1", "verdict:GAP-1@nowhere"))
    result = project.run("corridor/tight", "--dura-argument=argument.yaml")
    assert result.ret == 1
    (told,) = [one for one in project.evidence().gate.reasons if "gsn.yaml could" in one]
    assert "argument.yaml:7: this element does not exist; key: S1.supportedBy; found:" in told
    assert "\n" not in told
    assert ".py" not in told
