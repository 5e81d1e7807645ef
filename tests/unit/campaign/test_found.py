"""Counterexamples as scenario files: read back equal, harmless, whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from test_search_space import BIAS, WARM, case

from pytest_dura import ConfigurationError, Requirement
from pytest_dura.library import expand_cases, load_library
from pytest_dura.search import SearchSpace, write_counterexample


def made(**more: Any) -> Any:
    space = SearchSpace.of(case(**more), [BIAS])
    highest = space.values([1.0] * space.layout.size)
    return space.case_with(highest | {"world.start": 16.5}, 7)


def test_what_is_kept_reads_as_the_same_episode(tmp_path) -> None:
    searched = made()
    kept = write_counterexample(tmp_path, searched, WARM, defined=True, heading=["by a test"])
    (again,) = expand_cases([kept.scenario])
    one, other = searched.spec(0, 0), again.spec(0, 5)
    assert (one.seed, one.faults, one.roles) == (other.seed, other.faults, other.roles)
    assert one.scenario["world"] == other.scenario["world"]
    assert kept.file.parent == tmp_path / "found"
    assert kept.file.read_text().startswith("# by a test\nname: found/room-WARM-")
    assert kept.requirement is WARM


def test_only_what_is_not_so_by_default_is_written(tmp_path) -> None:
    kept = write_counterexample(tmp_path, made(), WARM, defined=True)
    data = yaml.safe_load(kept.file.read_text())
    (fault,) = data["faults"]
    assert set(fault) == {"type", "target", "activation", "duration", "parameters"}
    assert fault["activation"] == {"at": 1.0}
    assert "policy" not in data
    assert "variation" not in data


def test_a_role_that_was_switched_off_stays_off(tmp_path) -> None:
    roles = {"generator": "thermostat:Controller", "safety_monitor": "thermostat:Monitor"}
    searched = made(roles=roles).switched_off("safety_monitor")
    kept = write_counterexample(tmp_path, searched, WARM, defined=True)
    (again,) = expand_cases([kept.scenario])
    assert "safety_monitor" not in again.spec(0, 0).roles


@pytest.mark.parametrize(
    "requirement,check,defined",
    [
        (WARM, None, False),
        (WARM, "always (temperature > 11)", True),
        (Requirement("WARM", check=WARM.check, at_most=0.1), None, True),
        (Requirement("always (temperature > 10)", check=WARM.check), None, False),
    ],
)
def test_a_requirement_that_no_episode_may_violate_is_written_beside(
    tmp_path, requirement, check, defined
) -> None:
    kept = write_counterexample(tmp_path, made(), requirement, check, defined=defined)
    library = load_library([tmp_path])
    (name,) = library.scenarios[kept.scenario.name].requirements
    named = library.requirements[name]
    assert named.check == (check or requirement.check)
    assert named.at_most is None
    assert name.endswith(".found")


def test_a_check_that_no_file_can_name_is_refused_and_nothing_is_written(tmp_path) -> None:
    with pytest.raises(ConfigurationError, match="no file can name this check"):
        write_counterexample(
            tmp_path, made(), Requirement("X"), lambda episode: True, defined=False
        )
    assert list(tmp_path.rglob("*.yaml")) == []


@pytest.mark.parametrize(
    "text", ["x\nname: evil", "x\r\nseed: 1", "x\u2028y: 1", "\x85a: b", "x" * 999]
)
def test_no_text_breaks_out_of_the_comment(tmp_path, text) -> None:
    kept = write_counterexample(tmp_path, made(), WARM, defined=True, heading=[text])
    plain = write_counterexample(tmp_path / "plain", made(), WARM, defined=True)
    assert yaml.safe_load(kept.file.read_text()) == yaml.safe_load(plain.file.read_text())


def test_no_name_leads_out_of_the_folder(tmp_path) -> None:
    requirement = Requirement("../../etc/passwd", check=WARM.check)
    kept = write_counterexample(tmp_path / "in", made(), requirement, defined=False)
    assert kept.file.parent == tmp_path / "in" / "found"
    written = {file.parent for file in tmp_path.rglob("*.yaml")}
    assert written == {kept.file.parent, kept.file.parent / "requirements"}


def test_a_folder_that_cannot_be_written_is_one_clear_error(tmp_path) -> None:
    (tmp_path / "found").write_text("a file")
    with pytest.raises(ConfigurationError, match="cannot be kept"):
        write_counterexample(tmp_path, made(), WARM, defined=True)


def test_a_file_that_does_not_read_back_is_taken_away(tmp_path, monkeypatch) -> None:
    problem = ConfigurationError("no")
    monkeypatch.setattr("pytest_dura.search.counterexamples.scenario_problems", lambda _: [problem])
    with pytest.raises(ConfigurationError, match="no"):
        write_counterexample(tmp_path, made(), WARM, defined=True)
    assert [file for file in Path(tmp_path).rglob("*") if file.is_file()] == []


def test_checks_that_are_alike_do_not_write_over_each_other(tmp_path) -> None:
    texts = ["always (temperature > 10)", "always (temperature >= 10)"]
    long = "always (temperature > 10 and temperature > 10 and temperature > 10 and temperature > "
    texts += [f"{long}11)", f"{long}12)"]
    for text in texts:
        write_counterexample(tmp_path, made(), Requirement(text, check=text), defined=False)
    library = load_library([tmp_path])
    kept = [one for name, one in library.scenarios.items() if name.startswith("found/")]
    checks = {library.requirements[name].check for one in kept for name in one.requirements}
    assert checks == set(texts)


def test_requirements_of_long_names_that_begin_alike_have_a_file_each(tmp_path) -> None:
    names = [f"{'WARM-' * 15}{number}" for number in (1, 2)]
    kept = [
        write_counterexample(tmp_path, made(), Requirement(name, check=WARM.check), defined=True)
        for name in names
    ]
    assert [one.scenario.requirements for one in kept] == [(name,) for name in names]
    assert kept[0].file != kept[1].file


def test_a_long_name_of_a_scenario_still_has_a_file(tmp_path) -> None:
    kept = write_counterexample(tmp_path, made(name="room/" + "long" * 60), WARM, defined=True)
    assert kept.file.exists()
