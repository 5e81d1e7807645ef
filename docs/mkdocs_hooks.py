"""Hooks of mkdocs: what the site has beside the pages of this folder.

- Links out of ``docs`` lead to a page of the site that shows the file or the folder.
- GitHub's dialect of Markdown, in which the pages are written, becomes that of Python-Markdown.

``mkdocs.yml`` names this module; ``mkdocs build --strict`` runs it.
"""  # noqa: INP001 - hooks, no package

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
REPOSITORY = "repository"
"""Folder of the site with the files of the repository that pages link to."""
CODE = re.compile(r"^(?P<fence>```+|~~~+).*?^(?P=fence)\s*$|`[^`\n]+`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(!?\[(?:[^\[\]]|\[[^\[\]]*\])*\])\(([^)\s]+)\)")
LANGUAGES = {".py": "python", ".yaml": "yaml", ".json": "json", ".toml": "toml", ".cff": "yaml"}
ALWAYS = ("CHANGELOG.md", "CONTRIBUTING.md")
"""Files of the repository that the navigation names."""


def outside_code(text: str) -> Iterator[re.Match[str]]:
    """Yield the links of a page that stand in no code."""
    hidden = CODE.sub(lambda match: " " * len(match[0]), text)
    # A label may hold code; its brackets are balanced either way.
    for match in LINK.finditer(text):
        if hidden[match.start(2)] != " ":
            yield match


def repository_path(source: str, link: str) -> str | None:
    """Return what of the repository a link of the page ``docs/source`` means, if not in ``docs``.

    Raises:
        PluginError: If it leads out of the repository, or nowhere.
    """
    file = link.partition("#")[0]
    if not file or urlsplit(link).scheme:
        return None
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source), file))
    if path == "docs" or path.startswith("docs/"):
        return None
    if path.startswith("..") or not (ROOT / path).exists():
        raise PluginError(f"{source}: the link {link} leads nowhere")
    return path


def page_of(path: str) -> str:
    """Return the page that shows a file of the repository, or a folder; a README shows its folder.

    No page is named like an index, which the navigation would take for that of a section.
    """
    if path.endswith("/README.md"):
        return f"{REPOSITORY}/{posixpath.dirname(path)}.md"
    stem = path.removesuffix(".md") if path != "README.md" else "readme"
    return f"{REPOSITORY}/{stem}.md"


HOMES: dict[str, str] = {}
"""File of the repository by the page that shows it; of a folder that is its README."""


def shown(path: str) -> str:
    """Return the Markdown that shows a file, or a folder by the list of its files."""
    place = ROOT / path
    if place.is_file() and place.suffix != ".md":
        return (
            f"# `{path}`\n\n{fenced(place.read_text('utf-8'), LANGUAGES.get(place.suffix, ''))}\n"
        )
    if place.is_file():
        return place.read_text("utf-8")
    names = [
        str(file.relative_to(place))
        for file in sorted(place.rglob("*"))
        if file.is_file() and not re.search(r"/(\.|__pycache__|[^/]*\.egg-info/)", str(file))
    ]
    return f"# `{path}`\n\n{fenced(chr(10).join(names))}\n"


def fenced(text: str, language: str = "") -> str:
    """Return text as a block of code, whatever fences stand in it."""
    fence = "`" * max(3, 1 + max(map(len, re.findall("`+", text)), default=0))
    return f"{fence}{language}\n{text.rstrip()}\n{fence}"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for each file of the repository that a page links to."""
    linked = set(ALWAYS)
    for file in files.documentation_pages():
        source = f"docs/{file.src_uri}"
        linked |= {
            path
            for match in outside_code(file.content_string)
            if (path := repository_path(source, match[2]))
        }
    HOMES.clear()
    for path in sorted(linked):
        place = ROOT / path
        readme = place.is_dir() and (place / "README.md").is_file()
        HOMES[page_of(path)] = f"{path}/README.md" if readme else path
    for page, path in HOMES.items():
        files.append(File.generated(config, page, content=shown(path)))
    return files


def on_page_markdown(markdown: str, page: Page, files: Files, **_: Any) -> str:
    """Lead links of a page to where their targets are on the site, and mend the dialect."""
    source = page.file.src_uri
    return in_python_markdown(with_links(markdown, source, files))


ROLE = re.compile(r":(?:attr|class|const|data|exc|func|meth|mod):(?=<code>)")


def on_page_content(html: str, **_: Any) -> str:
    """Leave out the roles of Sphinx in docstrings, such as ``:func:``, which nothing reads here."""
    return ROLE.sub("", html)


def with_links(markdown: str, source: str, files: Files) -> str:
    """Rewrite the links between ``docs`` and the rest of the repository.

    A page of ``docs`` has a page for whatever it links to. What a file of the repository links to
    is a page of the site or, where there is none, stands as text.
    """
    foreign = source in HOMES
    home = HOMES[source] if foreign else f"docs/{source}"
    parts, at = [], 0
    for match in outside_code(markdown):
        link = match[2]
        if urlsplit(link).scheme or link.startswith("#"):
            continue
        path, hash_, anchor = link.partition("#")
        target = posixpath.normpath(posixpath.join(posixpath.dirname(home), path))
        if not foreign and target.startswith("docs/"):
            continue
        there = target.removeprefix("docs/") if target.startswith("docs/") else page_of(target)
        parts.append(markdown[at : match.start()])
        at = match.end()
        if files.get_file_from_path(there):
            way = posixpath.relpath(there, posixpath.dirname(source) or ".")
            parts.append(f"{match[1]}({way}{hash_}{anchor})")
        else:
            parts.append(match[1].lstrip("!")[1:-1])
    return "".join([*parts, markdown[at:]])


def in_python_markdown(markdown: str) -> str:
    """Mend what Python-Markdown reads otherwise: an escaped bar in the code of a table."""
    lines = []
    for line in markdown.splitlines():
        mended = line
        if line.startswith("|") and "\\|" in line:
            mended = re.sub(r"`[^`]+`", lambda code: code[0].replace("\\|", "|"), line)
        lines.append(mended)
    return "\n".join([*lines, ""])
