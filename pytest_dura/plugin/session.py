"""DuraSession: what a pytest session knows of us, made when it is first needed."""

from __future__ import annotations

import os
import sys
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.evidence import SessionEvidence
from pytest_dura.plugin.hypothesis_tests import PropertyTests
from pytest_dura.plugin.language_models import LanguageModels
from pytest_dura.plugin.messages import error_text
from pytest_dura.plugin.options import Options
from pytest_dura.plugin.planning import make_plan
from pytest_dura.plugin.repeats import Repeats
from pytest_dura.plugin.reporter import Reporter
from pytest_dura.plugin.scenario_arguments import scenario_arguments
from pytest_dura.plugin.selection import Selection
from pytest_dura.plugin.session_roles import SessionRoles
from pytest_dura.plugin.shards import ShardHooks
from pytest_dura.plugin.shared_episodes import SharedEpisodes
from pytest_dura.plugin.simulating import Simulating

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pytest_dura.campaign.cases import Case
    from pytest_dura.campaign.loading import Library
    from pytest_dura.campaign.runner import Bench
    from pytest_dura.campaign.settling import ParameterResolver
    from pytest_dura.evidence.redaction.redactor import Redactor
    from pytest_dura.plugin.planning import Planned
    from pytest_dura.requirements.model import Requirement


class DuraSession:
    """Options, scenarios, the bench and the plan of one pytest session.

    Args:
        config: The session's configuration.
    """

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.is_worker = hasattr(config, "workerinput")
        self.plan: list[Planned] = []
        self.reporter = Reporter(self)
        self.repeats = Repeats(self)
        self.evidence = SessionEvidence(self)
        self.roles = SessionRoles(self)
        self.models = LanguageModels(self)
        self.simulating = Simulating(self)
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
            from pytest_dura.plugin.replay import replay

            with usage_errors(), self.models:
                return replay(self)
        if self.options.reduce is not None:
            from pytest_dura.plugin.reduce import reduce

            with usage_errors(), self.models:
                return reduce(self)
        if self.options.list_only:
            from pytest_dura.plugin.listing import show_list

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
            from pytest_dura.campaign.loading import load_library

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
        from pytest_dura.evidence.redaction.redactor import Redactor

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
        from pytest_dura.campaign.settling import ParameterResolver

        return ParameterResolver()

    @cached_property
    def bench(self) -> Bench:
        """What runs episodes. Its roles follow the fixtures that the current item sees."""
        from pytest_dura.campaign.runner import Bench
        from pytest_dura.plugin.found_cases import keeper
        from pytest_dura.plugin.progress import listener

        return Bench(
            self.library,
            self.options.seed,
            roles=self.roles.chosen(),
            runs=self.options.runs,
            faults=self.options.faults,
            time_budget=self.options.time_budget,
            end_when_decided=self.options.end_when_decided,
            on_episode=self.reporter.episode_used,
            on_progress=listener(self),
            on_verdict=self.reporter.verdict_reached,
            on_monitors=self.reporter.monitors_judged,
            on_chains=self.reporter.faults_followed,
            on_search=lambda case, found: self.reporter.search_ended(case, found.to_json()),
            on_searched=self.reporter.searched_used,
            keep=keeper(self),
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


_KEY = pytest.StashKey[DuraSession]()


def session_of(config: pytest.Config) -> DuraSession:
    """The one object of a configuration, made at the first call."""
    if _KEY not in config.stash:
        config.stash[_KEY] = DuraSession(config)
    return config.stash[_KEY]
