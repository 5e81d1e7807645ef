"""Property tests: the counterexamples that tests of Hypothesis leave behind when they fail.

A test with ``@given(case=strategies.cases(...))`` runs many cases. Where it fails, Hypothesis
runs the simplest failing case last, and reports the error of that run. The case of that run is
kept as a scenario file in the project's folder of scenarios, if it violates a requirement and
does so again when it is replayed. Counterexamples of searches go into the same folder.
"""

from __future__ import annotations

import functools
import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.messages import printed
from pytest_dura.plugin.options import LONG_NAMES, PROFILE, Options

if TYPE_CHECKING:
    from pytest_dura.campaign.events import SearchedEpisodeUsed
    from pytest_dura.library.cases import SearchedCase
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.search.counterexamples import CounterexampleStore, StoredCounterexample
    from pytest_dura.search.trials import Objective


def _scenario_folder(context: SessionContext) -> Path:
    """Return the first folder of ini ``dura_scenario_paths``; the default need not exist yet.

    Raises:
        ConfigurationError: If the setting names files alone: what is kept elsewhere is run by none.
    """
    given = context.options.scenario_paths
    folders = [path for path in given if path.is_dir()]
    if given and not folders:
        raise ConfigurationError(
            "there is no folder of scenarios that a counterexample could be kept in",
            key="ini dura_scenario_paths",
            found=", ".join(map(str, given)),
            expected="a folder among them",
            remedy="add a folder, such as scenarios",
        )
    return folders[0] if folders else context.config.rootpath / str(Options.scenario_paths.default)


def counterexample_store(context: SessionContext) -> CounterexampleStore:
    """Make what stores a counterexample, and returns its path relative to the project's root."""

    def store(
        case: SearchedCase, objective: Objective, lines: Sequence[str]
    ) -> tuple[StoredCounterexample, str]:
        from pytest_dura.search.counterexamples import write_counterexample

        known = context.library().requirements
        requirement = objective.requirement
        stored = write_counterexample(
            _scenario_folder(context),
            case,
            requirement,
            objective.check,
            defined=known.get(requirement.id) == requirement,
            heading=[str(context.redact(line)) for line in lines],
        )
        return stored, os.path.relpath(stored.file, context.config.rootpath)

    return store


_PROFILE_KEY = "dura_hypothesis"
"""Key in the output of a worker of pytest-xdist."""
_FAILURES = (Exception, pytest.fail.Exception)
_MOST_FAILURES = 8
"""Failing runs that are remembered: the last ones are those that are reported."""


@contextmanager
def explained_fixtures(item: pytest.Item) -> Iterator[None]:
    """Context in which the refusal of Hypothesis to run a test on one run or campaign is ours.

    Raises:
        ConfigurationError: In place of a failed health check that names our fixture, which a test
            may suppress.
    """
    try:
        yield
    except Exception as error:
        if type(error).__name__ != "FailedHealthCheck":
            raise
        from pytest_dura.plugin.items.outcomes import episode_fixtures_of

        names = [
            name
            for short in episode_fixtures_of(item)
            for name in (short, LONG_NAMES + short)
            if f"function-scoped fixture {name!r}" in str(error)
        ]
        if not names:
            raise
        file, line, _ = item.location
        raise ConfigurationError(
            f"@given draws many inputs, and the fixture `{names[0]}` is the same for all of them",
            file=file,
            line=None if line is None else line + 1,
            key="hypothesis.given",
            found=f"`{names[0]}` among the arguments",
            expected="a test that runs each case that it draws",
            remedy=f"take `run_episode` in place of `{names[0]}`, draw the case by "
            '@given(case=strategies.cases("...")), and call run_episode(case)',
        ) from None


def register_profile(config: pytest.Config) -> None:
    """Register the profile ``dura`` if the command line asks Hypothesis for it."""
    if config.getoption("--hypothesis-profile", None) == PROFILE:
        import pytest_dura.strategies  # noqa: F401 - importing it registers the profile


