"""Command-line options and ini settings: how they are declared, and their values once checked."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import pytest

from pytest_dura.core.errors import ConfigurationError

if TYPE_CHECKING:
    from pytest_dura.execution.executors import ExecutorChoice
    from pytest_dura.llm.session import Mode


_DEFAULT_SEED = 0
DEFAULT_EVIDENCE = "dura-evidence"
_DEFAULT_LEVEL = "violations"
_DEFAULT_PROGRESS_INTERVAL = "30"
_DEFAULT_ROLE_TIMEOUT = 60.0
_DEFAULT_CASSETTE = "dura-cassette.sqlite"

Level = Literal["summary", "violations", "all"]
"""Which episodes leave a trace in the evidence."""


def add_options(parser: pytest.Parser) -> None:
    """Declare everything that can be set from outside."""
    group = parser.getgroup("dura", "dependability of AI-enabled cyber-physical systems")
    add = group.addoption
    add(
        "--dura-scenarios",
        action="store_true",
        help="run the built-in scenarios, and those of the ini setting dura_scenario_paths",
    )
    add(
        "--dura-path",
        action="append",
        default=[],
        metavar="DIR",
        help="another directory with scenario and requirement files (repeatable)",
    )
    add(
        "--dura-select",
        action="append",
        default=[],
        metavar="GLOB",
        help="run only scenario cases whose name matches (repeatable)",
    )
    add(
        "--dura-list",
        action="store_true",
        help="list scenarios, faults, requirements and roles, and what would run; run nothing",
    )
    add(
        "--dura-generator",
        metavar="NAME",
        help="the component under test: a short name such as rule_based, or package.module:Name",
    )
    add(
        "--dura-faults",
        action="append",
        default=[],
        metavar="FAULTS",
        help="fault campaigns instead of the scenarios' own, separated by commas: none, a fault, "
        "fault+fault, catalogue, a glob of fault types, or a YAML file with a list (repeatable)",
    )
    add("--dura-runs", metavar="N", help="episodes per case, instead of what is planned")
    add(
        "--dura-seed",
        metavar="N",
        help=f"base seed, from which every episode's seed follows (default: {_DEFAULT_SEED})",
    )
    add(
        "--dura-time-budget",
        metavar="SECONDS",
        help="what the component has for one proposal, instead of what the scenarios say",
    )
    add(
        "--dura-executor",
        metavar="EXECUTOR",
        help="who simulates: in-process, processes or processes:N on this machine, or the workers "
        "of a Dask cluster, dask://HOST:PORT (default: in-process)",
    )
    add(
        "--dura-role-timeout",
        metavar="SECONDS",
        help="what the simulator, and each role but the component, has for one call before its "
        f"episode is given up (default: {_DEFAULT_ROLE_TIMEOUT:g})",
    )
    add(
        "--dura-episode-timeout",
        metavar="SECONDS",
        help="what an episode may take in another process (--dura-executor), beside all time "
        "budgets of its component, before that process is ended (default: 3600)",
    )
    add(
        "--dura-shard",
        metavar="K/N",
        help="run the K-th of N parts of the session; `python -m pytest_dura merge` joins their "
        "evidence, and gates on the whole",
    )
    add(
        "--dura-end",
        choices=("decided", "complete"),
        help="end each episode once every requirement of its case is decided, or run it whole, "
        "instead of what the scenarios say",
    )
    add(
        "--dura-evidence",
        metavar="DIR",
        help=f"where the evidence goes (default: {DEFAULT_EVIDENCE})",
    )
    add(
        "--dura-resume",
        action="store_true",
        help="go on with the session that the evidence directory is of, which was interrupted, or "
        "lost a process: its episodes are taken over, as far as nothing that they rest on has "
        "changed since",
    )
    add(
        "--dura-reuse",
        metavar="DIR",
        help="keep episodes in this directory, and take over what earlier sessions left there, as "
        "far as nothing that they rest on has changed since",
    )
    add(
        "--dura-evidence-level",
        choices=("summary", "violations", "all"),
        default=None,
        help="which episodes leave a trace in the evidence: none, those that violate a requirement "
        f"and samples, or all (default: {_DEFAULT_LEVEL})",
    )
    add(
        "--dura-replay",
        metavar="EPISODE",
        help="run an episode of the evidence again (case#run) and compare the digests",
    )
    add(
        "--dura-reduce",
        metavar="EPISODE",
        help="find the smallest set of faults with which an episode of the evidence (case#run) "
        "still violates its requirement; --dura-runs limits the runs (default: 100)",
    )
    add(
        "--dura-trust-code",
        action="store_true",
        help="let a bundle, or a scenario or fault file from outside the project, name code that "
        "lies beside it: it is imported, and runs as you",
    )
    add(
        "--dura-undecided",
        choices=("fail", "warn"),
        default="fail",
        help="what an undecided verdict does to its test: fail it, or skip it (default: fail)",
    )
    add(
        "--dura-no-twins",
        action="store_true",
        help="run no fault-free twins of episodes with faults, and so do not say which faults "
        "reached the component's proposals",
    )
    add(
        "--dura-baseline",
        metavar="PATH",
        help="compare the rates of violations with this evidence: evidence.json, or its directory",
    )
    add(
        "--dura-baseline-worse",
        choices=("fail", "warn"),
        help="what a rate that got worse than the baseline's does to the session (default: warn)",
    )
    add(
        "--dura-argument",
        metavar="FILE",
        help="your own argument on top of the generated assurance case, as gsn2x-style YAML",
    )
    add(
        "--dura-llm",
        choices=("live", "record", "replay"),
        help="who answers a component that asks a language model: its server, its server once for "
        "what is not in the cassette yet, or the cassette alone (default: live)",
    )
    add(
        "--dura-cassette",
        metavar="FILE",
        help="where exchanges with language models are recorded, and replayed from (default: "
        f"{_DEFAULT_CASSETTE} in pytest's root directory)",
    )
    parser.addini(
        "dura_progress_interval",
        "seconds, at least, between lines on the progress of campaigns where there is no terminal, "
        f"or `never` (default: {_DEFAULT_PROGRESS_INTERVAL})",
        default=_DEFAULT_PROGRESS_INTERVAL,
    )
    parser.addini(
        "dura_secrets",
        "names of environment variables, or globs of them in letters of any case, whose values are "
        "kept out of the evidence, beside those whose names speak of secrets",
        type="args",
        default=[],
    )
    parser.addini(
        "dura_scenario_paths",
        "directories with scenario and requirement files (default: scenarios, if it exists)",
        type="paths",
        default=[],
    )
    parser.addini(
        "dura_require_repeatable",
        "whether a case fails the gate if one of its episodes, run twice in the session, comes out "
        "differently (default: false, which says so and no more)",
        type="bool",
        default=False,
    )


_ENDS = {"decided": True, "complete": False, None: None}
_REPEATED = ("evidence", "evidence-level", "llm", "cassette")


@dataclass(frozen=True)
class Options:
    """Checked options, as the session uses them.

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
    executor: ExecutorChoice | None
    progress_interval: float
    given: tuple[tuple[str, str], ...]
    any_given: bool

    @property
    def is_command(self) -> bool:
        """Whether the session lists, replays or reduces, and so runs no tests."""
        return self.list_only or self.replay is not None or self.reduce is not None

    @classmethod
    def of(cls, config: pytest.Config) -> Options:
        """Read the options of a session.

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
            seed=_DEFAULT_SEED if seed is None else seed,
            time_budget=_seconds("--dura-time-budget", get("dura_time_budget")),
            role_timeout=_seconds("--dura-role-timeout", get("dura_role_timeout"))
            or _DEFAULT_ROLE_TIMEOUT,
            end_when_decided=_ENDS[get("dura_end")],
            evidence=_evidence(config),
            evidence_level=cast("Level", get("dura_evidence_level") or _DEFAULT_LEVEL),
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
            shard=_shard_of(config),
            executor=_executor_choice(
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
    """List the campaigns of all ``--dura-faults``, in their order; ``None`` without any."""
    if not given:
        return None
    campaigns: list[Any] = []
    for text in given:
        if text.endswith((".yaml", ".yml")):
            from pytest_dura.library.fault_campaigns import read_campaigns

            campaigns += read_campaigns(here / text)
        else:
            campaigns += [part.strip() for part in text.split(",")]
    if not all(campaigns):
        raise ConfigurationError(
            "a fault campaign of --dura-faults has no name",
            key="--dura-faults",
            found=", ".join(given),
            expected="for example --dura-faults=none,ghost-obstacle",
        )
    return tuple(campaigns)


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
    """Read the seconds between lines of a log; infinite for ``never``."""
    seconds = None if text == "never" else _seconds("dura_progress_interval", text)
    return math.inf if seconds is None else seconds


def _paths(config: pytest.Config) -> tuple[Path, ...]:
    """List the places of scenario files but the built-in: ini setting, then ``--dura-path``."""
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
    return _checked_folder(folder, "--dura-evidence", "the evidence goes into a directory")


def _checked_folder(folder: Path, option: str, use: str) -> Path:
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(
            f"{use}, and this is a file",
            key=option,
            found=str(folder),
            expected="a directory, which is made if it does not exist",
            remedy="choose another path",
        )
    return folder


def _reuse(config: pytest.Config) -> Path | None:
    """Return the directory in which episodes are kept from session to session, if given."""
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
    return _checked_folder(folder, "--dura-reuse", "episodes are kept in a directory")


def _cassette(config: pytest.Config) -> Path | None:
    """Return the cassette, where the mode has one."""
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
    return config.invocation_params.dir / given if given else config.rootpath / _DEFAULT_CASSETTE


_EXECUTOR_OPTION = "--dura-executor"
_TIMEOUT_OPTION = "--dura-episode-timeout"


def _executor_choice(config: pytest.Config, seconds: float | None) -> ExecutorChoice | None:
    """Return the executor that the options name; ``None`` for this process.

    Args:
        config: The session's configuration.
        seconds: What an episode may take in another process, if that was given.

    Raises:
        ConfigurationError: If there is none, or another option does not go with it.
    """
    text = config.getoption("dura_executor")
    if text in (None, "in-process"):
        if seconds is not None:
            raise ConfigurationError(
                f"{_TIMEOUT_OPTION} is held by ending the process that simulates, and that is"
                " pytest's own",
                key=_TIMEOUT_OPTION,
                found=f"{seconds:g} without another executor",
                expected=f"{_EXECUTOR_OPTION}=processes, or a Dask cluster",
                remedy=f"add {_EXECUTOR_OPTION}=processes, or leave out"
                f" {_TIMEOUT_OPTION}; each call into a role has --dura-role-timeout",
            )
        return None
    from pytest_dura.execution.executors import ExecutorChoice

    choice = ExecutorChoice.parse(text)
    if seconds is not None:
        choice = replace(choice, seconds=seconds)
    if choice.kind == "processes" and config.getoption("numprocesses", None):
        raise ConfigurationError(
            "the workers of pytest-xdist would each start processes of their own",
            key=_EXECUTOR_OPTION,
            found=f"{text} beside -n {config.getoption('numprocesses')}",
            expected="one of them",
            remedy=f"leave out -n, and give {_EXECUTOR_OPTION}=processes:N the cores; or leave out"
            f" {_EXECUTOR_OPTION}",
        )
    mode = config.getoption("dura_llm")
    if mode in ("record", "replay"):
        raise ConfigurationError(
            "a cassette is of this process, and the episodes would be simulated in others",
            key=_EXECUTOR_OPTION,
            found=f"{text} beside --dura-llm={mode}",
            expected="one of them",
            remedy=f"leave out {_EXECUTOR_OPTION}, or use -n, whose workers share the cassette",
        )
    return choice


_SHARD_OPTION = "--dura-shard"
_MOST_SHARDS = 10_000
_LONGEST = len(f"{_MOST_SHARDS}/{_MOST_SHARDS}")


@dataclass(frozen=True)
class Shard:
    """Part of a session.

    Args:
        index: Its number, from 1.
        count: How many there are.
    """

    index: int
    count: int

    @classmethod
    def read(cls, text: str | None) -> Shard | None:
        """Read the option's value, such as ``2/5``; ``None`` without one.

        Raises:
            ConfigurationError: If it is none.
        """
        if text is None:
            return None
        first, _, last = text.partition("/")
        digits = f"{first}{last}"
        if first and last and digits.isascii() and digits.isdecimal() and len(text) <= _LONGEST:
            shard = cls(int(first), int(last))
            if 1 <= shard.index <= shard.count <= _MOST_SHARDS:
                return shard
        raise ConfigurationError(
            f"{_SHARD_OPTION} takes the number of a shard and how many there are",
            key=_SHARD_OPTION,
            found=text,
            expected=f"K/N with 1 <= K <= N <= {_MOST_SHARDS}",
            remedy=f"for example {_SHARD_OPTION}=2/5 for the second of five shards",
        )

    def __str__(self) -> str:
        return f"shard {self.index} of {self.count}"


_EXCLUDED_OPTIONS = {
    "dura_list": "it lists the whole session",
    "dura_replay": "it runs an episode of the evidence",
    "dura_reduce": "it runs an episode of the evidence",
    "dura_baseline": "a baseline is that of a whole session: give it to the merge of the shards",
}
"""Options that exclude a shard, and why."""


def _shard_of(config: pytest.Config) -> Shard | None:
    """Return the shard that the options name, if they do.

    Raises:
        ConfigurationError: For one that cannot be used, and options that exclude it.
    """
    shard = Shard.read(config.getoption("dura_shard"))
    if shard is None:
        return None
    conflicts = [(name, why) for name, why in _EXCLUDED_OPTIONS.items() if config.getoption(name)]
    if config.getoption("dura_llm") == "record":
        conflicts.append(("dura_llm", "each shard would record a cassette of its own"))
    for name, why in conflicts:
        other = f"--{name.replace('_', '-')}"
        raise ConfigurationError(
            f"{_SHARD_OPTION} and {other} exclude each other: {why}",
            key=_SHARD_OPTION,
            found=f"{shard.index}/{shard.count}",
            expected=f"one of {_SHARD_OPTION} and {other}",
            remedy=f"leave one of them out; {_SHARD_OPTION} is for the jobs of a CI",
        )
    return shard
