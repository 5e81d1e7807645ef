"""Names of files that belong to an episode: readable, and harmless whatever the episode's id is."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

FOLDER = "episodes"
"""In the bundle: where the traces are."""
LONGEST = 80
"""Characters of an id that a name keeps."""
_NAME = re.compile(r"(?!.*\.\.)[A-Za-z0-9_][A-Za-z0-9._-]{0,79}-[0-9a-f]{8}\.mcap")
_PATH = re.compile(rf"{FOLDER}/({_NAME.pattern})")
# Names of devices, which Windows sees whatever follows the first point.
_DEVICE = re.compile(r"(?i)(con|prn|aux|nul|com[0-9]|lpt[0-9])(\.|-|$)")


def episode_name(about: Mapping[str, Any]) -> str:
    """A name without suffix: the id as far as it goes, and what tells it from all others.

    Args:
        about: With ``id``, ``component``, ``seed`` and ``digest`` of the episode.
    """
    identity = [about[key] for key in ("id", "component", "seed", "digest")]
    digest = hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:8]
    return f"{slug(str(about['id']))}-{digest}"


def slug(text: str) -> str:
    """The text as the part of a file's name; two texts may have the same one."""
    found = re.sub(r"[^A-Za-z0-9._-]+", "-", text[: 4 * LONGEST])
    found = re.sub(r"\.{2,}", ".", found).lstrip(".-")[:LONGEST].rstrip(".-")
    return f"_{found}"[:LONGEST] if _DEVICE.match(found) else found or "episode"


def trace_path(about: Mapping[str, Any]) -> str:
    """Where the trace of an episode is in the bundle: ``episodes/<name>.mcap``."""
    return f"{FOLDER}/{episode_name(about)}.mcap"


def is_trace_name(name: str) -> bool:
    """Whether a file of this name in ``episodes`` is a trace of ours, whole or begun."""
    begun = name.removeprefix(".").rpartition("-")[0] if name.startswith(".") else ""
    return _NAME.fullmatch(begun or name) is not None


def is_trace_path(path: Any) -> bool:
    """Whether a record may name this path as that of a trace; none leads out of the bundle."""
    return isinstance(path, str) and _PATH.fullmatch(path) is not None
