"""The command that runs an episode of the evidence again, for those who read the evidence."""

from __future__ import annotations

import shlex
from functools import lru_cache

_EVIDENCE = "--dura-evidence"
_LONGEST = 100_000
"""Characters of a session's command; no shell takes many more."""


def replay_command(episode: str, evidence: str | None = None) -> str:
    """``pytest --dura-replay='case#run'``, each value quoted for a shell.

    Args:
        episode: Its id.
        evidence: The evidence directory, unless it is the default one.
    """
    told = ["pytest", f"--dura-replay={shlex.quote(episode)}"]
    return " ".join(told if evidence is None else [*told, f"{_EVIDENCE}={shlex.quote(evidence)}"])


@lru_cache(maxsize=1)
def evidence_option(command: str) -> str | None:
    """The evidence directory that a session's command names, if it does; the last one counts."""
    if len(command) > _LONGEST:
        return None
    try:
        words = shlex.split(command)
    except ValueError:  # no shell reads such a command
        return None
    found = None
    for word, following in zip(words, [*words[1:], None], strict=False):
        option, equals, value = word.partition("=")
        if option == _EVIDENCE:
            found = value if equals else following
    return found
