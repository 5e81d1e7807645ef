"""Panels: what other packages show of an episode in its player.

A panel is a class that makes data of an episode, and a script that shows them. The script ends with
``addPanel(name, Panel)``, where ``name`` is the registered one. ``Panel`` is a class: it is made
with the player, whose ``episode.panels[name]`` are the data; ``node`` is its element,
``update(tick)`` follows the time, and ``lane()``, if there is one, returns a row over time. What
the scripts of ``assets/`` define is known there. Data enter the page as text nodes.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar

from pytest_dura.core.classes import is_subclass
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.registry import Registry
from pytest_dura.core.simulator import Recording

_ENDS_AN_ELEMENT = re.compile(r"</(?:script|style)|<!--", re.IGNORECASE)


class Panel(ABC):
    """Shows something of an episode in its player."""

    script: ClassVar[Path]
    """File of its script."""
    style: ClassVar[Path | None] = None
    """File of its style, if it has one; the names of its classes begin with the panel's own."""

    @classmethod
    @abstractmethod
    def data(cls, recording: Recording) -> Mapping[str, Any] | None:
        """Return what it shows of an episode, as JSON data; ``None`` where there is nothing.

        Args:
            recording: Of the episode, without secrets; nothing in it is to be trusted.
        """


PANELS: Registry[type[Panel]] = Registry(
    "pytest_dura.panels",
    "panel of the player",
    lambda value: is_subclass(value, Panel),
    "a subclass of pytest_dura.reports.html.panels.Panel",
)
"""Panels by their names."""


def panel_data(recording: Recording) -> dict[str, Mapping[str, Any]]:
    """What each panel shows of an episode, by name; without those that show nothing."""
    shown = {name: panel.data(recording) for name, panel in PANELS.items()}
    return {name: data for name, data in shown.items() if data is not None}


def panel_assets(names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Scripts and styles of panels.

    Args:
        names: Of the panels.

    Raises:
        ConfigurationError: For a text that would end the element that holds it.
    """
    panels = [(name, PANELS[name]) for name in sorted(names)]
    scripts = [_text(name, panel.script) for name, panel in panels]
    return scripts, [_text(name, panel.style) for name, panel in panels if panel.style is not None]


def _text(name: str, file: Path) -> str:
    text = file.read_text(encoding="utf-8")
    if end := _ENDS_AN_ELEMENT.search(text):
        raise ConfigurationError(
            f"a file of the panel {name!r} cannot stand in a page",
            file=str(file),
            key=PANELS.group,
            found=end[0],
            expected="a text that ends no element of the page",
            remedy="write it in two parts, such as '<' + '/script'",
        )
    return text
