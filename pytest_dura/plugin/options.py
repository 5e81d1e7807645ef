"""The values of the command-line options and ini settings, once they are checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.declared_options import (
    DEFAULT_CASSETTE,
    DEFAULT_EVIDENCE,
    DEFAULT_LEVEL,
    DEFAULT_ROLE_TIMEOUT,
    DEFAULT_SEED,
)
from pytest_dura.plugin.shards import Shard, shard_of
from pytest_dura.plugin.simulating import executor_of

if TYPE_CHECKING:
    from pytest_dura.campaign.execution.choice import Choice
    from pytest_dura.llm.session import Mode
    from pytest_dura.plugin.traces import Level


_ENDS = {"decided": True, "complete": False, None: None}
_REPEATED = ("evidence", "evidence-level", "llm", "cassette")


@dataclass(frozen=True)
class Options:
    """The options as the session uses them.

    ``given`` are the options that a command for the same again must repeat.
    """

    scenarios: bool
    paths: tuple[Path, ...]
    select: tuple[str, ...]
    list_only: bool
    generator: str | None
    faults: tuple[Any, ...] | None
    runs: int | None
    seed: int
    time_budget: float | None
    role_timeout: float
    end_when_decided: bool | None
    evidence: Path
    evidence_level: Level
    replay: str | None
    reduce: str | None
    resume: bool
    reuse: Path | None
    warn_undecided: bool
    require_repeatable: bool
    twins: bool
    baseline: str | None
    argument: Path | None
    fail_worse: bool
    llm: Mode
    cassette: Path | None
    shard: Shard | None
    executor: Choice | None
    progress_interval: float
    given: tuple[tuple[str, str], ...]
    any_given: bool

    @classmethod
    def of(cls, config: pytest.Config) -> Options:
        """The options of a session.

        Raises:
            ConfigurationError: For a value that cannot be used.
        """
        get = config.getoption
        runs = _whole_number("--dura-runs", get("dura_runs"), at_least=1)
        seed = _whole_number("--dura-seed", get("dura_seed"), at_least=0)
        select, scenarios = tuple(get("dura_select")), bool(get("dura_scenarios"))
        list_only = bool(get("dura_list"))
        faults = tuple(get("dura_faults"))
        arguments = config.args_source is config.ArgsSource.ARGS
        if faults and not (scenarios or list_only or arguments):
            raise ConfigurationError(
                "--dura-faults is about scenario cases, and there are none without "
                "--dura-scenarios",
                key="--dura-faults",
                found=faults[0],
                remedy="add --dura-scenarios; a test function names its faults in the marker dura",
            )
        if select and not (scenarios or list_only):
            raise ConfigurationError(
                "--dura-select chooses among scenario cases, and there are none without "
                "--dura-scenarios",
                key="--dura-select",
                found=select[0],
                remedy="add --dura-scenarios; choose test functions with -k",
            )
        argument = get("dura_argument")
        baseline, fail_worse = get("dura_baseline"), get("dura_baseline_worse") == "fail"
        if baseline is None and get("dura_baseline_worse") is not None:
            raise ConfigurationError(
                "--dura-baseline-worse is about a baseline, and there is none",
                key="--dura-baseline-worse",
                found=get("dura_baseline_worse"),
                remedy="add --dura-baseline=evidence.json",
            )
        given = [("--dura-path", path) for path in get("dura_path")]
        given += [("--dura-faults", text) for text in faults]
        for name in ("generator", "runs", "seed", "time-budget", "role-timeout", "end", *_REPEATED):
            value = get(f"dura_{name.replace('-', '_')}")
            if value is not None:
                given.append((f"--dura-{name}", str(value)))
        return cls(
            scenarios=scenarios,
            paths=_paths(config),
            select=select,
            list_only=list_only,
            generator=get("dura_generator"),
            faults=_fault_campaigns(faults, config.invocation_params.dir),
            runs=runs,
            seed=DEFAULT_SEED if seed is None else seed,
            time_budget=_seconds("--dura-time-budget", get("dura_time_budget")),
            role_timeout=_seconds("--dura-role-timeout", get("dura_role_timeout"))
            or DEFAULT_ROLE_TIMEOUT,
            end_when_decided=_ENDS[get("dura_end")],
            evidence=_evidence(config),
            evidence_level=cast("Level", get("dura_evidence_level") or DEFAULT_LEVEL),
            replay=get("dura_replay"),
            reduce=get("dura_reduce"),
            resume=bool(get("dura_resume")),
            reuse=_reuse(config),
            twins=not get("dura_no_twins"),
            warn_undecided=get("dura_undecided") == "warn",
            require_repeatable=bool(config.getini("dura_require_repeatable")),
            baseline=baseline,
            argument=None if argument is None else config.invocation_params.dir / argument,
            fail_worse=fail_worse,
            llm=cast("Mode", get("dura_llm") or "live"),
            cassette=_cassette(config),
            shard=shard_of(config),
            executor=executor_of(
                config, _seconds("--dura-episode-timeout", get("dura_episode_timeout"))
            ),
            progress_interval=_interval(config.getini("dura_progress_interval")),
            given=tuple(given),
            any_given=scenarios
            or bool(given)
            or baseline is not None
            or any(get(f"dura_{name}") for name in ("shard", "resume", "reuse")),
        )


def _fault_campaigns(given: tuple[str, ...], here: Path) -> tuple[Any, ...] | None:
    """The campaigns of all ``--dura-faults``, in their order; ``None`` without any."""
    if not given:
        return None
    found: list[Any] = []
    for text in given:
        if text.endswith((".yaml", ".yml")):
            from pytest_dura.campaign.fault_campaigns import read_campaigns

            found += read_campaigns(here / text)
        else:
            found += [one.strip() for one in text.split(",")]
    if not all(found):
        raise ConfigurationError(
            "a fault campaign of --dura-faults has no name",
            key="--dura-faults",
            found=", ".join(given),
            expected="for example --dura-faults=none,ghost-obstacle",
        )
    return tuple(found)


def _whole_number(option: str, text: Any, *, at_least: int) -> int | None:
    if text is None:
        return None
    try:
        number = int(str(text))
    except ValueError:
        number = at_least - 1
    if number < at_least:
        raise ConfigurationError(
            f"{option} takes a whole number",
            key=option,
            found=text,
            expected=f"a whole number of at least {at_least}",
            remedy=f"for example {option}={max(at_least, 10)}",
        )
    return number


def _seconds(option: str, text: Any) -> float | None:
    if text is None:
        return None
    try:
        number = float(str(text))
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise ConfigurationError(
            f"{option} takes a number of seconds",
            key=option,
            found=text,
            expected="a number above 0",
            remedy=f"for example {option}=30",
        )
    return number


def _interval(text: str) -> float:
    """Seconds between lines of a log; infinite for never."""
    seconds = None if text == "never" else _seconds("dura_progress_interval", text)
    return math.inf if seconds is None else seconds


def _paths(config: pytest.Config) -> tuple[Path, ...]:
    """Where scenario files are, the built-in ones apart: ini setting, then ``--dura-path``."""
    ini = "ini dura_scenario_paths"
    chosen = [(ini, Path(path)) for path in config.getini("dura_scenario_paths")]
    default = config.rootpath / "scenarios"
    if not chosen and default.is_dir():
        chosen.append((ini, default))
    here = config.invocation_params.dir
    chosen += [("--dura-path", here / path) for path in config.getoption("dura_path")]
    for key, path in chosen:
        if not path.exists():
            raise ConfigurationError(
                "there is no such directory",
                key=key,
                found=str(path),
                expected="a directory with scenario or requirement files",
                remedy="check the spelling; the path is relative to where pytest was started",
            )
    return tuple(path for _, path in chosen)


def _evidence(config: pytest.Config) -> Path:
    given = config.getoption("dura_evidence")
    folder = config.rootpath / DEFAULT_EVIDENCE
    if given:
        folder = config.invocation_params.dir / given
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(
            "the evidence goes into a directory, and this is a file",
            key="--dura-evidence",
            found=str(folder),
            expected="a directory, which is made if it does not exist",
            remedy="choose another path",
        )
    return folder


def _reuse(config: pytest.Config) -> Path | None:
    """Where episodes are kept from session to session, if they are."""
    given = config.getoption("dura_reuse")
    if not given:
        return None
    if config.getoption("dura_resume"):
        raise ConfigurationError(
            "an interrupted session is resumed from its own evidence directory",
            key="--dura-resume",
            found=f"--dura-resume and --dura-reuse={given}",
            expected="one of them",
            remedy="drop --dura-resume: episodes in the directory of --dura-reuse are taken over "
            "anyway",
        )
    folder: Path = config.invocation_params.dir / given
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(
            "episodes are kept in a directory, and this is a file",
            key="--dura-reuse",
            found=str(folder),
            expected="a directory, which is made if it does not exist",
            remedy="choose another path",
        )
    return folder


def _cassette(config: pytest.Config) -> Path | None:
    """The cassette, where the mode has one."""
    given, mode = config.getoption("dura_cassette"), config.getoption("dura_llm") or "live"
    if mode == "live" and given is not None:
        raise ConfigurationError(
            "--dura-cassette is about recorded exchanges, and a live session has none",
            key="--dura-cassette",
            found=given,
            expected="--dura-llm=record or --dura-llm=replay beside it",
        )
    if mode == "live":
        return None
    return config.invocation_params.dir / given if given else config.rootpath / DEFAULT_CASSETTE
