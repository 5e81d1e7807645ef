"""Hazard files: what they hold, and what is refused, at its place."""

from __future__ import annotations

from pathlib import Path

import pytest

from pytest_dura import ConfigurationError
from pytest_dura.library import load_library, load_scenarios

HAZARDS = """hazards:
  - id: H-1
    text: The room is hotter than its walls stand.
    loss: "L-1: the room"
    severity: S2
    operating_condition: At noon.
  - id: H-2
    text: The room is cold.
    loss: "L-2: comfort"
"""
REQUIREMENTS = """requirements:
  - id: R-1
    text: t
    kind: safety
    check: always (headroom > 0)
    mitigates: [H-1]
"""
ROOM = "name: room\nsimulator: thermostat:Thermostat\nduration: 4.0\nrequirements: [R-1]\n"


def library(folder: Path, hazards: str = HAZARDS, requirements: str = REQUIREMENTS):
    (folder / "hazards.yaml").write_text(hazards)
    (folder / "requirements.yaml").write_text(requirements)
    (folder / "room.yaml").write_text(ROOM)
    return load_library([folder], builtin=False)


def refused(folder: Path, **texts: str) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as caught:
        library(folder, **texts)
    return caught.value


def test_hazards_are_read_beside_requirements_and_are_no_scenarios(tmp_path: Path) -> None:
    found = library(tmp_path)
    assert list(found.hazards) == ["H-1", "H-2"]
    assert (found.hazards["H-1"].severity, found.hazards["H-2"].severity) == ("S2", None)
    assert found.requirements["R-1"].mitigates == ("H-1",)
    assert list(load_scenarios([tmp_path])) == ["room"]
    # All of the user's own count, whether a requirement names them or not.
    assert [hazard.id for hazard in found.hazards_of(())] == ["H-1", "H-2"]


def test_a_file_of_another_name_is_known_by_its_key(tmp_path: Path) -> None:
    (tmp_path / "analysis.yaml").write_text(HAZARDS.replace("H-", "X-"))
    assert list(library(tmp_path).hazards) == ["H-1", "H-2", "X-1", "X-2"]


@pytest.mark.parametrize(
    "old, new, place, found",
    [
        ("severity: S2", "severity: S4", (5, "severity", "'S0'", "correct"), "S4"),
        ("severity: S2", "severty: S2", (5, "severty", "severity", "'severity'"), "severty"),
        (
            '    loss: "L-1: the room"\n',
            "",
            (2, "loss", "The loss that it may lead to", "add"),
            None,
        ),
        ("id: H-1", "id: H 1", (2, "id", "Unique name", "correct"), "H 1"),
    ],
    ids=["severity", "unknown key", "no loss", "id"],
)
def test_a_mistake_is_an_error_at_its_place(
    tmp_path: Path, old: str, new: str, place: tuple[int, str, str, str], found: str | None
) -> None:
    line, key, expected, remedy = place
    error = refused(tmp_path, hazards=HAZARDS.replace(old, new))
    assert (error.file, error.line) == (str(tmp_path / "hazards.yaml"), line)
    assert error.key == f"hazards.0.{key}"
    assert error.found == found
    assert expected in str(error.expected)
    assert remedy in str(error.remedy)


def test_an_id_that_is_there_twice_is_an_error_that_names_both_places(tmp_path: Path) -> None:
    file = tmp_path / "hazards.yaml"
    error = refused(tmp_path, hazards=HAZARDS.replace("H-2", "H-1"))
    assert (error.line, error.found) == (7, f"{file}:2 and {file}:7")
    (tmp_path / "hazards-more.yaml").write_text(HAZARDS)
    assert "hazards-more.yaml:2 and " in str(refused(tmp_path).found)


def test_an_empty_list_of_hazards_is_an_error(tmp_path: Path) -> None:
    assert "the list is empty" in str(refused(tmp_path, hazards="hazards: []\n"))


@pytest.mark.parametrize(
    "mitigates, key, problem, remedy",
    [
        ("[H-1, H-9]", "requirements.0.mitigates.1", "unknown hazard 'H-9'", "did you mean 'H-"),
        ("[H-1, H-1]", "requirements.0.mitigates.1", "'H-1' stands here twice", "remove"),
        ("H-1", "requirements.0.mitigates", "'mitigates' must be", "correct"),
    ],
)
def test_mitigates_names_hazards_that_exist(
    tmp_path: Path, mitigates: str, key: str, problem: str, remedy: str
) -> None:
    error = refused(tmp_path, requirements=REQUIREMENTS.replace("[H-1]", mitigates))
    assert (error.file, error.line) == (str(tmp_path / "requirements.yaml"), 6)
    assert error.key == key
    assert problem in error.problem
    assert remedy in str(error.remedy)


def test_without_any_hazard_the_remedy_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "requirements.yaml").write_text(REQUIREMENTS)
    with pytest.raises(ConfigurationError, match=r"define it in a hazard file, hazards\.yaml"):
        load_library([tmp_path / "requirements.yaml"], builtin=False)


@pytest.mark.of_guest
def test_each_built_in_requirement_on_the_ego_mitigates_a_hazard_and_the_other_way_round() -> None:
    found = load_library([])
    named = {hazard for each in found.requirements.values() for hazard in each.mitigates}
    assert named == set(found.hazards)
    # That the simulator agrees with itself is no evidence that a hazard is mitigated.
    assert {name for name, each in found.requirements.items() if not each.mitigates} == {"SIM-1"}
    assert all(hazard.severity and hazard.loss for hazard in found.hazards.values())
    assert found.hazards_of(()) == []
    assert [hazard.id for hazard in found.hazards_of(["H-INT-2"])] == ["H-INT-2"]
