"""The README that the index shows, apart from the repository, to which its links are relative.

With `home` of pyproject.toml, the address below which files of the repository can be read (such as
`https://forge.example/project/raw/main/`), links and pictures become absolute. Without it pictures
are left out and links are plain text, as nobody could follow them.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

FENCE = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
PICTURE = re.compile(r"!\[([^\]]*)\]\((?![a-z]+:)([^)\s]+)\)\n?")
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((?![a-z]+:|#)([^)\s]+)\)")


def long_description(readme: str, home: str) -> str:
    """Return the README with absolute links below `home`, or without any if it is empty."""
    parts = FENCE.split(readme)
    if home:
        base = home.rstrip("/")
        parts[::2] = [
            LINK.sub(rf"[\1]({base}/\2)", PICTURE.sub(rf"![\1]({base}/\2)\n", part))
            for part in parts[::2]
        ]
    else:
        parts[::2] = [LINK.sub(r"\1", PICTURE.sub("", part)) for part in parts[::2]]
        parts.append(
            "\n\nThe pages named here are in the source distribution, with their pictures.\n"
        )
    return "".join(parts)


class ReadmeHook(MetadataHookInterface):
    """Hatchling asks it for what `dynamic` names and no other source states."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the text that the index shows."""
        readme = Path(self.root, "README.md").read_text("utf-8")
        text = long_description(readme, self.config["home"])
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
