"""The player in a page: packed episodes, its script and style, and a page of its own."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Mapping, Sequence
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

from pytest_dura.evidence.player.data import player_data
from pytest_dura.evidence.traces.trace import Trace

_ASSETS = Path(__file__).parent / "assets"
_PARTS = ("basics", "episode", "view", "lanes", "plots", "panels", "keys", "player")
_START = """
DuraPlayer.mount(document.getElementById("player"),
  document.getElementById("episode").textContent, {open: true, page: true});
"""
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<style>{style}</style>
</head>
<body class="dura-page">
<main id="player"></main>
<noscript>This page plays an episode and needs JavaScript.</noscript>
<script type="application/octet-stream" id="episode">{data}</script>
<script>{script}</script>
</body>
</html>
"""


def packed(data: Mapping[str, Any]) -> str:
    """Data as zlib's deflate in base64, safe inside a script element or an attribute."""
    plain = json.dumps(data, separators=(",", ":"), allow_nan=False).encode("ascii")
    return base64.b64encode(zlib.compress(plain, 9)).decode("ascii")


@cache
def assets() -> tuple[str, str]:
    """The player's script, which defines ``DuraPlayer``, and its style; neither ends an element."""
    parts = [(_ASSETS / f"{name}.js").read_text(encoding="utf-8") for name in _PARTS]
    script = '"use strict";\nconst DuraPlayer = (() => {\n' + "\n".join(parts)
    script += "\nreturn {mount};\n})();\n"
    style = (_ASSETS / "player.css").read_text(encoding="utf-8")
    return script, style


def content_hash(text: str) -> str:
    """How a content security policy names an inline script or style of this very text."""
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"'sha256-{digest}'"


def player_page(trace: Trace, verdicts: Sequence[Mapping[str, Any]] = ()) -> str:
    """A page of its own that plays an episode; it needs no network, and runs no other script.

    Args:
        trace: The episode.
        verdicts: As for :func:`~pytest_dura.evidence.player.data.player_data`.
    """
    data = player_data(trace, verdicts)
    script, style = assets()
    script += _START
    policy = (
        f"default-src 'none'; script-src {content_hash(script)}; "
        f"style-src {content_hash(style)}; img-src data:; base-uri 'none'; form-action 'none'"
    )
    return _PAGE.format(
        policy=policy,
        title=escape(f"{data['about'].get('id', 'episode')} - episode player"),
        style=style,
        data=packed(data),
        script=script,
    )
