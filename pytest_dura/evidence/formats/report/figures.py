"""How the report writes figures: short, with their unit, and a dash where there is none."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from pytest_dura.core.roles import STANDARD_ROLES
from pytest_dura.evidence.text import LINE, name, one_line, visible
from pytest_dura.evidence.views.replay_command import model_options, replay_command

NONE = "\N{EN DASH}"


def number(value: float | None, digits: int = 3) -> str:
    """With so many significant digits; an integer as it is."""
    if value is None:
        return NONE
    if isinstance(value, int) or float(value).is_integer():
        return f"{value:.0f}" if abs(value) < 1e15 else f"{value:.{digits}g}"
    shown = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in shown and abs(value) < 1e9 else shown


def percent(value: float | None) -> str:
    """A share as a percentage with three significant digits: ``18.1 %``."""
    return NONE if value is None else f"{100 * value:.3g}\N{NO-BREAK SPACE}%"


def seconds(value: float | None, digits: int = 2) -> str:
    """``6.50 s``."""
    return NONE if value is None else f"{value:.{digits}f}\N{NO-BREAK SPACE}s"


def share(part: int, whole: int) -> str:
    """``3/15``: a rate never stands without its n."""
    return f"{part}/{whole}"


def size(count: int) -> str:
    """Of a file: ``12 kB``."""
    if count < 1000:
        return f"{count} B"
    return f"{count / 1000:.0f} kB" if count < 1_000_000 else f"{count / 1e6:.1f} MB"


def moment(text: str) -> str:
    """A point in time as it is read: ``2026-01-02 03:04:05 UTC``."""
    if not re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", text):
        return one_line(text)
    return text.replace("T", " ").replace("+00:00", " UTC")


def line(text: str, limit: int = LINE) -> str:
    """On one line; of a very long text only the beginning is looked at."""
    return one_line(text, limit) if len(text) < 50_000 else visible(text, limit)


def _replay(episode: str, session: str) -> str:
    """What runs one episode again, with ``DIR`` for the folder that holds the evidence."""
    return replay_command(episode, "DIR", model_options(session))


def role_name(role: str) -> str:
    """A standard role's name as in the paper, such as ``SafetyMonitor``; any other one as it is."""
    return STANDARD_ROLES[role].__name__ if role in STANDARD_ROLES else name(role)


FILTERS: Mapping[str, Any] = {
    "name": name,
    "line": line,
    "prose": visible,
    "number": number,
    "percent": percent,
    "seconds": seconds,
    "moment": moment,
    "size": size,
    "replay": _replay,
    "role": role_name,
}
"""What templates may call."""
