"""The documentation site: it builds without a warning, and every link of it leads somewhere."""

from __future__ import annotations

import functools
import http.server
import os
import re
import subprocess
import sys
import threading
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urljoin, urlsplit

import pytest
from filelock import FileLock

import pytest_dura

REPOSITORY = Path(__file__).parents[2]
LOADED = {"script", "img", "iframe", "source", "video", "audio", "embed", "object"}
"""Elements that a browser loads something for; ``link`` does for some of its relations."""
PLACE = "https://site.invalid/"


class Page(HTMLParser):
    """Ids, links and loaded files of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids, self.links, self.loads = set(), [], []
        self.counts = Counter()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.ids |= {given[key] for key in ("id", "name") if given.get(key)}
        if tag == "article":
            self.counts.clear()  # what comes before is navigation
        self.counts[tag] += 1
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        elif tag == "link" and given.get("rel") not in ("canonical", "next", "prev"):
            self.loads.append(given["href"])
        elif tag in LOADED and given.get("src"):
            self.loads.append(given["src"])


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """The built site; with pytest-xdist one worker builds it for all."""
    pytest.importorskip("material", reason="the extra `docs` is not installed")
    common = tmp_path_factory.getbasetemp()
    common = common.parent if common.name.startswith("popen-") else common
    folder = common / "site"
    with FileLock(common / "site.lock"):
        if not folder.exists():
            done = build(folder)
            assert done.returncode == 0, done.stderr
            assert "WARNING -" not in done.stderr
    return folder


def build(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder), *options],
        cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=300,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},  # an announcement, of no page of ours
    )  # fmt: skip


@pytest.fixture(scope="session")
def pages(site):
    """Each page by its path, such as ``driving/index.html``."""
    return {
        file.relative_to(site).as_posix(): Page(file.read_text("utf-8"))
        for file in sorted(site.rglob("*.html"))
    }


def broken_links(site: Path, pages: dict[str, Page]) -> list[str]:
    """Links within the site that lead to no file, or to no place in a page."""
    broken = []
    for name, page in pages.items():
        for link in [*page.links, *page.loads]:
            there = urlsplit(urljoin(PLACE + name, link))
            if there.scheme not in ("http", "https") or there.netloc != urlsplit(PLACE).netloc:
                continue
            path = unquote(there.path).lstrip("/")
            file = path + "index.html" if path == "" or path.endswith("/") else path
            target = pages.get(file)
            missing = not (site / file).is_file()
            if missing or (there.fragment and target and unquote(there.fragment) not in target.ids):
                broken.append(f"{name}: {link}")
    return broken


def test_no_link_and_no_anchor_of_the_site_is_broken(site, pages):
    assert len(pages) > 60
    assert sum(len(page.links) for page in pages.values()) > 5000
    assert broken_links(site, pages) == []


def test_a_broken_link_and_a_broken_anchor_are_seen(tmp_path):
    (tmp_path / "index.html").write_text("")
    page = Page('<h1 id="a"></h1><a href="#a"></a><a href="#b"></a><img src="no.png"><a href="x/">')
    broken = broken_links(tmp_path, {"index.html": page})
    assert broken == ["index.html: #b", "index.html: x/", "index.html: no.png"]


def test_the_build_refuses_a_link_that_leads_nowhere(site, tmp_path):
    page = REPOSITORY / "docs" / "formulas.md"
    text = (REPOSITORY / "mkdocs.yml").read_text("utf-8")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text(
        page.read_text("utf-8") + "\n[x](index.md#nowhere)\n"
    )
    head = text[: text.index("nav:\n")].replace(
        "docs_dir: docs\n", "docs_dir: docs\nnav: [index.md]\n"
    )
    head = re.sub(r"^(hooks|extra_css): .*\n", "", head, flags=re.MULTILINE)
    (tmp_path / "mkdocs.yml").write_text(head)
    done = build(tmp_path / "out", "--config-file", str(tmp_path / "mkdocs.yml"))
    assert done.returncode == 1
    assert "index.md#nowhere" in done.stderr or "#nowhere" in done.stderr


def test_nothing_is_loaded_from_elsewhere(pages):
    elsewhere = {load for page in pages.values() for load in page.loads if urlsplit(load).netloc}
    assert elsewhere == set()


def test_no_markup_of_another_language_is_shown(site):
    text = (site / "reference" / "api" / "index.html").read_text("utf-8")
    assert re.findall(r":[a-z]+:<code>|:[a-z]+:`|^:::.*", text, re.MULTILINE) == []


def test_every_public_name_has_its_place(pages):
    ids = pages["reference/api/index.html"].ids
    names = set(pytest_dura.__all__) - {"__version__"}
    missing = {name for name in names if not any(place.endswith(f".{name}") for place in ids)}
    assert missing == set()


def test_the_site_shows_what_github_shows(pages):
    """Python-Markdown reads some lists, tables and fences otherwise, or as plain text."""
    markdown_it = pytest.importorskip("markdown_it")
    reader = markdown_it.MarkdownIt("commonmark").enable("table")
    differing = []
    for source in sorted((REPOSITORY / "docs").rglob("*.md")):
        name = source.relative_to(REPOSITORY / "docs").with_suffix("")
        if name.as_posix() == "reference/api":  # filled in by mkdocstrings
            continue
        name = name.parent if name.name == "index" else name
        built = pages[(name / "index.html").as_posix()]
        expected = Page(reader.render(source.read_text("utf-8")))
        differing += [
            f"{source.name}: {built.counts[tag]} <{tag}>, expected {expected.counts[tag]}"
            for tag in ("ul", "ol", "li", "table", "td", "pre", "h2", "h3", "strong", "img")
            if built.counts[tag] != expected.counts[tag]
        ]
    assert differing == []


@pytest.fixture
def served(site):
    """Address of the site, on this machine."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            """Say nothing."""

    handler = functools.partial(Quiet, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("width", [390, 1400])
def test_no_page_is_wider_than_its_window(browser, served, pages, width):
    """Scripts are off: they only decorate, and starting the search takes most of the time."""
    size = {"width": width, "height": 800}
    context = browser.new_context(viewport=size, java_script_enabled=False)
    page = context.new_page()
    wide = []
    for name in pages:
        page.goto(f"{served}/{name}")
        if page.evaluate("document.documentElement.scrollWidth > window.innerWidth"):
            wide.append(name)
    context.close()
    assert wide == []


def test_a_page_with_its_scripts_asks_for_nothing_elsewhere(browser, served):
    context = browser.new_context(viewport={"width": 390, "height": 800})
    asked, problems = [], []
    context.on("request", lambda request: asked.append(request.url))
    page = context.new_page()
    page.on("pageerror", lambda error: problems.append(str(error)))
    for name in (
        "index.html",
        "options/index.html",
        "paper/index.html",
        "reference/api/index.html",
    ):
        page.goto(f"{served}/{name}", wait_until="networkidle")
        assert not page.evaluate("document.documentElement.scrollWidth > window.innerWidth")
    context.close()
    assert problems == []
    assert len(asked) > 8
    assert [url for url in asked if not url.startswith((served, "data:"))] == []
