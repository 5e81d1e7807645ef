"""The command that runs an episode of the evidence again, for those who read the evidence."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from functools import lru_cache

from pytest_dura.core.state import NOTHING

_EVIDENCE, _LLM, _CASSETTE = "--dura-evidence", "--dura-llm", "--dura-cassette"
_LONGEST = 100_000
"""Characters of a session's command; no shell takes many more."""


def replay_command(
    episode: str, evidence: str | None = None, models: Mapping[str, str] = NOTHING
) -> str:
    """``pytest --dura-replay='case#run'``, each value quoted for a shell.

    Args:
        episode: Its id.
        evidence: The evidence directory, unless it is the default one.
        models: Of :func:`model_options`.
    """
    told = {"--dura-replay": episode}
    if evidence is not None:
        told[_EVIDENCE] = evidence
    told.update(models)
    return " ".join(["pytest", *(f"{key}={shlex.quote(value)}" for key, value in told.items())])


def evidence_option(command: str) -> str | None:
    """The evidence directory that a session's command names, if it does; the last one counts."""
    return _given(command).get(_EVIDENCE)


def model_options(command: str) -> dict[str, str]:
    """The options with which the cassette of a session answers again, by the session's command."""
    given = _given(command)
    if given.get(_LLM) not in ("record", "replay"):
        return {}
    found = {_LLM: "replay"}
    if _CASSETTE in given:
        found[_CASSETTE] = given[_CASSETTE]
    return found


@lru_cache(maxsize=1)
def _given(command: str) -> Mapping[str, str]:
    """The values of those options in a command."""
    if len(command) > _LONGEST:
        return NOTHING
    try:
        words = shlex.split(command)
    except ValueError:  # no shell reads such a command
        return NOTHING
    found: dict[str, str] = {}
    for word, following in zip(words, [*words[1:], None], strict=False):
        option, equals, value = word.partition("=")
        given = value if equals else following
        if option in (_EVIDENCE, _LLM, _CASSETTE) and given is not None:
            found[option] = given
    return found
