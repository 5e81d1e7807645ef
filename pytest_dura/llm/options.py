"""Options of language models: who answers, from which cassette, how many at once, and limits.

Every pytest run loads this module; what reads a value imports the rest.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pytest_dura.options import Option, OptionTable, Setting, unusable, whole_number

if TYPE_CHECKING:
    from pytest_dura.llm.session import Mode
    from pytest_dura.llm.usage import Limits

_OWN_PROCESS = (None, "auto", "in-process")
"""Values of ``--dura-executor`` with which this process may ask a model itself."""


def _mode(setting: Setting) -> Mode:
    """Read who answers.

    Raises:
        ConfigurationError: If other processes would need the cassette of this one.
    """
    mode: Mode = setting.value
    option, executor = "--dura-executor", setting.other("--dura-executor")
    if mode != "live" and executor not in _OWN_PROCESS:
        raise unusable(
            "a cassette is of this process, and the episodes would be simulated in others",
            key=option,
            found=f"{executor} beside {setting.key}={mode}",
            expected="one of them",
            remedy=f"leave out {option}, or use -n, whose workers share the cassette",
        )
    return mode


def _cassette_file(setting: Setting) -> Path | None:
    """Read the cassette, where the mode has one."""
    if (setting.other("--dura-llm") or "live") != "live":
        return setting.path
    if setting.given is not None:
        raise unusable(
            f"{setting.key} is about recorded exchanges, and a live session has none",
            key=setting.key,
            found=setting.given,
            expected="--dura-llm=record or --dura-llm=replay beside it",
        )
    return None


def _limits(setting: Setting) -> Limits | None:
    """Read what a session may ask of language models at most."""
    from pytest_dura.llm.usage import Limits

    return Limits.parse(str(setting.value), setting.key)


_MOST_RETRIES = 20


def _retries(setting: Setting) -> int:
    """Read how often a request to a language model is repeated.

    Raises:
        ConfigurationError: If it is no such number, or other processes ask the model.
    """
    number = whole_number(at_least=0)(setting)
    problem, remedy = "", f"for example {setting.key}=3"
    if number > _MOST_RETRIES:
        problem = "repeats a request too often"
    elif setting.other("--dura-executor") not in _OWN_PROCESS:
        problem = "reaches this process alone, and the episodes are simulated in others"
        remedy = f"leave it out, and set DURA_LLM_RETRIES={number} where they run"
    if problem:
        raise unusable(
            f"{setting.key} {problem}",
            key=setting.key,
            found=setting.given,
            expected=f"a whole number from 0 to {_MOST_RETRIES}",
            remedy=remedy,
        )
    return number


class LlmOptions(OptionTable):
    """Options of language models."""

    title = "language models as the component under test"

    mode: Option[Mode] = Option(
        "--dura-llm",
        "who answers a component that asks a language model: its server, its server once for "
        "what is not in the cassette yet, or the cassette alone",
        _mode,
        default="live",
        choices=("live", "record", "replay"),
        example="record",
        details="See [language models](llm.md).",
        activates=True,
        repeated_in=("rerun",),
        no_shard="each shard would record a cassette of its own",
        no_shard_for="record",
        changes_episodes=True,
    )
    cassette: Option[Path | None] = Option(
        "--dura-cassette",
        "where exchanges with language models are recorded, and replayed from",
        _cassette_file,
        default="dura-cassette.sqlite",
        default_note=" in pytest's root directory",
        metavar="FILE",
        example="my.sqlite",
        activates=True,
        repeated_in=("rerun", "replay"),
        same_in_shards=False,
        changes_episodes=True,
        sent_to_workers=True,
    )
    concurrency: Option[int] = Option(
        "--dura-llm-concurrency",
        "requests to language models that each process makes at the same time, at most, for "
        "episodes of a campaign that it simulates at once in threads",
        whole_number(at_least=1),
        ini="dura_llm_concurrency",
        default="1",
        metavar="N",
        example="8",
        details="See [many requests at once](llm/tokens.md#many-requests-at-once).",
        same_in_shards=False,
    )
    limits: Option[Limits | None] = Option(
        "--dura-llm-limit",
        "requests to the servers of language models, or tokens, after which the session "
        "ends as interrupted; --dura-resume goes on with it",
        _limits,
        metavar="LIMITS",
        example="requests=5000,tokens=2e6",
        details="All processes of the session share it.",
        same_in_shards=False,
    )
    retries: Option[int | None] = Option(
        "--dura-llm-retries",
        "how often a request is repeated whose language model's server answers 429 or 503, or "
        "takes no connection",
        _retries,
        metavar="N",
        example="3",
        details="By default as `DURA_LLM_RETRIES` says, or never. See"
        " [servers](llm-servers.md#a-server-that-is-not-available).",
        activates=True,
        repeated_in=("rerun",),
        same_in_shards=False,
    )
