"""What an import path may lead to, at the place that every process builds its parts by."""

from __future__ import annotations

import functools
import sys
from typing import Any

import pytest
from thermostat import Controller

from pytest_dura import ConfigurationError, EpisodeSpec, Orchestrator, RoleSpec, factory
from pytest_dura.core import Places, use_places


def plain(episode: Any) -> bool:
    return True


class Tuned(Controller):
    @classmethod
    @factory
    def warm(cls) -> Tuned:
        return cls(25.0)

    @classmethod
    def cold(cls) -> Tuned:
        return cls(5.0)


@pytest.fixture
def installed(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A folder of installed packages, with one module."""
    folder = tmp_path / "site-packages"
    folder.mkdir()
    (folder / "measured.py").write_text(
        "from pytest_dura import Generator\n"
        "def fine(episode): return True\n"
        "class Planner(Generator):\n"
        "    def propose(self, view): return None\n"
    )
    monkeypatch.syspath_prepend(folder)
    before = use_places(Places())
    yield folder
    sys.modules.pop("measured", None)
    use_places(before)


@pytest.mark.parametrize(
    "path", ["os:system", "builtins:dict", "test_trusted_paths:plain", "numpy:zeros"]
)
def test_a_spec_from_another_process_builds_parts_only(path: str) -> None:
    data = EpisodeSpec("a/b", 0, 0, RoleSpec(path, {"command": "exit 3"}), {}).to_json()
    with pytest.raises(ConfigurationError):
        Orchestrator.build(EpisodeSpec.from_json(data))


def test_a_factory_may_be_a_method() -> None:
    assert RoleSpec("test_trusted_paths:Tuned.warm").create().target == 25.0
    with pytest.raises(ConfigurationError, match="neither a class nor a factory"):
        RoleSpec("test_trusted_paths:Tuned.cold").create()


def test_functions_of_an_installed_package_have_to_be_offered(installed: Any) -> None:
    assert RoleSpec("measured:Planner").create() is not None
    with pytest.raises(ConfigurationError, match="is no function of this project"):
        RoleSpec("measured:fine").function()


def test_an_installed_package_offers_its_functions_by_an_entry_point(installed: Any) -> None:
    (installed / "measured-1.dist-info").mkdir()
    (installed / "measured-1.dist-info/METADATA").write_text("Name: measured\nVersion: 1\n")
    (installed / "measured-1.dist-info/entry_points.txt").write_text(
        "[pytest_dura]\nmeasured = measured\n"
    )
    assert RoleSpec("measured:fine").function()(None) is True


def test_a_function_is_known_by_where_it_is_defined() -> None:
    assert RoleSpec("test_trusted_paths:plain").function() is plain
    with pytest.raises(ConfigurationError, match="is no function of this project"):
        RoleSpec("test_trusted_paths:functools.reduce").function()
    assert functools.reduce is not None


def test_of_two_folders_the_inner_one_counts(tmp_path: Any) -> None:
    project, bundle = tmp_path / "project", tmp_path / "project/bundle"
    places = Places((project,), (tmp_path, bundle))
    assert places.foreign_folder(project / "a.py") is None
    assert places.foreign_folder(bundle / "a.py") == bundle
    assert places.foreign_folder(tmp_path / "a.py") == tmp_path
    assert places.foreign_folder(tmp_path.parent / "a.py") is None
    assert Places((project,), (project,)).foreign_folder(project / "a.py") == project
