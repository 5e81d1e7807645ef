"""What a release consists of: metadata, the README of the index, changelog and fragments."""

from __future__ import annotations

import email
import re
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest
import yaml

REPOSITORY = Path(__file__).parents[2]
FRAGMENT = re.compile(r"\+[\w.-]+\.(changed|added|deprecated|removed|fixed)\.md")


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=cwd, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip


def build(tree: Path, folder: Path) -> Path:
    done = run("build", "--wheel", "--no-isolation", "--outdir", str(folder), str(tree), cwd=tree)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = folder.glob("*.whl")
    return wheel


def described(wheel: Path) -> email.message.Message:
    """The metadata of a wheel, with the README as payload."""
    with ZipFile(wheel) as opened:
        (name,) = (name for name in opened.namelist() if name.endswith("/METADATA"))
        return email.message_from_string(opened.read(name).decode())


def test_the_index_accepts_what_is_built(wheel):
    done = run("twine", "check", "--strict", str(wheel), cwd=wheel.parent)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "PASSED" in done.stdout
    metadata = described(wheel)
    keys = ("Name", "Version", "Summary", "Author", "License-Expression", "Keywords")
    assert all(metadata[key] for key in keys)
    assert metadata["Requires-Python"] == ">=3.10"


def test_the_readme_of_the_index_has_no_link_that_leads_nowhere(wheel):
    text = described(wheel).get_payload()
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    assert "What it does not do" in prose
    assert not re.findall(r"\]\((?!https?://)[^)]*\)", prose)
    assert "| test a language model | `docs/llm.md`" in prose
    assert "in the source distribution, with their pictures" in prose
    # What is printed as a command stays as it is.
    readme = (REPOSITORY / "README.md").read_text("utf-8")
    fences = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
    assert fences.findall(text) == fences.findall(readme)


def test_with_a_home_pictures_and_links_are_absolute(tmp_path):
    tree = tmp_path / "tree"
    (tree / "pytest_dura").mkdir(parents=True)
    shutil.copytree(REPOSITORY / "scenarios", tree / "scenarios")
    shutil.copy(REPOSITORY / "pytest_dura" / "__init__.py", tree / "pytest_dura")
    for name in ("hatch_build.py", "LICENSE"):
        shutil.copy(REPOSITORY / name, tree)
    settings = (REPOSITORY / "pyproject.toml").read_text()
    assert settings.count('home = ""') == 1
    home = settings.replace('home = ""', 'home = "https://forge.example/raw/"')
    (tree / "pyproject.toml").write_text(home)
    (tree / "README.md").write_text(
        "![A view](docs/a.png)\n\n"
        "See [it](docs/it.md#here), [there](https://else.example), [below](#b)\n"
        "```\n[as](printed)\n```\n"
    )
    assert described(build(tree, tmp_path)).get_payload().strip() == (
        "![A view](https://forge.example/raw/docs/a.png)\n\n"
        "See [it](https://forge.example/raw/docs/it.md#here), [there](https://else.example), "
        "[below](#b)\n```\n[as](printed)\n```"
    )


def test_every_fragment_has_a_name_that_towncrier_takes():
    folder = REPOSITORY / "changelog.d"
    names = {file.name for file in folder.iterdir()} - {"README.md"}
    assert not [name for name in names if not FRAGMENT.fullmatch(name)]
    page = (folder / "README.md").read_text()
    assert set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == set(
        FRAGMENT.pattern.partition("(")[2].partition(")")[0].split("|")
    )


def test_a_release_gathers_the_fragments_above_what_was_released(tmp_path):
    for name in ("pyproject.toml", "CHANGELOG.md"):
        shutil.copy(REPOSITORY / name, tmp_path)
    (tmp_path / "changelog.d").mkdir()
    shutil.copy(REPOSITORY / "changelog.d" / "README.md", tmp_path / "changelog.d")
    (tmp_path / "changelog.d" / "+gap.changed.md").write_text("A gap is longer.\n")
    (tmp_path / "changelog.d" / "+gap.fixed.md").write_text("A gap is never negative.\n")
    given = ["--yes", "--version=7.8.9", "--date=2030-01-02"]
    done = run("towncrier", "build", *given, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    text = (tmp_path / "CHANGELOG.md").read_text()
    before = (REPOSITORY / "CHANGELOG.md").read_text()
    start = "<!-- towncrier release notes start -->\n\n"
    intro, rest = before.split(start)
    assert text.startswith(intro + start + "## 7.8.9 (2030-01-02)\n")
    assert text.endswith(rest)
    made = text.removeprefix(intro + start).removesuffix(rest)
    changed, fixed = made.split("### Fixed")
    assert "### Changed: what you may have to do something about\n\n- A gap is longer." in changed
    assert fixed.strip() == "- A gap is never negative."
    assert [file.name for file in (tmp_path / "changelog.d").iterdir()] == ["README.md"]


def test_the_changelog_says_nothing_twice():
    text = (REPOSITORY / "CHANGELOG.md").read_text("utf-8")
    entries = [entry for entry in re.split(r"^(?=- |#)", text, flags=re.MULTILINE) if entry.strip()]
    assert len(entries) == len(set(entries)) > 100


@pytest.mark.parametrize(
    "subject, taken",
    [
        ("docs: say what a bound is", True),
        ("llm, plugin: name what the model was asked", True),
        ("evidence!: rename a key, so that baselines are made anew", True),
        ("`verify`: name the file that no bundle has", True),
        ("Merge branch 'main' into other", True),
        ('Revert "docs: say what a bound is"', True),
        ("Fixed things", False),
        ("docs: Say what a bound is.", False),
        ("docs: ", False),
        ("docs: say " + "more " * 30, False),
    ],
)
def test_the_subject_of_a_commit_is_checked(tmp_path, subject, taken):
    (repo,) = yaml.safe_load((REPOSITORY / ".pre-commit-config.yaml").read_text())["repos"]
    (hook,) = (hook for hook in repo["hooks"] if hook["id"] == "subject")
    assert (hook["language"], hook["stages"]) == ("pygrep", ["commit-msg"])
    assert hook["args"] == ["--negate", "--multiline"]  # fails where the pattern is not found
    message = tmp_path / "message"
    message.write_text(f"{subject}\n\nA body: With capitals.\n")
    assert bool(re.search(hook["entry"], message.read_text(), re.MULTILINE | re.DOTALL)) is taken
