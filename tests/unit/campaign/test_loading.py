"""Finding files, the library of scenarios and requirements, and choosing among them."""

from __future__ import annotations

from pathlib import Path

import pytest

from pytest_dura import ConfigurationError
from pytest_dura.library import (
    builtin_paths,
    expand_cases,
    load_library,
    load_scenarios,
    loading,
    select_names,
)


def scenario(name: str, *requirements: str) -> str:
    return (
        f"name: {name}\nsimulator: thermostat:Thermostat\nduration: 4.0\n"
        f"requirements: [{', '.join(requirements)}]\n"
    )


def requirement(name: str, check: str = "always (headroom > 0)") -> str:
    return f"requirements:\n  - id: {name}\n    text: t\n    kind: safety\n    check: {check}\n"


def test_folders_are_searched_and_sorted_by_name(tmp_path: Path) -> None:
    (tmp_path / "deep" / "er").mkdir(parents=True)
    (tmp_path / "a.yaml").write_text(scenario("z/z"))
    (tmp_path / "deep" / "er" / "a.yml").write_text(scenario("a"))
    (tmp_path / "deep" / "m.yaml").write_text(scenario("m"))
    (tmp_path / "notes.txt").write_text("no YAML: [")
    assert list(load_scenarios([tmp_path])) == ["a", "m", "z/z"]


def test_hidden_and_requirement_files_are_no_scenarios(tmp_path: Path) -> None:
    (tmp_path / ".git").mkdir()
    (tmp_path / ".git" / "a.yaml").write_text("[")
    (tmp_path / ".hidden.yaml").write_text("[")
    (tmp_path / "requirements-extra.yaml").write_text(requirement("A"))
    (tmp_path / "safety.yaml").write_text(requirement("B"))
    (tmp_path / "room.yaml").write_text(scenario("room"))
    assert list(load_scenarios([tmp_path])) == ["room"]
    assert list(load_library([tmp_path], builtin=False).requirements) == ["A", "B"]


def test_a_file_that_is_given_twice_is_read_once(tmp_path: Path) -> None:
    file = tmp_path / "room.yaml"
    file.write_text(scenario("room"))
    assert list(load_scenarios([tmp_path, file, tmp_path / ".." / tmp_path.name])) == ["room"]


