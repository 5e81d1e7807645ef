"""A project to begin with: planner, scenario, requirement and CI file, written into a folder."""

from __future__ import annotations

import re
from pathlib import Path
from string import Template

from pytest_dura import __version__
from pytest_dura.core.errors import ConfigurationError

_TEMPLATE = Path(__file__).with_name("project_template")
_OF_A_DOMAIN = Path(__file__).with_name("project_template_domain")
_FOR_EACH = ("dot_github/workflows/dura.yml.in", "dot_gitignore.in")
"""Files of the template that are the same for a system of one's own."""
_SUFFIX = ".in"
"""Ending of the template's files, so that no tool takes them for files of this package."""
_HIDDEN = "dot_"
"""Prefix of a file or folder whose name begins with a dot in the project."""


def write_project(directory: Path, *, own_domain: bool = False) -> list[Path]:
    """Write a project that `pytest` finds green, and return its files, relative to the directory.

    Args:
        directory: A new or an empty one.
        own_domain: Whether it is about a system of its own, with simulator and domain, in place of
            a car at the built-in junction.

    Raises:
        ConfigurationError: If the directory holds anything, is a file, or cannot be written.
    """
    try:
        _refuse_used(directory)
        # A link's own name is what the user calls the project.
        name = _project_name(directory.absolute().name)
        files = _render(name, own_domain=own_domain)
        for file, text in files.items():
            target = directory / file
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(text, "utf-8")
    except OSError as error:
        raise ConfigurationError(
            f"the project cannot be written: {error.strerror}",
            file=str(directory),
            remedy="name a directory that can be made, or is empty",
        ) from None
    return list(files)


def _refuse_used(directory: Path) -> None:
    if not directory.exists():
        return
    held = sorted(file.name for file in directory.iterdir())
    if held:
        raise ConfigurationError(
            "this directory is not empty, and a project is not mixed with what is there",
            file=str(directory),
            found=", ".join(held[:3]) + (", ..." if len(held) > len(held[:3]) else ""),
            expected="an empty directory, or a name that is free",
            remedy="name another one",
        )


def _render(name: str, *, own_domain: bool) -> dict[Path, str]:
    """Texts of all files of a project of this name, by their paths in it."""
    texts = {}
    home = _OF_A_DOMAIN if own_domain else _TEMPLATE
    sources = [(home, file) for file in sorted(home.rglob(f"*{_SUFFIX}"))]
    sources += [(_TEMPLATE, _TEMPLATE / each) for each in _FOR_EACH if own_domain]
    for folder, source in sources:
        parts = source.relative_to(folder).with_suffix("").parts
        file = Path(*(re.sub(f"^{_HIDDEN}", ".", part) for part in parts))
        template = Template(source.read_text("utf-8"))
        texts[file] = template.substitute(name=name, version=__version__)
    return texts


def _project_name(folder: str) -> str:
    """Name of a distribution for a folder: ASCII letters, digits and single hyphens."""
    return re.sub(r"[^a-z0-9]+", "-", folder.lower()).strip("-") or "crossing"
