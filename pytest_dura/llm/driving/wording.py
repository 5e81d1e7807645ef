"""The templates of the driving domain."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from pytest_dura.llm.driving.probes import probes
from pytest_dura.llm.driving.vocabulary import SCHEMA, VOCABULARY
from pytest_dura.llm.prompts.sources import Sources
from pytest_dura.llm.prompts.templates import Templates

OWN = Path(__file__).parent / "templates"


def driving_templates(directory: Path | None = None) -> Templates:
    """The built-in templates, and those of a user's directory instead of them.

    Compiled once for as long as no file changes.

    Raises:
        ConfigurationError: For files that cannot be used, with file and line.
    """
    return _compiled(directory, Sources.read(OWN, directory).digest)


@lru_cache(maxsize=8)
def _compiled(directory: Path | None, _digest: str) -> Templates:
    return Templates.load(OWN, directory, vocabulary=VOCABULARY, schema=SCHEMA, probes=probes())
