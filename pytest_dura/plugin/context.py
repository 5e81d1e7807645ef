"""SessionContext: what every part of a session reads, and commands that run part of it again.

It imports no part of the session, and no part imports the whole: what a part needs of another one
is an argument of its constructor.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError, list_names
from pytest_dura.plugin.guests import SessionGuests
from pytest_dura.plugin.messages import typed_path, usage_errors
from pytest_dura.plugin.options import Options

if TYPE_CHECKING:
    import pytest

    from pytest_dura.campaign.runner import Runner
    from pytest_dura.evidence.redaction import Redactor
    from pytest_dura.library.cases import Case
    from pytest_dura.library.fault_campaigns import Faults
    from pytest_dura.library.loading import Library
    from pytest_dura.library.roles import ParameterResolver
    from pytest_dura.library.scenario import Scenario
    from pytest_dura.requirements.model import Requirement


@dataclass(frozen=True, slots=True)
class Planned:
    """A case whose requirements become scenario items."""

    case: Case
    requirements: tuple[str, ...]


class SessionContext:
    """Options, scenarios and the plan of one pytest session.

    Args:
        config: The session's configuration.
    """

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.is_worker = hasattr(config, "workerinput")
        self.plan: list[Planned] = []
        self.own_arguments: set[str] = set()
        """Arguments that name scenario items, and no files."""
        self.named_requirements: set[str] = set()
        """Ids that the markers of collected tests name."""
        self.marked: dict[str, Requirement] = {}
        """Requirements that are defined by markers alone."""
        self.by_marker: dict[int, tuple[pytest.Mark, Requirement]] = {}
        """By the identity of each marker, which is kept, so that no other object takes it."""
        self._faults_of: dict[str, Faults] = {}
        self._worlds_of: dict[str, Mapping[str, Any]] = {}
        self._library: Library | ConfigurationError | None = None
        self._redactor: Redactor | None = None
        self.guests = SessionGuests(self, lambda: self.options.of_guests, lambda: self.worker_input)

    @cached_property
    def options(self) -> Options:
        """Checked options.

        Raises:
            pytest.UsageError: For a value that cannot be used.
        """
        with usage_errors():
            return Options(self.config)

    @property
    def worker_input(self) -> Mapping[str, Any]:
        """Mapping that the controller sent to this worker; empty in the controller."""
        given: Mapping[str, Any] = getattr(self.config, "workerinput", {})
        return given

    @property
    def worker_name(self) -> str:
        """Name of this process among the workers of pytest-xdist; ``main`` in the controller."""
        return str(self.worker_input.get("workerid", "main"))

    @property
    def root(self) -> Path:
        """Root directory of pytest."""
        return self.config.rootpath

    @property
    def active(self) -> bool:
        """Whether options or arguments ask for something of this package."""
        return self.options.activated or bool(self.own_arguments)

    @property
    def runs_scenarios_alone(self) -> bool:
        """Whether options or arguments name scenarios, and nothing names a test."""
        if self.own_arguments:
            return self.own_arguments.issuperset(self.config.args)
        return self.options.brings_cases and (
            self.config.args_source is not self.config.ArgsSource.ARGS
        )

    def extend_import_path(self) -> None:
        """Make ``planner:MyPlanner`` importable from where pytest was started, and from the root.

        ``python -m pytest`` finds it there, ``pytest`` does not. At the end of the path it hides
        nothing that is installed; processes that simulate take the path over.
        """
        for folder in (self.config.invocation_params.dir, self.config.rootpath):
            if str(folder) not in sys.path:
                sys.path.append(str(folder))

    @cached_property
    def runner(self) -> Runner:
        """Runner of episodes, made at the first use."""
        raise NotImplementedError

    def library(self) -> Library:
        """Load all scenarios and requirements, at the first call.

        Raises:
            ConfigurationError: For files that cannot be used; the same one at every call.
        """
        if self._library is None:
            from pytest_dura.core.collector import MAX_KEPT_OBJECTS, rare_collections
            from pytest_dura.library.loading import load_library

            others_alone = self.options.brings_cases and not self.options.scenarios
            self.extend_import_path()
            try:
                with rare_collections(MAX_KEPT_OBJECTS):
                    self._library = load_library(
                        self.options.paths,
                        builtin=self.options.builtin_scenarios and not others_alone,
                        brought=self._brought_requirements(),
                        recorded=self._of_guests(),
                        judging=self.guests.judging(),
                    )
            except ConfigurationError as error:
                self._library = error
        if isinstance(self._library, ConfigurationError):
            raise self._library.with_traceback(None)
        return self._library

    def gate_scenarios(self) -> Mapping[str, Scenario]:
        """Return the scenarios that the options run as a gate, by name.

        Raises:
            ConfigurationError: For files that cannot be used, and a glob that names a built-in
                scenario where the project's own are run.
        """
        from pytest_dura.library.cases import may_match_scenario

        options, library = self.options, self.library()
        scenarios = library.gate(options.scenarios or ("project" if options.list_only else None))
        for glob in options.select:
            if any(may_match_scenario(name, [glob]) for name in scenarios):
                continue
            if any(may_match_scenario(name, [glob]) for name in library.builtin - set(scenarios)):
                raise ConfigurationError(
                    f"{glob!r} names a built-in scenario, and the project's own are run",
                    key="--dura-select",
                    found=glob,
                    expected=f"one of {list_names(library.own)}, or a glob of them",
                    remedy="run the built-in ones by --dura-scenarios=builtin",
                )
        return scenarios

    def _of_guests(self) -> Sequence[Scenario]:
        """Return the scenarios that options of guests name.

        Raises:
            ConfigurationError: If they cannot be used, or an option that is given names none.
        """
        for name, guest in self.guests.named():
            rows = [row for row in guest.options.rows() if row.brings_cases]
            given = [row.key for row in rows if row.typed(self.config) is not None]
            if given and not self.guests.scenarios[name]:
                raise ConfigurationError(
                    f"{given[0]} names no scenario",
                    key=given[0],
                    found=f"none of the guest {name}",
                    expected="one scenario or more",
                    remedy="change its value, or leave it out",
                )
        return [scenario for each in self.guests.scenarios.values() for scenario in each]

    def _brought_requirements(self) -> Sequence[Path]:
        """Requirement files that come with the component of ``--dura-generator``.

        Raises:
            ConfigurationError: If there is no such component.
        """
        if self.options.generator is None:
            return ()
        from pytest_dura.library.roles import generator_of_option

        component = generator_of_option(self.options.generator).resolve()
        return tuple(getattr(component, "requirement_files", ()))

    def redact(self, value: Any) -> Any:
        """Copy plain data without the secrets that this process knows of by now."""
        return self.redactor.redact(value)

    @property
    def redactor(self) -> Redactor:
        """Redactor of the secrets that this process knows of by now, for all texts of a report."""
        from pytest_dura.evidence.redaction import Redactor

        if self._redactor is None:
            self._redactor = Redactor(self.options.secrets)
        self._redactor.learn(os.environ)
        return self._redactor

    @property
    def time_budgets(self) -> list[float]:
        """Seconds that the option or the planned scenarios give the component for a proposal."""
        budgets = {planned.case.scenario.time_budget for planned in self.plan}
        if self.options.time_budget is not None:
            budgets = {self.options.time_budget}
        return sorted(budget for budget in budgets if budget is not None)

    @property
    def unused(self) -> Mapping[str, str]:
        """Requirements that neither a scenario nor a collected test uses: name to place.

        Empty where nothing needed the requirement files, or they cannot be used.
        """
        if self._library is None or isinstance(self._library, ConfigurationError):
            return {}
        unused = self._library.unused
        return {name: unused[name] for name in unused if name not in self.named_requirements}

    @cached_property
    def resolver(self) -> ParameterResolver:
        """Resolver of the parameters of roles, each class once a session."""
        from pytest_dura.library.roles import ParameterResolver

        return ParameterResolver()

    def register_case(self, case: Case) -> None:
        """Register a case that is to be run; the record tells cases apart by their ids.

        Raises:
            ConfigurationError: If another test runs other faults, or another world, under the
                same id.
        """
        from pytest_dura.library.cases import same_name

        if self._worlds_of.setdefault(case.id, case.scenario.world) != case.scenario.world:
            raise same_name(case.id)
        if self._faults_of.setdefault(case.id, case.faults) != case.faults:
            raise ConfigurationError(
                f"the case {case.id!r} stands for other faults elsewhere in this session",
                key="faults",
                found=case.id,
                expected="an id of its own for each fault",
                remedy="give one of the faults another `id`",
            )


def replay_command(context: SessionContext, episode: str, evidence: Path | None = None) -> str:
    """Return the command that runs an episode of this evidence, or of another one, again."""
    instead: dict[str, str | None] = {}
    if evidence is not None:
        instead["--dura-evidence"] = typed_path(evidence, context.config.invocation_params.dir)
    instead |= context.guests.in_replay()
    options = context.options.repeated("replay", instead)
    # The same arguments load the same conftest files, where a component may be defined.
    paths = _path_arguments(context)
    return _pytest_command(context, [f"--dura-replay={episode}", *options, *paths])


def rerun_command(context: SessionContext, item: str) -> str:
    """Return the command that runs one item again."""
    # Test functions name their faults themselves, and without scenario cases the option is refused.
    is_test = item.partition("::")[0].endswith(".py")
    given = context.options.repeated("rerun", {"--dura-faults": None} if is_test else None)
    return _pytest_command(context, [item, *given])


def _path_arguments(context: SessionContext) -> list[str]:
    config = context.config
    if config.args_source is not config.ArgsSource.ARGS:
        return []
    here = config.invocation_params.dir
    paths = dict.fromkeys(argument.partition("::")[0] for argument in config.args)
    return [path for path in paths if os.path.lexists(here / path)]


def _pytest_command(context: SessionContext, arguments: list[str]) -> str:
    option = context.config.option
    setup = ["-c", option.inifilename] if option.inifilename else []
    if option.rootdir:
        setup.append(f"--rootdir={option.rootdir}")
    return " ".join(["pytest", *map(_quoted, [*setup, *arguments])])


def _quoted(argument: str) -> str:
    """Quote the value alone, which reads better: ``--dura-replay='case#run'``."""
    name, equals, value = argument.partition("=")
    if argument.startswith("--") and equals:
        return f"{name}={shlex.quote(value)}"
    return shlex.quote(argument)


def draws_reason(context: SessionContext, case: Case | None) -> str:
    """Name what declares that equal seeds may give other episodes; empty if nothing does.

    Args:
        context: The session's context.
        case: ``None`` where it is not known.
    """
    if not context.options.repeatable:
        return "the session sets dura_repeatable = false"
    if case is None:
        return ""
    from pytest_dura.execution.task import draws_reason as declared

    return declared(context.runner.task(case).spec)
