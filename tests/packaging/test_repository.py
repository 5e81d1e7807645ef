"""What holds for the repository as a whole."""

from __future__ import annotations

import ast
import importlib
import os
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

import pytest

import pytest_dura

REPOSITORY = Path(__file__).parents[2]
REGISTRIES = [r"pypi\.org", r"pythonhosted\.org", r"anaconda\.org", r"conda\.io"]
ABSOLUTE_PATH = re.compile(r"(?<![\w.~}])/(?:work|root|home|Users|opt|tmp/w)/")


def run(*command: str | Path, cwd: Path = REPOSITORY) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        list(map(str, command)), cwd=cwd, capture_output=True, text=True, check=False, timeout=120
    )


def repository_texts() -> dict[str, str]:
    """Every text file that is or could be committed, by name."""
    listed = run("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard")
    if listed.returncode != 0:
        pytest.skip("this is no git working tree")
    texts = {}
    for name in filter(None, listed.stdout.split("\0")):
        file = REPOSITORY / name
        if file.is_file() and b"\0" not in (content := file.read_bytes()):
            texts[name] = content.decode()
    return texts


def registry_hosts() -> list[str]:
    """Patterns of well-known registries and of those that pip is configured to use here."""
    configured = run(sys.executable, "-m", "pip", "config", "list").stdout
    configured += "\n".join(value for name, value in os.environ.items() if name.startswith("PIP_"))
    urls = re.findall(r"https?://[^\s'\",]+", configured)
    hosts = {host for url in urls if (host := urlsplit(url).hostname)}
    return [*REGISTRIES, *map(re.escape, sorted(hosts - {"localhost", "127.0.0.1"}))]


def hits(pattern: re.Pattern[str]) -> list[str]:
    return [
        f"{name}:{number}: {line.strip()}"
        for name, text in repository_texts().items()
        for number, line in enumerate(text.splitlines(), 1)
        if pattern.search(line)
    ]


def test_no_file_names_a_registry() -> None:
    assert not hits(re.compile("|".join(registry_hosts()), re.IGNORECASE))


def test_no_file_names_a_path_of_one_machine() -> None:
    assert not hits(ABSOLUTE_PATH)


def test_the_searches_find_registries_and_absolute_paths(monkeypatch) -> None:
    monkeypatch.setenv("PIP_INDEX_URL", "https://user:secret@mirror.example:8443/simple")
    registry = re.compile("|".join(registry_hosts()), re.IGNORECASE)
    for host in ("pypi{}org".format("."), "files.python{}.org".format("hosted"), "mirror.example"):
        assert registry.search(f"index-url = https://{host}/simple")
    for folder in ("work", "root", "home", "Users"):
        path = f"/{folder}/somebody/project"
        assert ABSOLUTE_PATH.search(f'ROOT = "{path}"')
        assert not ABSOLUTE_PATH.search(f"frame{path}")
        assert not ABSOLUTE_PATH.search(f"..{path}")


def test_every_public_name_of_the_stub_can_be_imported() -> None:
    stub = ast.parse(Path(pytest_dura.__file__).with_suffix(".pyi").read_text())
    homes = {
        alias.name: f"pytest_dura.{node.module}"
        for node in stub.body
        if isinstance(node, ast.ImportFrom) and node.level
        for alias in node.names
    }
    assert {*homes, "__version__"} == set(pytest_dura.__all__) == set(dir(pytest_dura))
    for name, module in homes.items():
        assert getattr(pytest_dura, name) is getattr(importlib.import_module(module), name)


def test_an_unknown_public_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="'pytest_dura' has no attribute 'Generater'"):
        _ = pytest_dura.Generater


def test_type_checkers_see_the_public_names(tmp_path) -> None:
    names = ", ".join(name for name in pytest_dura.__all__ if name != "__version__")
    lines = [f"from pytest_dura import {names}", "reveal_type(RoleSpec)", "reveal_type(stream)"]
    file = tmp_path / "uses_them.py"
    file.write_text("\n".join(lines))
    settings = ["--strict", "--follow-imports=silent", "--config-file", "pyproject.toml"]
    done = run(sys.executable, "-m", "mypy", *settings, file)
    assert done.returncode == 0, done.stdout + done.stderr
    assert '"def (path: str' in done.stdout
    assert '"def (seed: int, name: str' in done.stdout


def test_a_public_name_loads_no_more_than_it_needs() -> None:
    code = (
        "import sys\n"
        "from pytest_dura import ConfigurationError\n"
        "assert 'numpy' not in sys.modules\n"
        "from pytest_dura import EpisodeSpec, Generator, Orchestrator, check_role\n"
        "assert not {'pydantic', 'yaml', 'highway_env', 'scipy'} & set(sys.modules)\n"
    )
    done = run(sys.executable, "-c", code)
    assert done.returncode == 0, done.stderr


def anchors(page: str) -> set[str]:
    titles = re.findall(r"^#+ (.*)$", page, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", "-") for title in titles}


def test_every_link_of_the_documentation_leads_somewhere() -> None:
    pages = {name: text for name, text in repository_texts().items() if name.endswith(".md")}
    broken = []
    for name, text in pages.items():
        prose = re.sub(r"```.*?```|`[^`\n]*`", "code", text, flags=re.DOTALL)
        for link in re.findall(r"\]\(([^)\s]+)\)", prose):
            file, _, anchor = link.partition("#")
            if urlsplit(link).scheme:
                continue
            # A fragment of the changelog becomes a part of CHANGELOG.md.
            folder = REPOSITORY if "/+" in name else (REPOSITORY / name).parent
            target = folder.joinpath(file).resolve() if file else REPOSITORY / name
            there = target.exists()
            if there and anchor and target.suffix == ".md":
                there = anchor in anchors(target.read_text("utf-8"))
            if not there:
                broken.append(f"{name}: {link}")
    assert not broken
    assert len(pages) > 20
