"""Reports as a program reads them, and bundles with traces that a report shows."""

from __future__ import annotations

import base64
import re
import zlib
from collections import Counter
from html.parser import HTMLParser

from session_records import episode, session_record
from traces import ABOUT, simple_trace

from pytest_dura.evidence import write_trace

VIOLATING = "a/clear+ghost#1"


class Page(HTMLParser):
    """Elements, ids, links, captions and the text of a page."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.elements, self.ids, self.links = Counter(), Counter(), []
        self.handlers, self.sources, self.text = [], [], []
        self.scripts, self._open = [], []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements[tag] += 1
        self._open.append(tag)
        if tag in ("td", "th", "tr", "li", "p", "br", "dt", "dd"):
            self.text.append(" ")
        for name, value in attrs:
            if name == "id":
                self.ids[value] += 1
            if name == "href":
                self.links.append(value)
            if name in ("src", "srcset", "action", "style", "srcdoc"):
                self.sources.append((tag, name, value))
            if name.startswith("on"):
                self.handlers.append(name)
        if tag == "script":
            self.scripts.append(dict(attrs).get("type", "javascript"))

    def handle_data(self, data):
        if self._open and self._open[-1] in ("script", "style"):
            return
        self.text.append(data)

    def handle_endtag(self, tag):
        self._open.append("/")

    @property
    def words(self):
        """The text with single spaces."""
        return " ".join("".join(self.text).split())


def unpacked(html):
    """The page with the rows that its script would unpack."""
    return re.sub(
        '<script type="application/octet-stream" class="packed"[^>]*>([^<]*)</script>',
        lambda packed: zlib.decompress(base64.b64decode(packed[1])).decode(),
        html,
    )


def record_with_trace(directory, *, file="episodes/one.mcap", trace=None, **changes):
    """The record of :func:`session_record`; the episode that violates SAF-1 has a trace."""
    about = {**ABOUT, "id": VIOLATING, "case": "a/clear+ghost"}
    written = write_trace(directory / "episodes/one.mcap", simple_trace(about=about))
    told = {"file": file, **written, "kept_for": "violation", **(trace or {})}
    episodes = [
        episode("a/clear", 0), episode("a/clear", 1), episode("a/clear+ghost", 0),
        episode("a/clear+ghost", 1, trace=told),
        episode("a/clear+ghost", 2, validity="invalid"),
        episode("a/clear+ghost", 3, validity="missing"),
    ]  # fmt: skip
    return session_record(directory, episodes=episodes, **changes)
