"""Options of the package: one table, from which command line, ini settings and help follow.

A row of :class:`Options` is all that an option needs but its use; see :mod:`pytest_dura.options`.
Guests bring tables of their own, see :mod:`pytest_dura.guests`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import pytest

from pytest_dura.guests import default_domain, guests
from pytest_dura.options import (
    WORKER_KEY,
    Command,
    Option,
    OptionTable,
    as_given,
    existing_paths,
    switch,
    texts,
    unusable,
    whole_number,
)
from pytest_dura.plugin.option_values import (
    AUTO,
    ScenarioChoice,
    Shard,
    builtin_files,
    executor_choice,
    executor_limit,
    export_files,
    fails_if_worse,
    fault_campaigns,
    folder,
    is_choice,
    memory_limit,
    off_switch,
    scenario_choice,
    second_engine,
    seconds,
    seconds_or_never,
    true_or_false,
)

if TYPE_CHECKING:
    from pytest_dura.execution.executors import ExecutorChoice

Level = Literal["summary", "violations", "all"]
"""Which episodes leave a trace in the evidence."""
PROFILE = "dura"
"""Profile of Hypothesis for tests that simulate."""
_ONE_EPISODE = "it runs an episode of the evidence"


class Options(OptionTable):
    """The table, and the checked options of a session as its attributes.

    Args:
        config: The session's configuration.

    Raises:
        ConfigurationError: For a value that cannot be used.
    """

    scenarios: Option[ScenarioChoice | None] = Option(
        "--dura-scenarios",
        "run the project's own scenarios, those of the ini setting dura_scenario_paths; the "
        "built-in ones where it has none, or with =builtin",
        scenario_choice,
        switch_values=("builtin",),
        details="Counterexamples of searches are beside either. With test paths it adds them to "
        "the tests.",
        activates=True,
        brings_cases=True,
        same_in_shards=False,
    )
    scenario_paths: Option[tuple[Path, ...]] = Option(
        None,
        "directories with scenario and requirement files",
        existing_paths,
        ini="dura_scenario_paths",
        ini_type="paths",
        default="scenarios",
        default_note=", if it exists",
    )
    domain: Option[str] = Option(
        None,
        "domain of the project, whose default roles the role fixtures return",
        as_given,
        ini="dura_domain",
        default=default_domain,
        example="mobile_robot",
        details="See [registering](extending.md#what-a-domain-declares).",
    )
    builtin_scenarios: Option[bool] = Option(
        None,
        "whether the built-in scenarios and requirements are known",
        builtin_files,
        ini="dura_builtin_scenarios",
        default="true",
        default_note=", and false where dura_domain names another domain",
    )
    short_fixtures: Option[bool] = Option(
        None,
        "whether fixtures have short names such as orchestrator and generator, beside those that "
        "begin with dura_",
        true_or_false,
        ini="dura_short_fixtures",
        default="true",
        example="false",
        details="See [a good guest](guest.md#names-of-fixtures).",
        same_in_shards=False,
    )
    more_paths: Option[tuple[Path, ...]] = Option(
        "--dura-path",
        "another directory with scenario and requirement files",
        existing_paths,
        metavar="DIR",
        repeatable=True,
        example="my/scenarios",
        activates=True,
        repeated_in=("rerun",),
        same_in_shards=False,
    )
    select: Option[tuple[str, ...]] = Option(
        "--dura-select",
        "run only scenario cases whose name matches",
        texts,
        metavar="GLOB",
        repeatable=True,
        example="intersection/ghost*",
        details="A glob matches the names of cases or scenarios. The name of a case selects that "
        "case alone, and with a `*` behind it those of other faults as well.",
        same_in_shards=False,
    )
    list_only: Option[bool] = Option(
        "--dura-list",
        "list scenarios, faults, requirements and roles, and what would run; run nothing",
        switch,
        same_in_shards=False,
        no_shard="it lists the whole session",
    )
    faults: Option[tuple[Any, ...] | None] = Option(
        "--dura-faults",
        "fault campaigns instead of the scenarios' own, separated by commas: none, a fault, "
        "fault+fault, catalogue, a glob of fault types, or a YAML file with `campaigns:`",
        fault_campaigns,
        metavar="FAULTS",
        repeatable=True,
        example="none,gnss-*",
        activates=True,
        repeated_in=("rerun",),
        changes_episodes=True,
    )
    generator: Option[str | None] = Option(
        "--dura-generator",
        "the component under test: a short name such as rule_based, or package.module:Name",
        as_given,
        metavar="NAME",
        example="aggressive",
        details="A short name is the last part of a registered one, as `--dura-list` shows it.",
        activates=True,
        repeated_in=("rerun",),
        changes_episodes=True,
    )
    simulator: Option[str | None] = Option(
        "--dura-simulator",
        "the simulator that scenarios run in, instead of their own: the last part of a registered "
        "name such as sumo, the whole of it, or package.module:Class",
        as_given,
        ini="dura_simulator",
        metavar="NAME",
        example="sumo",
        details="Same roles and requirements; see [simulators](simulators.md). A scenario that "
        "needs what the simulator lacks is refused before anything runs.",
        activates=True,
        repeated_in=("rerun",),
        changes_episodes=True,
    )
    runs: Option[int | None] = Option(
        "--dura-runs",
        "episodes per case, instead of what is planned",
        whole_number(at_least=1),
        metavar="N",
        example="50",
        activates=True,
        repeated_in=("rerun",),
    )
    seed: Option[int] = Option(
        "--dura-seed",
        "base seed, from which every episode's seed follows",
        whole_number(at_least=0),
        default="0",
        metavar="N",
        example="1",
        activates=True,
        repeated_in=("rerun",),
        same_in_shards=False,
        changes_episodes=True,
    )
    time_budget: Option[float | None] = Option(
        "--dura-time-budget",
        "what the component has for one proposal, instead of what the scenarios say",
        seconds,
        metavar="SECONDS",
        example="1.5",
        activates=True,
        repeated_in=("rerun",),
        changes_episodes=True,
    )
    executor: Option[ExecutorChoice | Literal["auto"] | None] = Option(
        "--dura-executor",
        "where episodes are simulated: auto, one process for each core, or pytest's own process "
        "where it does not fork and few episodes are planned; in-process; processes or "
        "processes:N; the workers of a Dask cluster, dask://HOST:PORT; or another executor that "
        "is registered",
        executor_choice,
        default=AUTO,
        metavar="EXECUTOR",
        example="processes:4",
        details="See [executors](executors.md).",
        same_in_shards=False,
    )
    role_timeout: Option[float] = Option(
        "--dura-role-timeout",
        "what the simulator, and each role but the component, has for one call before its "
        "episode is given up",
        seconds,
        default="60",
        metavar="SECONDS",
        example="30",
        details="A role that blocks for longer is named, and the session goes on.",
        activates=True,
        repeated_in=("rerun",),
    )
    episode_timeout: Option[float | None] = Option(
        "--dura-episode-timeout",
        "what an episode may take in another process (--dura-executor), beside all time "
        "budgets of its component, before that process is ended (default: 3600)",
        executor_limit,
        metavar="SECONDS",
        example="600",
        details="The run is open then where the component was being called, and missing where"
        " another role or the simulator was.",
    )
    episode_memory: Option[int | None] = Option(
        "--dura-episode-memory",
        "memory that a process (--dura-executor) may take beside what it begins with, on systems "
        "that have such a limit",
        memory_limit,
        metavar="SIZE",
        example="2GB",
        details="What asks for more gets a `MemoryError`, or ends its process.",
    )
    shard: Option[Shard | None] = Option(
        "--dura-shard",
        "run the K-th of N parts of the session; `python -m pytest_dura merge` joins their "
        "evidence, and gates on the whole",
        Shard.read,
        metavar="K/N",
        example="2/5",
        activates=True,
        same_in_shards=False,
    )
    end_when_decided: Option[bool | None] = Option(
        "--dura-end",
        "end each episode once every requirement of its case is decided, or run it whole, "
        "instead of what the scenarios say",
        is_choice("decided"),
        choices=("decided", "complete"),
        example="decided",
        details="Scenarios say it with `end_when_decided`.",
        activates=True,
        repeated_in=("rerun",),
        changes_episodes=True,
    )
    clock: Option[Literal["simulated", "wall"] | None] = Option(
        "--dura-clock",
        "run episodes by the wall clock, where the world does not wait for the component, or by "
        "the simulated one, instead of what the scenarios say",
        as_given,
        choices=("simulated", "wall"),
        example="wall",
        details="See [clocks](clocks.md). Scenarios say it with `clock`.",
        activates=True,
        repeated_in=("rerun",),
        changes_episodes=True,
    )
    evidence: Option[Path] = Option(
        "--dura-evidence",
        "where the evidence goes",
        folder("the evidence goes into a directory"),
        default="dura-evidence",
        metavar="DIR",
        example="out",
        details="It replaces what an earlier session left there.",
        activates=True,
        repeated_in=("rerun", "replay"),
        same_in_shards=False,
        sent_to_workers=True,
    )
    evidence_level: Option[Level] = Option(
        "--dura-evidence-level",
        "which episodes leave a trace in the evidence: none, those that violate a requirement "
        "and samples, or all",
        as_given,
        default="violations",
        choices=("summary", "violations", "all"),
        example="summary",
        activates=True,
        repeated_in=("rerun",),
        same_in_shards=False,
        changes_episodes=True,
    )
    export: Option[tuple[str, ...]] = Option(
        "--dura-export",
        "a further format of the evidence, which a bundle does not have by itself: cyclonedx, "
        "in-toto, needs, or one of another package (repeatable); `python -m pytest_dura export` "
        "makes it of a written bundle",
        export_files,
        ini="dura_export",
        ini_type="args",
        metavar="FORMAT",
        repeatable=True,
        example="cyclonedx",
        activates=True,
        same_in_shards=False,
    )
    resume: Option[bool] = Option(
        "--dura-resume",
        "go on with the session that the evidence directory is of, which was interrupted, or "
        "lost a process: its episodes are taken over, unless the project's Python files or the "
        "versions of packages have changed since",
        switch,
        activates=True,
        same_in_shards=False,
    )
    replay: Option[str | None] = Option(
        "--dura-replay",
        "run an episode of the evidence again (case#run) and compare the digests",
        as_given,
        metavar="EPISODE",
        example="intersection/congested#3",
        details="Where they differ first is shown, and a page plays the episode.",
        same_in_shards=False,
        no_shard=_ONE_EPISODE,
    )
    replay_failures: Option[bool] = Option(
        "--dura-replay-failures",
        "run the episodes of the evidence that violate a requirement again, and say whether each "
        "violation is systematic or comes by chance; --dura-runs says how often (default: 5)",
        switch,
        details="No test is run. Overruns of time budgets are measured again. The exit code is 0 "
        "if each violation comes up in each replay.",
        same_in_shards=False,
        no_shard="it runs all failures of the evidence",
    )
    reduce: Option[str | None] = Option(
        "--dura-reduce",
        "find the smallest set of faults with which an episode of the evidence (case#run) "
        "still violates its requirement; --dura-runs limits the runs (default: 100)",
        as_given,
        metavar="EPISODE",
        example="intersection/congested+ghost-obstacle#3",
        details="It is recorded in `<evidence>-reduced`.",
        same_in_shards=False,
        no_shard=_ONE_EPISODE,
    )
    trust_code: Option[bool] = Option(
        "--dura-trust-code",
        "let a bundle, or a scenario or fault file from outside the project, name code that "
        "lies beside it, and any installed package: it is imported, and runs as you",
        switch,
        details="See [what is trusted](trust.md).",
        repeated_in=("rerun", "replay"),
    )
    warn_undecided: Option[bool] = Option(
        "--dura-undecided",
        "what a verdict does to its test that is undecided only since its valid runs are too few: "
        "fail it, or skip it; what is undecided for another reason fails",
        is_choice("warn"),
        default="fail",
        choices=("fail", "warn"),
        example="warn",
        same_in_shards=False,
    )
    twins: Option[bool] = Option(
        "--dura-no-twins",
        "run no fault-free twins of episodes with faults, and so do not say which faults "
        "reached the component's proposals",
        off_switch,
    )
    require_repeatable: Option[bool] = Option(
        None,
        "whether the gate fails for a case of which no episode was run twice, or whose repeated "
        "episode differs, also where the component or the simulator declares that",
        switch,
        ini="dura_require_repeatable",
        ini_type="bool",
        default="false",
        details="See [repeated episodes](determinism.md#repeated-episodes).",
    )
    repeatable: Option[bool] = Option(
        None,
        "whether the verdicts on a case whose repeated episode differs are undecided; if false, "
        "its runs count as draws, and reports say so",
        true_or_false,
        ini="dura_repeatable",
        default="true",
        example="false",
        details="See [repeated episodes](determinism.md#repeated-episodes).",
    )
    baseline: Option[str | None] = Option(
        "--dura-baseline",
        "compare the rates of violations with this evidence: evidence.json, or its directory",
        as_given,
        metavar="PATH",
        example="main/evidence.json",
        activates=True,
        same_in_shards=False,
        no_shard="a baseline is that of a whole session: give it to the merge of the shards",
    )
    fail_worse: Option[bool] = Option(
        "--dura-baseline-worse",
        "what a rate that got worse than the baseline's does to the session",
        fails_if_worse,
        default="warn",
        choices=("fail", "warn"),
        example="fail",
        same_in_shards=False,
    )
    progress_interval: Option[float] = Option(
        None,
        "seconds, at least, between lines on the progress of campaigns where there is no "
        "terminal, or `never`",
        seconds_or_never,
        ini="dura_progress_interval",
        default="30",
        same_in_shards=False,
    )
    second_engine: Option[bool] = Option(
        None,
        "who evaluates formulas: own, or both, which lets rtamt evaluate them as well and fails "
        "the gate where the two differ",
        second_engine,
        ini="dura_stl_engine",
        default="own",
        example="both",
        details="See [two engines for formulas](verdicts.md#two-engines-for-formulas).",
    )
    secrets: Option[tuple[str, ...]] = Option(
        None,
        "names of environment variables, or globs of them in letters of any case, whose values "
        "are kept out of the evidence, beside those whose names speak of secrets",
        texts,
        ini="dura_secrets",
        ini_type="args",
    )

    title = "dependability of AI-enabled cyber-physical systems"

    def __init__(self, config: pytest.Config) -> None:
        super().__init__(config)
        self.of_guests = {name: guest.options(config) for name, guest in guests().items()}
        """Options of the guests, by their names."""
        if self.shard is not None:
            self._check_shard(self.shard)
        if self.select and not (self.brings_cases or self.list_only):
            raise unusable(
                "--dura-select chooses among scenario cases, and there are none without "
                "--dura-scenarios",
                key=Options.select.key,
                found=self.select[0],
                remedy="add --dura-scenarios; choose test functions with -k",
            )

    @property
    def paths(self) -> tuple[Path, ...]:
        """Places of scenario files but the built-in."""
        return self.scenario_paths + self.more_paths

    @property
    def is_command(self) -> bool:
        """Whether the session lists, replays or reduces, and so runs no tests."""
        again = self.replay_failures or self.replay is not None or self.reduce is not None
        return self.list_only or again

    @property
    def brings_cases(self) -> bool:
        """Whether an option names scenarios whose cases become items."""
        return any(row.brings_cases and row.typed(self.config) is not None for row in option_rows())

    @property
    def activated(self) -> bool:
        """Whether an option asks for evidence, whatever the tests of the session are."""
        return any(row.activates and row.typed(self.config) is not None for row in option_rows())

    def repeated(
        self, command: Command, instead: Mapping[str, str | None] | None = None
    ) -> list[str]:
        """List the arguments of a command that runs something of this session again.

        Args:
            command: Which command.
            instead: Texts for what was given, by options; ``None`` leaves the option out.
        """
        arguments = []
        for row in option_rows():
            given = row.typed(self.config) if command in row.repeated_in else None
            given = (instead or {}).get(row.key, given)
            values = given if isinstance(given, list) else [] if given is None else [given]
            arguments += [row.key if text is True else f"{row.key}={text}" for text in values]
        return arguments

    def compared_in_shards(self) -> dict[str, str]:
        """Return what all shards have to have in common: option to value, as JSON."""
        given = {row.key: row.typed(self.config) for row in option_rows() if row.same_in_shards}
        return {key: json.dumps(value) for key, value in given.items() if value is not None}

    def paths_for_workers(self) -> dict[str, str]:
        """Return the paths of the controller, as its workers take them."""
        tables = (self, *self.of_guests.values())
        return {key: path for table in tables for key, path in table.for_workers()}

    def _check_shard(self, shard: Shard) -> None:
        ours = Options.shard.key
        for row in option_rows():
            if row.excludes_shard(self.config):
                from pytest_dura.core.errors import ConfigurationError

                raise ConfigurationError(
                    f"{ours} and {row.key} exclude each other: {row.no_shard}",
                    key=ours,
                    found=f"{shard.index}/{shard.count}",
                    expected=f"one of {ours} and {row.key}",
                    remedy=f"leave one of them out; {ours} is for the jobs of a CI",
                )


def option_rows() -> tuple[Option[Any], ...]:
    """List the rows of the table, and of those of the guests."""
    tables: list[type[OptionTable]] = [Options]
    tables += (guest.options for guest in guests().values())
    return tuple(row for table in tables for row in table.rows())


WAITING = "dura-waiting"
"""Name of the plugin that waits for the first use of the package."""
SET_ASIDE = pytest.StashKey[bool]()
"""Whether the session exempted objects from searches for cycles, until it has ended."""
LONG_NAMES = "dura_"
"""What the long names of fixtures begin with; the rest of them is the short name."""


def short_names(config: pytest.Config) -> bool:
    """Whether fixtures have short names as well; what is no truth value is refused elsewhere."""
    return str(Options.short_fixtures.given(config)).lower() != "false"


def possible_items(config: pytest.Config) -> Iterator[tuple[str, str]]:
    """Yield the arguments that may name scenario items, each with what stands before its ``::``.

    They name no file, or a YAML file, by which test explorers of editors name what it declares.
    """
    if config.args_source is not config.ArgsSource.ARGS:
        return
    for argument in config.args:
        path = argument.partition("::")[0]
        is_scenario = path.endswith((".yaml", ".yml"))
        missing = not os.path.lexists(config.invocation_params.dir / path)
        if is_scenario or (missing and not path.endswith(".py")):
            yield argument, path


def asks_for_session(config: pytest.Config) -> bool:
    """Whether an option, a setting or an argument asks for something of this package."""
    return (
        any(row.given(config) is not None for row in option_rows())
        or config.getoption("--hypothesis-profile", None) == PROFILE
        or any(possible_items(config))
    )


def add_options(parser: pytest.Parser) -> None:
    """Declare everything that can be set from outside, that of guests under their names.

    Raises:
        pytest.UsageError: For a guest that cannot be loaded.
    """
    groups: dict[str, tuple[str, type[OptionTable]]] = {"dura": (Options.title, Options)}
    try:
        known = guests()
    except Exception as error:
        raise pytest.UsageError(str(error)) from error
    for name, guest in known.items():
        groups[f"dura-{name}"] = f"{name}: {guest.options.title}", guest.options
    for group_name, (title, table) in groups.items():
        group = parser.getgroup(group_name, title)
        for row in table.rows():
            row.declare(parser, group)


def send_options(options: Options, workerinput: dict[str, Any]) -> None:
    """Send a worker of pytest-xdist the paths of the controller."""
    workerinput[WORKER_KEY] = options.paths_for_workers()
