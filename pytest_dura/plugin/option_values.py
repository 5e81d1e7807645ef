"""Readers of option values: each checks what was given, and returns it as the session uses it.

A reader gets a :class:`Setting`. What is wrong is one error that names option, found and expected.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from pytest_dura.guests import default_domain
from pytest_dura.options import Setting, texts, unusable

if TYPE_CHECKING:
    from pytest_dura.execution.executors import ExecutorChoice


def export_files(setting: Setting) -> tuple[str, ...]:
    """Return the files of the formats that a bundle is to have besides, each once.

    Raises:
        ConfigurationError: For an unknown format.
    """
    names = texts(setting)
    if not names:
        return ()
    from pytest_dura.evidence.bundle import exported_file

    return tuple(dict.fromkeys(exported_file(name, setting.key) for name in names))


def second_engine(setting: Setting) -> bool:
    """Return whether rtamt evaluates formulas as well.

    Raises:
        ConfigurationError: For another engine.
    """
    if setting.value not in ("own", "both"):
        raise unusable(
            "the ini setting dura_stl_engine names no engine for formulas",
            key="dura_stl_engine",
            found=str(setting.value),
            expected="own or both",
            remedy="for example -o dura_stl_engine=both",
        )
    return bool(setting.value == "both")


ScenarioChoice = Literal["project", "builtin"]
"""The project's own scenarios where it has some, or the built-in ones in any case."""


def scenario_choice(setting: Setting) -> ScenarioChoice | None:
    """Return which scenarios are to run, if any."""
    if not setting.given:
        return None
    return "builtin" if setting.given == "builtin" else "project"


def off_switch(setting: Setting) -> bool:
    """Return whether a switch that turns something off was left alone."""
    return not setting.given


def builtin_files(setting: Setting) -> bool:
    """Return whether the built-in files are known.

    Without a value they are in projects of their domain, where that is installed. The option
    that runs them counts before the setting.

    Raises:
        ConfigurationError: For anything but true and false.
    """
    if setting.other("--dura-scenarios") == "builtin":
        return True
    if setting.given is None:
        from pytest_dura.domains import DOMAINS

        named, builtin = str(setting.config.getini("dura_domain")), default_domain()
        return named in ("", builtin) and builtin in DOMAINS
    return true_or_false(setting)


def true_or_false(setting: Setting) -> bool:
    """Read a setting that is true unless it says otherwise.

    Raises:
        ConfigurationError: For anything but true and false.
    """
    name = setting.key.removeprefix("ini ")
    value = str(setting.value).lower()
    if value not in ("true", "false"):
        raise unusable(
            f"the ini setting {name} is true or false",
            key=name,
            found=setting.given,
            expected="true or false",
            remedy="correct it, or leave it out",
        )
    return value == "true"


def is_choice(choice: str) -> Callable[[Setting], bool]:
    """Make the reader of whether this choice was taken."""
    return lambda setting: setting.value == choice


def seconds(setting: Setting) -> float:
    """Read a positive, finite number of seconds."""
    option = setting.key
    try:
        number = float(str(setting.value))
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise unusable(
            f"{option} takes a number of seconds",
            key=option,
            found=setting.value,
            expected="a number above 0",
            remedy=f"for example {option}=30",
        )
    return number


def seconds_or_never(setting: Setting) -> float:
    """Read a number of seconds; infinite for ``never``."""
    return math.inf if setting.value == "never" else seconds(setting)


def folder(use: str) -> Callable[[Setting], Path]:
    """Make the reader of a directory that is made if need be.

    Args:
        use: What goes into it, in a sentence for messages.
    """

    def read(setting: Setting) -> Path:
        path = setting.path
        if path.exists() and not path.is_dir():
            raise unusable(
                f"{use}, and this is a file",
                key=setting.key,
                found=str(path),
                expected="a directory, which is made if it does not exist",
                remedy="choose another path",
            )
        return path

    return read


def fault_campaigns(setting: Setting) -> tuple[Any, ...] | None:
    """List the campaigns of all ``--dura-faults``, in their order; ``None`` without any."""
    if not setting.given:
        return None
    config = setting.config
    arguments = config.args_source is config.ArgsSource.ARGS
    if not (arguments or setting.other("--dura-scenarios") or setting.other("--dura-list")):
        raise unusable(
            "--dura-faults is about scenario cases, and there are none without --dura-scenarios",
            key=setting.key,
            found=setting.given[0],
            remedy="add --dura-scenarios; a test function names its faults in the marker dura",
        )
    campaigns: list[Any] = []
    for text in setting.given:
        if text.endswith((".yaml", ".yml")):
            from pytest_dura.library.fault_campaigns import read_campaigns

            campaigns += read_campaigns(config.invocation_params.dir / text)
        else:
            campaigns += [part.strip() for part in text.split(",")]
    if not all(campaigns):
        raise unusable(
            "a fault campaign of --dura-faults has no name",
            key=setting.key,
            found=", ".join(setting.given),
            expected="for example --dura-faults=none,ghost-obstacle",
        )
    return tuple(campaigns)


