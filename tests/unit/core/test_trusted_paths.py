"""What an import path may lead to, at the place that every process builds its parts by."""

from __future__ import annotations

import builtins
import functools
import importlib
import sys
import zipfile
from collections.abc import Callable, Iterator
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import spec_from_file_location
from pathlib import Path
from typing import Any

import pytest
from thermostat import Controller

from pytest_dura import ConfigurationError, EpisodeSpec, Orchestrator, RoleSpec, factory
from pytest_dura.core import Places, use_places
from pytest_dura.core.trust import check_import, check_registered, source_of


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
    for is_loaded in (False, True):
        assert ("measured" in sys.modules) == is_loaded
        with pytest.raises(ConfigurationError, match="is no function of this project"):
            RoleSpec("measured:fine").function()
        assert RoleSpec("measured:Planner").create() is not None


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


MARK = "import builtins\nbuiltins.imported.append(__name__)\n"
CLASS = "from pytest_dura import Generator\nclass Planner(Generator):\n def propose(self, v): ...\n"


@pytest.fixture
def ran(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Names of the modules that ran: of a project in the working directory, with a bundle in it."""
    modules: list[str] = []
    monkeypatch.setattr(builtins, "imported", modules, raising=False)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("bundle/", "bundle/part/", "mine/sub/", "regular/", "elsewhere/"):
        (tmp_path / name).mkdir(parents=True, exist_ok=True)
        (tmp_path / name / "code.py").write_text(MARK + CLASS)
    (tmp_path / "regular/__init__.py").write_text(MARK)
    before, known = use_places(Places.of([tmp_path], [tmp_path / "bundle"])), set(sys.modules)
    yield modules
    use_places(before)
    for name in set(sys.modules) - known:
        if name.partition(".")[0] in ("bundle", "mine", "regular", "extended", "elsewhere"):
            del sys.modules[name]


def _link(place: str, target: str) -> Callable[[Path], None]:
    return lambda folder: (folder / place).symlink_to(folder / target)


def _package(place: str, text: str = MARK) -> Callable[[Path], None]:
    return lambda folder: (folder / place / "__init__.py").write_text(text) and None


def _extended(folder: Path) -> None:
    (folder / "extended").mkdir()
    text = f"{MARK}__path__.append({str(folder / 'bundle')!r})\n"
    (folder / "extended/__init__.py").write_text(text)


def _archived(folder: Path) -> None:
    with zipfile.ZipFile(folder / "bundle/code.zip", "w") as archive:
        archive.writestr("zipped/__init__.py", MARK)
        archive.writestr("zipped/code.py", MARK + CLASS)
    sys.path.insert(0, str(folder / "bundle/code.zip"))


STRANGE = {
    "a folder without code": ("bundle.code", None),
    "a folder in one": ("bundle.part.code", None),
    "a package that would run first": ("bundle.missing", _package("bundle")),
    "a link out of it": ("bundle.linked.code", _link("bundle/linked", "elsewhere")),
    "a link into it": ("mine.linked.code", _link("mine/linked", "bundle/part")),
    "a file linked into it": ("mine.linked", _link("mine/linked.py", "bundle/code.py")),
    "an archive": ("zipped.code", _archived),
}


@pytest.mark.parametrize("case", STRANGE)
def test_a_module_counts_by_the_file_that_it_would_come_from(
    ran: list[str], tmp_path: Any, case: str
) -> None:
    module, prepare = STRANGE[case]
    if prepare is not None:
        prepare(tmp_path)
    importlib.invalidate_caches()
    with pytest.raises(ConfigurationError, match="beside files that name it"):
        RoleSpec(f"{module}:Planner").create()
    assert not ran


def test_what_a_package_does_to_its_path_counts_too(ran: list[str], tmp_path: Any) -> None:
    _extended(tmp_path)
    with pytest.raises(ConfigurationError, match="beside files that name it"):
        RoleSpec("extended.code:Planner").create()
    assert ran == ["extended"]


def test_modules_of_the_project_are_found_in_folders_and_packages(ran: list[str]) -> None:
    for module in ("mine.sub.code", "regular.code"):
        check_import(f"{module}:Planner")
        assert source_of(module) == Path(*module.split(".")).with_suffix(".py").absolute()
    assert not ran
    for module in ("mine.sub.code", "regular.code"):
        assert RoleSpec(f"{module}:Planner").create() is not None
    assert ran == ["mine.sub.code", "regular", "regular.code"]


def test_of_two_places_the_one_that_python_takes_counts(
    ran: list[str], tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A package whose folders lie in the project and in the bundle, as PEP 420 lets them."""
    (tmp_path / "bundle/mine").mkdir()
    (tmp_path / "bundle/mine/stranger.py").write_text(MARK + CLASS)
    monkeypatch.syspath_prepend(tmp_path / "bundle")
    assert RoleSpec("mine.sub.code:Planner").create() is not None
    with pytest.raises(ConfigurationError, match="beside files that name it"):
        RoleSpec("mine.stranger:Planner").create()
    assert ran == ["mine.sub.code"]


class EditableFinder:
    """As editable installs put one on ``sys.meta_path``: a package in a folder of another name."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        if name == "extended":
            file = self.folder / "__init__.py"
            return spec_from_file_location(
                name, file, submodule_search_locations=[str(self.folder)]
            )
        return PathFinder.find_spec(name, path) if name.startswith("extended.") else None


@pytest.mark.parametrize("folder", ["regular", "bundle"])
def test_a_package_of_an_editable_install_counts_by_its_files(
    ran: list[str], tmp_path: Any, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    (tmp_path / folder / "__init__.py").write_text(MARK)
    (tmp_path / folder / "inner").mkdir()
    (tmp_path / folder / "inner/code.py").write_text(MARK + CLASS)
    monkeypatch.setattr(sys, "meta_path", [EditableFinder(tmp_path / folder), *sys.meta_path])
    assert source_of("extended.inner.code") == tmp_path / folder / "inner/code.py"
    if folder == "bundle":
        with pytest.raises(ConfigurationError, match="beside files that name it"):
            RoleSpec("extended.inner.code:Planner").create()
        assert not ran
    else:
        assert RoleSpec("extended.inner.code:Planner").create() is not None
        assert ran == ["extended", "extended.inner.code"]


def test_a_folder_of_packages_registers_nothing_for_all_of_them(
    installed: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("known", "unknown"):
        (installed / "vendor" / name).mkdir(parents=True)
        (installed / "vendor" / name / "__init__.py").write_text(CLASS)
    (installed / "vendor_known-1.dist-info").mkdir()
    (installed / "vendor_known-1.dist-info/METADATA").write_text("Name: vendor-known\nVersion: 1\n")
    (installed / "vendor_known-1.dist-info/entry_points.txt").write_text(
        "[pytest_dura.roles]\nvendor-known = vendor.known:Planner\n"
    )
    check_registered("vendor.known:Planner")
    with pytest.raises(ConfigurationError, match="registers nothing for pytest-dura"):
        check_registered("vendor.unknown:Planner")
    assert "vendor" not in sys.modules


def test_of_two_folders_the_inner_one_counts(tmp_path: Any) -> None:
    project, bundle = tmp_path / "project", tmp_path / "project/bundle"
    places = Places((project,), (tmp_path, bundle))
    assert places.foreign_folder(project / "a.py") is None
    assert places.foreign_folder(bundle / "a.py") == bundle
    assert places.foreign_folder(tmp_path / "a.py") == tmp_path
    assert places.foreign_folder(tmp_path.parent / "a.py") is None
    assert Places((project,), (project,)).foreign_folder(project / "a.py") == project
