"""DuraSession: the one object of a pytest session, and the plan of what it runs.

The plan comes from ``--dura-scenarios`` or from arguments that name scenario items, such as
``intersection/nominal::SAF-1``: which cases run as a gate, and which requirements judge each.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import isinf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.episodes import Repeats, SharedEpisodes
from pytest_dura.plugin.evidence import SessionEvidence
from pytest_dura.plugin.executor import SessionExecutor
from pytest_dura.plugin.language_models import LanguageModels
from pytest_dura.plugin.messages import error_text
from pytest_dura.plugin.options import Options
from pytest_dura.plugin.property_tests import PropertyTests
from pytest_dura.plugin.recorder import ItemRecorder
from pytest_dura.plugin.roles import SessionRoles
from pytest_dura.plugin.shards import Selection, ShardHooks

if TYPE_CHECKING:
    from collections.abc import Callable

    from pytest_dura.campaign.reporting import RunningCampaign
    from pytest_dura.evidence.redaction import Redactor
    from pytest_dura.library.cases import Case
    from pytest_dura.library.loading import Library
    from pytest_dura.library.roles import ParameterResolver
    from pytest_dura.plugin.progress import WorkerFile
    from pytest_dura.requirements.model import Requirement
    from pytest_dura.runner import Runner


Chosen = tuple[str, str]
"""A case and a requirement; "" stands for all of its requirements."""


def scenario_arguments(session: DuraSession) -> dict[str, Chosen]:
    """The arguments that name no file and a case, and what they choose.

    Raises:
        ConfigurationError: For an unknown requirement of a case, and scenarios that cannot be read.
    """
    config = session.config
    if config.args_source is not config.ArgsSource.ARGS:
        return {}
    found = {}
    for argument in config.args:
        path, _, requirement = argument.partition("::")
        if path.endswith(".py") or os.path.lexists(config.invocation_params.dir / path):
            continue
        name = _case_name(session, path)
        if name is not None:
            found[argument] = (name, _requirement_name(session, name, requirement))
    return found


def _case_name(session: DuraSession, path: str) -> str | None:
    """The case that an argument names which is no file, if there is such a case."""
    try:
        library = session.library()
    except ConfigurationError as error:
        if session.options.any_given:
            raise
        # Whoever misspelt a path should hear of the path, and whoever meant a scenario of it.
        raise ConfigurationError(
            f"file or directory not found: {path}\n"
            f"and it names no scenario as long as these cannot be read:\n{error}"
        ) from None
    # Terminal lines are relative to where pytest was started.
    absolute = os.path.normpath(session.config.invocation_params.dir / path)
    relative = os.path.relpath(absolute, session.config.rootpath).replace(os.sep, "/")
    for name in (path, relative):
        if re.split(r"[+~]", name, maxsplit=1)[0] in library.scenarios:
            return session.bench.case(name).id
    return None


def _requirement_name(session: DuraSession, name: str, requirement: str) -> str:
    known = session.bench.case(name).requirements
    if requirement and requirement not in known:
        from pytest_dura.core.error_messages import did_you_mean

        raise ConfigurationError(
            f"the case {name!r} has no requirement {requirement!r}",
            found=f"{name}::{requirement}",
            expected="one of " + ", ".join(known) if known else "a case with requirements",
            remedy=did_you_mean(requirement, known),
        )
    return requirement


@dataclass(frozen=True, slots=True)
class Planned:
    """A case whose requirements become scenario items."""

    case: Case
    requirements: tuple[str, ...]


def make_plan(session: DuraSession, chosen: Mapping[str, Chosen]) -> list[Planned]:
    """The cases of the scenarios, or those that arguments name, with their requirements.

    Args:
        session: The session, which takes in each case.
        chosen: What the arguments name, if any do.

    Raises:
        ConfigurationError: For a scenario that nothing would judge, and options that match none.
    """
    from pytest_dura.library.cases import expand_cases, select_cases

    options, library, plan = session.options, session.library(), []
    if chosen:
        # A case of our own arguments may have other faults than its scenario.
        named = {name: session.bench.case(name) for name, _ in chosen.values()}
        found = select_cases(list(named.values()), options.select)
    else:
        found = expand_cases(library.scenarios, options.faults, options.select, library.faults)
    cases = {case.id: case for case in found}
    for name in sorted(cases):
        case = cases[name]
        if not (case.requirements or chosen or options.list_only):
            raise ConfigurationError(
                f"the scenario {name!r} has no requirements, so nothing would judge it",
                file=case.scenario.file or None,
                key="requirements",
                expected="at least one requirement where a scenario is run as a gate",
                remedy="name requirements, or leave the scenario out with --dura-select",
            )
        requirements = case.requirements
        if chosen:
            requirements = tuple(
                requirement
                for requirement in case.requirements
                if any(_chooses(one, name, requirement) for one in chosen.values())
            )
        if requirements:
            session.take_case(case)
            plan.append(Planned(case, requirements))
    return plan


def _chooses(chosen: Chosen, case: str, requirement: str) -> bool:
    return chosen[0] == case and chosen[1] in ("", requirement)


PROGRESS_PLUGIN = "dura-progress"


def begin_progress(session: DuraSession) -> None:
    """Prepare a session with workers, which tell what their controller shows."""
    if session.config.pluginmanager.hasplugin("dsession"):
        _register_progress(session)


def expect_progress(session: DuraSession) -> None:
    """Campaigns are among what this process is to run."""
    file = progress_file(session) if session.is_worker else None
    if file is not None:
        file.expect()


def progress_listener(session: DuraSession) -> Callable[[RunningCampaign], None]:
    """What a bench tells its progress."""
    if session.is_worker:
        file = progress_file(session)
        return _show_nothing if file is None else file.tell
    return _register_progress(session)


def progress_file(session: DuraSession) -> WorkerFile | None:
    """Where a worker tells; ``None`` if nothing is shown."""
    told = getattr(session.config, "workerinput", {})
    if "dura_progress" not in told:
        return None
    from pytest_dura.plugin.progress import PROGRESS_FOLDER, WorkerFile

    folder = session.evidence_directory / PROGRESS_FOLDER
    return WorkerFile(folder, told["dura_progress"], told["workerid"])


def _register_progress(session: DuraSession) -> Callable[[RunningCampaign], None]:
    """What shows it in this process, which takes part in the session from now on."""
    from pytest_dura.plugin.progress_display import display_mode

    way = display_mode(session.config)
    if way is None or (way == "lines" and isinf(session.options.progress_interval)):
        return _show_nothing
    from pytest_dura.plugin.progress import ProgressHooks

    hooks = session.config.pluginmanager.getplugin(PROGRESS_PLUGIN)
    if hooks is None:
        hooks = ProgressHooks(session, way)
        session.config.pluginmanager.register(hooks, PROGRESS_PLUGIN)
    found: Callable[[RunningCampaign], None] = hooks.tell
    return found


def _show_nothing(_: RunningCampaign) -> None:
    """Nothing is shown."""


class DuraSession:
    """Options, scenarios, the bench and the plan of one pytest session.

    Args:
        config: The session's configuration.
    """

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.is_worker = hasattr(config, "workerinput")
        self.plan: list[Planned] = []
        self.reporter = ItemRecorder(self)
        self.repeats = Repeats(self)
        self.evidence = SessionEvidence(self)
        self.roles = SessionRoles(self)
        self.models = LanguageModels(self)
        self.simulating = SessionExecutor(self)
        self.shared = SharedEpisodes(self)
        self.properties = PropertyTests(self)
        self.selection = Selection(self)
        self.named_requirements: set[str] = set()
        """Ids that the markers of collected tests name."""
        self.marked: dict[str, Requirement] = {}
        """Requirements that are defined by markers alone."""
        self._faults_of: dict[str, tuple[dict[str, Any], ...]] = {}
        self._own_arguments: set[str] = set()
        self._library: Library | ConfigurationError | None = None
        self._redactor: Redactor | None = None

    @cached_property
    def options(self) -> Options:
        """The checked options.

        Raises:
            pytest.UsageError: For a value that cannot be used.
        """
        with usage_errors():
            return Options.of(self.config)

    @cached_property
    def shard(self) -> ShardHooks | None:
        """What keeps the items of one shard, if the session is one."""
        return None if self.options.shard is None else ShardHooks(self, self.options.shard)

    @property
    def evidence_directory(self) -> Path:
        """Where the evidence goes: the controller's place, also in a worker."""
        given = getattr(self.config, "workerinput", {}).get("dura_evidence")
        return self.options.evidence if given is None else Path(given)

    @property
    def active(self) -> bool:
        """Whether the session was asked for something of ours."""
        return self.options.any_given or bool(self._own_arguments)

    def reach_project(self) -> None:
        """Let ``planner:MyPlanner`` be imported from where pytest was started, and from the root.

        ``python -m pytest`` finds it there, ``pytest`` does not. At the end of the path it hides
        nothing that is installed; processes that simulate take the path over.
        """
        for folder in (self.config.invocation_params.dir, self.config.rootpath):
            if str(folder) not in sys.path:
                sys.path.append(str(folder))

    def run_command(self) -> int | None:
        """The exit code of ``--dura-list``, ``--dura-replay`` or ``--dura-reduce``, if given."""
        options = self.options
        if options.list_only or options.replay is not None or options.reduce is not None:
            self.reach_project()
        if self.options.replay is not None:
            from pytest_dura.plugin.commands import replay

            with usage_errors(), self.models:
                return replay(self)
        if self.options.reduce is not None:
            from pytest_dura.plugin.commands import reduce

            with usage_errors(), self.models:
                return reduce(self)
        if self.options.list_only:
            from pytest_dura.plugin.commands import show_list

            with usage_errors():
                self.roles.check()
                self._make_plan()
                return show_list(self)
        return None

    def start(self) -> None:
        """Check everything that can be checked before something runs, and plan.

        Raises:
            pytest.UsageError: For options and files that cannot be used.
        """
        if self.active:
            self.reach_project()
        with usage_errors():
            self.models.begin()
            self.roles.check()
            self._make_plan()
            self.models.settle()
            self.evidence.given.read()
            if self.active:
                self.simulating.knock()
                self.evidence.start()

    def begin_evidence(self) -> None:
        """Begin the record of a session that runs episodes.

        Raises:
            pytest.UsageError: If it cannot be written.
        """
        self.reach_project()
        with usage_errors():
            self.evidence.start()
            self.simulating.begin()

    def check_argument(self) -> None:
        """Check the user's argument against what was collected.

        Raises:
            pytest.UsageError: If it refers to what is not there.
        """
        with usage_errors():
            self.evidence.given.check_argument()

    def take_arguments(self) -> None:
        """Leave to pytest the arguments that name files, and none if scenarios run alone."""
        config = self.config
        if self._own_arguments:
            config.args = [one for one in config.args if one not in self._own_arguments]
        elif self.options.scenarios and config.args_source is not config.ArgsSource.ARGS:
            config.args = []

    def library(self) -> Library:
        """All scenarios and requirements, read at the first call.

        Raises:
            ConfigurationError: For files that cannot be used; the same one at every call.
        """
        if self._library is None:
            from pytest_dura.library.loading import load_library

            self.reach_project()
            try:
                self._library = load_library(self.options.paths)
            except ConfigurationError as error:
                self._library = error
        if isinstance(self._library, ConfigurationError):
            raise self._library.with_traceback(None)
        return self._library

    def redact(self, value: Any) -> Any:
        """Plain data without the secrets that this process knows of by now."""
        from pytest_dura.evidence.redaction import Redactor

        if self._redactor is None:
            self._redactor = Redactor(self.config.getini("dura_secrets"))
        self._redactor.learn(os.environ)
        return self._redactor.redact(value)

    @property
    def unused(self) -> Mapping[str, str]:
        """Requirements that neither a scenario nor a collected test uses, and their places.

        Empty where nothing needed the requirement files, or they cannot be used.
        """
        if self._library is None or isinstance(self._library, ConfigurationError):
            return {}
        found = self._library.unused
        return {name: found[name] for name in found if name not in self.named_requirements}

    @cached_property
    def resolver(self) -> ParameterResolver:
        """Resolves the parameters of roles, each class once a session."""
        from pytest_dura.library.roles import ParameterResolver

        return ParameterResolver()

    @cached_property
    def bench(self) -> Runner:
        """What runs episodes. Its roles follow the fixtures that the current item sees."""
        from pytest_dura.plugin.property_tests import counterexample_store
        from pytest_dura.runner import Runner

        return Runner(
            self.library,
            self.options.seed,
            roles=self.roles.chosen(),
            runs=self.options.runs,
            faults=self.options.faults,
            time_budget=self.options.time_budget,
            end_when_decided=self.options.end_when_decided,
            on_episode=self.reporter.episode_used,
            on_progress=progress_listener(self),
            on_verdict=self.reporter.verdict_reached,
            on_monitors=self.reporter.monitors_judged,
            on_chains=self.reporter.faults_followed,
            on_search=lambda case, found: self.reporter.search_ended(case, found.to_json()),
            on_searched=self.reporter.searched_used,
            counterexamples=counterexample_store(self),
            twins=self.options.twins,
            recorded=self.options.evidence_level != "summary",
            store=self.shared.store(),
            role_timeout=self.options.role_timeout,
            resolver=self.resolver,
        )

    def _make_plan(self) -> None:
        chosen = scenario_arguments(self)
        self._own_arguments = set(chosen)
        if self.options.scenarios or self.options.list_only or chosen:
            self.plan += make_plan(self, chosen)
        else:
            self._check_faults_used()

    def take_case(self, case: Case) -> None:
        """Take in a case that is to be run; the record tells cases apart by their ids.

        Raises:
            ConfigurationError: If another test runs other faults under the same id.
        """
        if self._faults_of.setdefault(case.id, case.faults) != case.faults:
            raise ConfigurationError(
                f"the case {case.id!r} stands for other faults elsewhere in this session",
                key="faults",
                found=case.id,
                expected="an id of its own for each fault",
                remedy="give one of the faults another `id`",
            )

    def _check_faults_used(self) -> None:
        """Refuse fault campaigns that nothing of this session would run."""
        given = [value for name, value in self.options.given if name == "--dura-faults"]
        if given:
            raise ConfigurationError(
                "--dura-faults is about scenario cases, and the arguments name none",
                key="--dura-faults",
                found=given[0],
                expected="--dura-scenarios, or a case among the arguments",
                remedy="add --dura-scenarios; a test function names its faults in the marker dura",
            )


class usage_errors:  # noqa: N801 - reads like a statement
    """Context in which a configuration error becomes a usage error: one message, exit code 4."""

    def __enter__(self) -> None:
        """Nothing to prepare."""

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Translate."""
        if isinstance(error, ConfigurationError):
            raise pytest.UsageError(error_text(error)) from None


_STASH_KEY = pytest.StashKey[DuraSession]()


def session_of(config: pytest.Config) -> DuraSession:
    """The one object of a configuration, made at the first call."""
    if _STASH_KEY not in config.stash:
        config.stash[_STASH_KEY] = DuraSession(config)
    return config.stash[_STASH_KEY]
