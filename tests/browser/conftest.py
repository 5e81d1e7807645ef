"""A real browser, without a network, in which an error of a page is an error of the test."""

from __future__ import annotations

import pytest
from chromium import absent


@pytest.fixture(scope="session")
def axe():
    """What looks for barriers in a page."""
    try:
        from axe_playwright_python.sync_playwright import Axe
    except ImportError:
        absent("axe-playwright-python is not installed")
    return Axe()


class Opened:
    """Opens texts of pages, and remembers what went wrong in them.

    ``expected`` holds parts of messages that a test provokes on purpose.
    """

    def __init__(self, browser, folder):
        self.browser, self.folder = browser, folder
        self.contexts, self.problems, self.expected = [], [], []

    def __call__(self, html, *, script=None, clock=False, **options):
        """A page of this text, as from a file.

        Args:
            html: The page.
            script: What runs before its own scripts.
            clock: Whether its time stands still but for ``page.clock.run_for``.
            options: Of the browser's context, such as ``viewport`` and ``color_scheme``.
        """
        context = self.browser.new_context(**options)
        context.set_default_timeout(5000)
        self.contexts.append(context)
        context.route("**/*", self._route)
        if script:
            context.add_init_script(script)
        page = context.new_page()
        page.on("pageerror", lambda error: self.problems.append(f"error: {error}"))
        page.on("console", self._console)
        if clock:
            page.clock.install(time="2026-01-01T00:00:00")
        path = self.folder / f"page-{len(self.contexts)}.html"
        path.write_bytes(html.encode())
        page.goto(path.as_uri())
        if clock:
            page.clock.pause_at("2026-01-01T01:00:00")
        return page

    def _route(self, route):
        if route.request.url.startswith("file:"):
            route.continue_()
        else:
            self.problems.append(f"request: {route.request.url}")
            route.abort()

    def _console(self, message):
        if message.type in ("error", "warning"):
            self.problems.append(f"{message.type}: {message.text}")

    def unexpected(self):
        return [
            problem
            for problem in self.problems
            if not any(part in problem for part in self.expected)
        ]


@pytest.fixture
def opened(browser, tmp_path):
    """``opened(html, **options)`` gives a page; requests and errors fail the test."""
    yield from _opened(browser, tmp_path)


@pytest.fixture(scope="module")
def opened_once(browser, tmp_path_factory):
    """Like ``opened``, for a page that a module's tests share."""
    yield from _opened(browser, tmp_path_factory.mktemp("pages"))


def _opened(browser, folder):
    opens = Opened(browser, folder)
    yield opens
    for context in opens.contexts:
        context.close()
    assert opens.unexpected() == []
