"""Deprecated: the templates' folder is ``pytest_dura.llm.driving.planner.TEMPLATES``."""

from __future__ import annotations

import warnings
from pathlib import Path

from pytest_dura.llm.driving.planner import TEMPLATES


def __getattr__(name: str) -> Path:
    if name != "OWN":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    text = f"{__name__}.OWN is deprecated: use pytest_dura.llm.driving.planner.TEMPLATES"
    warnings.warn(text, DeprecationWarning, stacklevel=2)
    return TEMPLATES