def fails_if_worse(setting: Setting) -> bool:
    """Read whether a rate that got worse fails the session, which needs a baseline."""
    if setting.given is not None and setting.other("--dura-baseline") is None:
        raise unusable(
            f"{setting.key} is about a baseline, and there is none",
            key=setting.key,
            found=setting.given,
            remedy="add --dura-baseline=evidence.json",
        )
    return bool(setting.value == "fail")


_TIMEOUT_OPTION, _MEMORY_OPTION = "--dura-episode-timeout", "--dura-episode-memory"
_SIZES = {"MB": 10**6, "GB": 10**9}


AUTO: Final = "auto"
"""Value of ``--dura-executor`` that chooses among the others once all is collected."""


def executor_limit(setting: Setting) -> float:
    """Read the limit of an episode in another process, which needs one."""
    limit = seconds(setting)
    _check_elsewhere(setting, "is held by ending the process that simulates")
    return limit


def memory_limit(setting: Setting) -> int:
    """Read how many bytes an episode may take in another process, which needs one."""
    text = str(setting.value)
    number, unit = text[:-2], _SIZES.get(text[-2:].upper())
    if not number.isdigit() or int(number) == 0 or unit is None:
        raise unusable(
            f"{setting.key} takes a size",
            key=setting.key,
            found=text,
            expected="a whole number above 0 with MB or GB",
            remedy=f"for example {setting.key}=2GB",
        )
    _check_elsewhere(setting, "is a limit of the process that simulates")
    return int(number) * unit


def _check_elsewhere(setting: Setting, limit: str) -> None:
    """Refuse a limit of a process where episodes are simulated by pytest's own."""
    if setting.other("--dura-executor") == "in-process":
        raise unusable(
            f"{setting.key} {limit}, and that is pytest's own",
            key=setting.key,
            found=f"{setting.value} beside --dura-executor=in-process",
            expected="one of them",
            remedy="leave out one of them; each call into a role has --dura-role-timeout",
        )


def executor_choice(setting: Setting) -> ExecutorChoice | Literal["auto"] | None:
    """Read who simulates; ``None`` for this process.

    Raises:
        ConfigurationError: If there is no such executor, or another option does not go with it.
    """
    text, option = setting.value, setting.key
    if text == "in-process":
        return None
    if text == AUTO:
        return AUTO
    from dataclasses import replace

    from pytest_dura.execution.executors import ExecutorChoice

    choice = ExecutorChoice.parse(text)
    timeout = setting.other(_TIMEOUT_OPTION)
    if timeout is not None:
        limit = Setting(_TIMEOUT_OPTION, timeout, None, setting.config)
        choice = replace(choice, seconds=seconds(limit))
    memory = setting.other(_MEMORY_OPTION)
    if memory is not None and choice.kind is not None:
        choice.kind.memory = memory_limit(Setting(_MEMORY_OPTION, memory, None, setting.config))
    if choice.processes is not None and setting.other("numprocesses"):
        raise unusable(
            "the workers of pytest-xdist would each start processes of their own",
            key=option,
            found=f"{text} beside -n {setting.other('numprocesses')}",
            expected="one of them",
            remedy=f"leave out -n, and give {option}=processes:N the cores; or leave out {option}",
        )
    return choice


_MOST_SHARDS = 10_000
_LONGEST = len(f"{_MOST_SHARDS}/{_MOST_SHARDS}")


@dataclass(repr=False)  # each generated method costs every pytest run time
class Shard:
    """Part of a session.

    Args:
        index: Its number, from 1.
        count: How many there are.
    """

    index: int
    count: int

    @classmethod
    def read(cls, setting: Setting) -> Shard:
        """Read a value such as ``2/5``.

        Raises:
            ConfigurationError: If it is none.
        """
        text, option = str(setting.value), setting.key
        first, _, last = text.partition("/")
        digits = f"{first}{last}"
        if first and last and digits.isascii() and digits.isdecimal() and len(text) <= _LONGEST:
            shard = cls(int(first), int(last))
            if 1 <= shard.index <= shard.count <= _MOST_SHARDS:
                return shard
        raise unusable(
            f"{option} takes the number of a shard and how many there are",
            key=option,
            found=text,
            expected=f"K/N with 1 <= K <= N <= {_MOST_SHARDS}",
            remedy=f"for example {option}=2/5 for the second of five shards",
        )

    def __str__(self) -> str:
        return f"shard {self.index} of {self.count}"