class PropertyTests:
    """Property tests of this process.

    Args:
        context: The session's context.
    """

    def __init__(self, context: SessionContext) -> None:
        self.context = context
        self._cases: list[SearchedCase] = []
        """Cases that the present run of a test function has looked at."""
        self._failed: deque[tuple[BaseException, list[SearchedCase]]] = deque(maxlen=_MOST_FAILURES)
        self._lines: list[str] = []
        self._settings: dict[str, Any] | None = None

    def begin(self) -> Callable[[], None]:
        """Give strategies the session's scenarios; returns what undoes it."""
        from contextlib import ExitStack

        from pytest_dura.library.loading import use_library

        stack = ExitStack()
        stack.enter_context(use_library(self.context.library))
        return stack.close

    def searched_used(self, event: SearchedEpisodeUsed) -> None:
        """Note that the current test looked at an episode of a case that a strategy chose."""
        self._cases.append(event.case)

    @contextmanager
    def watching(self, item: pytest.Function) -> Iterator[None]:
        """Context of a property test; if it fails, its simplest failing case is stored."""
        handle: Any = getattr(item.obj, "hypothesis", None)
        if not hasattr(handle, "inner_test"):
            yield
            return
        inner, handle.inner_test = handle.inner_test, self._watched(handle.inner_test)
        try:
            yield
        except _FAILURES as error:
            for case in self._failing_cases(error):
                self._lines += self._store_lines(item, case)
            raise
        finally:
            handle.inner_test = inner
            self._cases.clear()
            self._failed.clear()

    def add_section(self, report: pytest.TestReport) -> None:
        """Add what was stored to the report of a test."""
        if report.when == "call" and self._lines:
            report.sections.append(("dura", printed("\n".join(self._lines))))
            self._lines = []

    def with_profile(self, header: Mapping[str, Any]) -> dict[str, Any]:
        """Add the profile of Hypothesis to the record's head, where it was imported."""
        from pytest_dura.provenance import describe_hypothesis

        settings = self._settings or describe_hypothesis()
        environment = dict(header["environment"])
        return {
            **header,
            "environment": environment | ({"hypothesis": settings} if settings else {}),
        }

    def send_to_controller(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Add to a worker's output the profile under which it ran its tests."""
        from pytest_dura.provenance import describe_hypothesis

        workeroutput[_PROFILE_KEY] = describe_hypothesis()

    def receive_from_worker(self, workeroutput: Mapping[str, Any]) -> None:
        """Take over the profile of a worker."""
        self._settings = workeroutput.get(_PROFILE_KEY) or self._settings

    def _watched(self, test: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap the test function: note the cases of failing runs."""

        @functools.wraps(test)
        def watched(*arguments: Any, **named: Any) -> Any:
            __tracebackhide__ = True
            self._cases.clear()
            try:
                return test(*arguments, **named)
            except _FAILURES as error:
                self._failed.append((error, list(self._cases)))
                raise

        return watched

    def _failing_cases(self, error: BaseException) -> list[SearchedCase]:
        """List the cases of the runs whose errors are reported, each once."""
        reported = set(map(id, _leaves(error)))
        failed = [
            case for failure, cases in self._failed if id(failure) in reported for case in cases
        ]
        return list({case.id: case for case in failed}.values())

    def _store_lines(self, item: pytest.Item, case: SearchedCase) -> Iterator[str]:
        """Store a case; yields lines on where it is, or why it is not stored."""
        try:
            objective = self._violated(item, case)
            if objective is None:
                yield (
                    f"{case.id} violates no requirement of the test or its scenario: no file is "
                    "kept. Name what it violates with the marker `requirement`."
                )
            else:
                yield from self._store(item, case, objective)
        except ConfigurationError as error:
            yield f"{case.id} is not kept: {error}"

    def _violated(self, item: pytest.Item, case: SearchedCase) -> Objective | None:
        """Return what a case violates of the test's markers, else of the scenario's own."""
        from pytest_dura.plugin.items.markers import marked_requirements
        from pytest_dura.search.trials import Objective

        runner = self.context.runner
        named = {
            requirement.id: requirement for requirement in marked_requirements(self.context, item)
        }
        named |= {item.id: item for item in runner.requirements_of(case) if item.id not in named}
        episode = runner.searched(case)
        for requirement in named.values():
            objective = Objective(requirement)
            if (
                requirement.check
                and not requirement.paired
                and objective.judge(episode).status == "violated"
            ):
                return objective
        return None

    def _store(self, item: pytest.Item, case: SearchedCase, objective: Objective) -> Iterator[str]:
        from pytest_dura.plugin.context import rerun_command
        from pytest_dura.reports.searches import kept_lines
        from pytest_dura.search.counterexamples import (
            confirm_violation,
            store_counterexample,
        )
        from pytest_dura.search.space import SearchSpace
        from pytest_dura.search.trials import Trials

        runner, name = self.context.runner, objective.requirement.id
        original = runner.case(case.scenario.name)
        trials = Trials(runner, SearchSpace(original, (), original.scenario.world), [objective])
        confirmed = confirm_violation(trials, objective, case, 0)
        repeats = confirmed.counterexample.repeats
        if not repeats.confirmed:
            yield (
                f"{case.id} violates {name}, and again in {repeats.violated} of {repeats.runs} "
                f"replays, {repeats.equal} of them with an equal digest: no file is kept"
            )
            return
        written: list[StoredCounterexample] = []
        store = counterexample_store(self.context)

        def storing(*arguments: Any) -> tuple[StoredCounterexample, str]:
            stored = store(*arguments)
            written.append(stored[0])
            return stored

        counterexample = store_counterexample(
            trials, objective, confirmed, storing, f"simplest failing case of {item.nodeid}"
        )
        command = rerun_command(self.context, f"{counterexample.name}::{written[0].requirement.id}")
        yield f"{case.id} violates {name}, confirmed by replay with an equal digest"
        yield from kept_lines(counterexample, command)


def _leaves(error: BaseException) -> Iterator[BaseException]:
    """Yield the error, or the errors that a group holds."""
    inner = getattr(error, "exceptions", None)
    if isinstance(inner, (tuple, list)):
        for member in inner:
            yield from _leaves(member)
    else:
        yield error