def test_two_scenarios_of_one_name_are_an_error_that_names_both_files(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(scenario("room"))
    (tmp_path / "b.yaml").write_text("# head\n" + scenario("room"))
    with pytest.raises(ConfigurationError) as caught:
        load_scenarios([tmp_path])
    assert caught.value.found == f"{tmp_path / 'a.yaml'}:1 and {tmp_path / 'b.yaml'}:2"
    assert "rename one" in str(caught.value.remedy)


def test_two_requirements_of_one_id_are_an_error_that_names_both_files(tmp_path: Path) -> None:
    (tmp_path / "requirements.yaml").write_text(requirement("A"))
    (tmp_path / "requirements2.yaml").write_text(requirement("A"))
    with pytest.raises(ConfigurationError) as caught:
        load_library([tmp_path], builtin=False)
    assert "requirement 'A' is defined twice" in str(caught.value)
    assert caught.value.line == 2
    assert str(tmp_path / "requirements.yaml") in str(caught.value.found)


def test_a_path_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_scenarios([tmp_path / "nowhere"])
    assert caught.value.file == str(tmp_path / "nowhere")


def test_a_folder_without_scenarios(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no scenario file in this folder"):
        load_scenarios([tmp_path])


@pytest.mark.parametrize(
    "text, line, key, words",
    [
        (requirement("A").replace("safety", "saftey"), 4, "requirements.0.kind", "'safety'"),
        (requirement("A", "always (gap >> 0)"), 5, "requirements.0.check", "^"),
        (requirement("A").replace("text", "txt"), 2, "requirements.0.text", "is missing"),
        (requirement("A") + "scenario: 3\n", 6, "scenario", "unknown key"),
        (requirement("'A B'"), 2, "requirements.0.id", "pattern"),
        ("requirements: []\n", 1, "requirements", "at least one entry"),
    ],
)
def test_a_bad_requirement_file(tmp_path: Path, text: str, line: int, key: str, words: str) -> None:
    file = tmp_path / "requirements.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as caught:
        load_library([file], builtin=False)
    assert str(caught.value).startswith(f"{file}:{line}: ")
    assert caught.value.key == key
    assert words in str(caught.value)
    assert caught.value.remedy


def test_a_library_warns_of_requirements_that_nobody_uses(tmp_path: Path) -> None:
    (tmp_path / "requirements.yaml").write_text(
        requirement("A") + requirement("B").removeprefix("requirements:\n")
    )
    (tmp_path / "room.yaml").write_text(scenario("room", "A"))
    library = load_library([tmp_path], builtin=False)
    assert list(library.requirements) == ["A", "B"]
    assert library.requirements["A"].check == "always (headroom > 0)"
    place = tmp_path / "requirements.yaml"
    assert library.unused == {"B": f"{place}:6"}


def test_built_in_requirements_that_nobody_uses_are_no_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder, name in (("builtin", "B"), ("own", "A")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "requirements.yaml").write_text(requirement(name))
    monkeypatch.setattr(loading, "builtin_paths", lambda: [tmp_path / "builtin"])
    assert list(load_library([tmp_path / "own"]).unused) == ["A"]
    assert not load_library([]).unused


def test_a_window_beyond_the_episode_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "requirements.yaml"
    file.write_text(requirement("A", "eventually[0:9] (x > 0)"))
    (tmp_path / "room.yaml").write_text(scenario("room", "A"))
    with pytest.raises(ConfigurationError) as caught:
        load_library([tmp_path], builtin=False)
    assert str(caught.value).startswith(f"{file}:5: the windows of the formula reach beyond")
    assert "which looks 9 s ahead" in str(caught.value)
    assert "the scenario's duration of 4 s" in str(caught.value)
    file.write_text(requirement("A", "eventually[0:4] (x > 0)"))
    assert not load_library([tmp_path], builtin=False).warnings


def test_a_scenario_cannot_rest_on_a_requirement_without_a_check(tmp_path: Path) -> None:
    text = requirement("A").replace("    check: always (headroom > 0)\n", "")
    (tmp_path / "requirements.yaml").write_text(text)
    (tmp_path / "room.yaml").write_text(scenario("room", "A"))
    with pytest.raises(ConfigurationError, match="'A' has no check") as caught:
        load_library([tmp_path], builtin=False)
    assert f"{tmp_path / 'requirements.yaml'}:2" in str(caught.value.remedy)


@pytest.mark.of_guest
def test_a_signal_that_the_domain_does_not_compute(tmp_path: Path) -> None:
    file = tmp_path / "requirements.yaml"
    file.write_text(requirement("A", "always (gapp > 0)"))
    (tmp_path / "drive.yaml").write_text(
        scenario("drive", "A").replace("thermostat:Thermostat", "driving")
    )
    with pytest.raises(ConfigurationError) as caught:
        load_library([tmp_path], builtin=False)
    assert str(caught.value).startswith(f"{file}:5: unknown signal 'gapp'")
    assert caught.value.remedy == "did you mean 'gap'?"


def test_an_interval_between_two_ticks(tmp_path: Path) -> None:
    file = tmp_path / "requirements.yaml"
    file.write_text(requirement("A", "always[0.12:0.18] (headroom > 0)"))
    (tmp_path / "room.yaml").write_text(scenario("room", "A"))
    with pytest.raises(ConfigurationError, match="falls between two samples") as caught:
        load_library([tmp_path], builtin=False)
    assert caught.value.key == "requirements.0.check"


@pytest.mark.of_guest
def test_the_built_in_files_load_without_a_warning() -> None:
    library = load_library([])
    assert library.requirements["SAF-1"].check == "always (gap > 0)"
    assert all(one.reason for one in library.requirements.values())
    assert library.warnings == ()


@pytest.mark.of_guest
def test_the_built_in_folder_of_a_wheel_comes_before_a_neighbour_of_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "site-packages" / "pytest_dura"
    inside, beside = package / "scenarios", package.parent / "scenarios"
    monkeypatch.setattr(loading, "__file__", str(package / "campaign" / "loading.py"))
    beside.mkdir(parents=True)
    with pytest.raises(ConfigurationError, match="built-in scenarios are missing"):
        builtin_paths()
    (beside / "scenario.schema.json").write_text("{}")
    assert builtin_paths() == [beside]
    inside.mkdir(parents=True)
    (inside / "scenario.schema.json").write_text("{}")
    assert builtin_paths() == [inside]


def test_select_by_globs() -> None:
    names = ["b/two", "a/one", "b/three"]
    assert select_names(names, []) == ["a/one", "b/three", "b/two"]
    assert select_names(names, ["b/t*"]) == ["b/three", "b/two"]
    assert select_names(names, ["b/two", "a/*"]) == ["a/one", "b/two"]
    with pytest.raises(ConfigurationError) as caught:
        select_names(names, ["a/*", "b/tow"])
    assert caught.value.found == "b/tow"
    assert caught.value.remedy == "did you mean 'b/two'?"


@pytest.mark.of_guest
def test_a_scenario_on_request_is_run_where_a_glob_names_it_and_by_no_default() -> None:
    scenarios = load_library([]).scenarios
    request = "intersection/sudden/"
    assert {name for name, one in scenarios.items() if one.on_request} == {
        name for name in scenarios if name.startswith(request)
    }
    for globs in ([], ["*"], ["intersection/*"], ["*ghost*", "intersection/n*"]):
        cases = expand_cases(scenarios, select=globs)
        assert cases
        assert not any(case.id.startswith(request) for case in cases)
    chosen = expand_cases(scenarios, select=[f"{request}*"])
    assert len(chosen) == 10
    (alone,) = expand_cases([scenarios[chosen[0].id]])
    assert alone.id == chosen[0].id
