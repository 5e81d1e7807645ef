"""SessionHooks: hooks of a few lines, each of which delegates to a part of the session.

They are registered once a session uses the package; see :mod:`pytest_dura.plugin.waiting`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Generator, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.boundary import EXIT_CODE, end_process, lasting_guard
from pytest_dura.core.collector import MAX_KEPT_OBJECTS, make_old, rare_collections, set_aside
from pytest_dura.core.errors import DuraError
from pytest_dura.plugin.items.guest_items import guest_items
from pytest_dura.plugin.items.markers import (
    RefusedMarkerError,
    check_markers,
    check_parameter_sets,
    check_spelling,
    names_no_scenario,
    parametrize,
    run_marked_search,
    unread_marker,
)
from pytest_dura.plugin.items.property_tests import explained_fixtures, register_profile
from pytest_dura.plugin.items.scenario_items import AtRoot, note_repetitions, scenario_items
from pytest_dura.plugin.messages import (
    apply_code_places,
    escape_error,
    escape_reason,
    print_lines,
    redact_error,
    redact_report,
)
from pytest_dura.plugin.options import LONG_NAMES, SET_ASIDE, WAITING, send_options
from pytest_dura.plugin.session.session import session_of

if TYPE_CHECKING:
    import warnings

    from xdist.remote import Producer
    from xdist.scheduler import LoadScheduling
    from xdist.workermanage import WorkerController

    from pytest_dura.plugin.session.session import DuraSession

HOOKS = "dura-session"
"""Name under which pytest knows the hooks."""
_PREPARED = pytest.StashKey[bool]()


def prepare(config: pytest.Config) -> DuraSession:
    """Make the session, and say what code its files may name; a second call does nothing."""
    if not config.stash.get(_PREPARED, False):
        config.stash[_PREPARED] = True
        register_profile(config)
        apply_code_places(config)
    return session_of(config)


def run_command(config: pytest.Config) -> int | None:
    """Answer the options that run no tests, such as ``--dura-list``; ``None`` without any."""
    session = prepare(config)
    if not session.options.is_command:
        return None
    from pytest_dura.plugin.commands import command_line as commands

    return commands.run_command(session)


def begin(config: pytest.Config, started: pytest.Session | None = None) -> SessionHooks:
    """Let the session's hooks follow it; a second call does nothing.

    Args:
        config: Of the session.
        started: pytest's session, if it has started before.
    """
    hooks: SessionHooks | None = config.pluginmanager.get_plugin(HOOKS)
    if hooks is None:
        collecting = ExitStack()
        collecting.enter_context(rare_collections(MAX_KEPT_OBJECTS))
        config.add_cleanup(collecting.close)
        session = prepare(config)
        config.add_cleanup(session.properties.begin())
        hooks = SessionHooks(session, collecting)
        config.pluginmanager.register(hooks, HOOKS)
        config.pluginmanager.register(EndHooks(session), f"{HOOKS}-end")
        config.pluginmanager.register(InnermostHooks(hooks), f"{HOOKS}-innermost")
        config.pluginmanager.unregister(name=WAITING)
        if started is not None:
            hooks.pytest_sessionstart(started)
    return hooks


def uses_runner(item: pytest.Item | pytest.Metafunc | pytest.FixtureRequest) -> bool:
    """Whether the item runs episodes: our ``orchestrator`` alone asks for ``dura_metrics``.

    Names such as ``episode`` or ``generator`` may be fixtures of other people's own.
    """
    return "dura_metrics" in getattr(item, "fixturenames", ())


def lacks_case(item: pytest.Item) -> bool:
    """Whether the item asks for an episode of no scenario, which it cannot get.

    A project may lack a fixture of its own that has the name of one of ours.
    """
    given = getattr(getattr(item, "callspec", None), "params", {})
    names = getattr(item, "fixturenames", ())
    lacked = (name for name in names if name not in given)
    return any(name.removeprefix(LONG_NAMES) in ("episode", "campaign") for name in lacked)


def _test_of(item: pytest.Item) -> tuple[str, str]:
    """Identify a test function, whatever its parameters are."""
    return item.parent.nodeid if item.parent else "", getattr(item, "originalname", "") or item.name


class EndHooks:
    """Hook around the session's end: what other plugins do there, and the terminal's summary."""

    def __init__(self, session: DuraSession) -> None:
        self.session = session

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> Generator[None, Any, Any]:
        """Let the record say so if an interruption comes before all of it is done."""
        with self.session.evidence.ending(session):
            return (yield)


class InnermostHooks:
    """Hooks that act before those of other plugins see what pytest made."""

    def __init__(self, hooks: SessionHooks) -> None:
        self._hooks = hooks

    @pytest.hookimpl(wrapper=True, trylast=True)
    def pytest_runtest_makereport(self) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Take secrets out of a report: Allure's plugin reads it here, in either order."""
        report = yield
        if self._hooks.has_own_items:
            redact_report(report, self._hooks.session.redactor)
        return report


class SessionHooks:
    """Hooks of one session, registered in the controller and in every worker alike."""

    def __init__(self, session: DuraSession, collecting: ExitStack) -> None:
        self.session = session
        self._collecting = collecting
        """What holds until tests are collected."""
        self._pytest_session: pytest.Session | None = None
        self._pid = os.getpid()
        self._guard: ExitStack | None = None
        self.has_own_items = False
        """Whether the session uses the package; reports of other sessions stay as they are."""
        self._refused: dict[tuple[str, str], str] = {}
        """Why the markers of a test cannot be used."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionstart(self, session: pytest.Session) -> None:
        """Check the options before anything runs."""
        self._pytest_session = session
        self.session.start()
        if self.session.active:
            self._begin_guard()
        if session.config.pluginmanager.hasplugin("dsession"):
            _ = self.session.progress  # workers are begun next, and learn of it then
        if self.session.shard is not None:
            session.config.pluginmanager.register(self.session.shard, "dura-shard")

    def pytest_report_header(self) -> list[str]:
        """Name the component under test."""
        from pytest_dura.plugin.session.terminal import header

        session = self.session
        if not session.active:
            return []
        return header(
            session,
            roles=session.roles,
            executor=session.executor,
            shared=session.shared,
            baseline=session.evidence.given.baseline,
        )

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_collection(self) -> Generator[None, Any, Any]:
        """Take scenario items out of the arguments, which pytest would look up as files."""
        self.session.take_arguments()
        with self._collecting:
            return (yield)

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Make one test per case and run."""
        definition = metafunc.definition
        marker = definition.get_closest_marker("dura")
        check_parameter_sets(definition)
        try:
            if uses_runner(metafunc):
                check_spelling(definition)
            if marker is not None:
                parametrize(self.session, metafunc, marker)
            elif uses_runner(metafunc) or definition.get_closest_marker("falsify"):
                check_markers(self.session, definition)
        except RefusedMarkerError as error:
            self._refused[_test_of(definition)] = str(error)

    def pytest_itemcollected(self, item: pytest.Item) -> None:
        """Let the runner follow the role fixtures that the item sees, before any other fixture."""
        if uses_runner(item):
            for marker in item.iter_markers("xfail"):
                escape_reason(marker)
            names: list[str] = item.fixturenames  # type: ignore[attr-defined]
            if names[0] != "_dura_roles":
                names.insert(0, "_dura_roles")

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_collection_modifyitems(
        self, session: pytest.Session, items: list[pytest.Item]
    ) -> Generator[None, Any, Any]:
        """Add the scenario items, and note which items others leave."""
        if self.session.plan:
            items += scenario_items(self.session, session)
        items += guest_items(self.session, session, items)
        self._note_requirements(items)
        self._label(items)
        self.session.selection.plan(list(filter(uses_runner, items)))
        result = yield
        self.session.selection.select(list(filter(uses_runner, items)))
        return result

    def _note_requirements(self, items: list[pytest.Item]) -> None:
        """Note which requirements the markers of items name, of those before the first use too."""
        # No iterator of pytest's own: there may be tens of thousands of items.
        named = self.session.named_requirements
        seen: set[int] = set()
        for item in items:
            node: pytest.Item | pytest.Collector | None = item
            while node is not None and id(node) not in seen:
                seen.add(id(node))
                for marker in node.own_markers:
                    if marker.name == "requirement":
                        named.update(map(str, marker.args[:1]))
                        named.add(str(marker.kwargs.get("id", "")))
                node = node.parent

    def _label(self, items: list[pytest.Item]) -> None:
        own_items = list(filter(uses_runner, items))
        if not own_items:
            return
        from pytest_dura.plugin.session.allure_results import is_used, mark_item

        if is_used(self.session.config):
            for item in own_items:
                mark_item(self.session, item)

    @pytest.hookimpl(tryfirst=True)  # before a worker reports that it has collected
    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Note what will run, in a record that replaces an earlier session's."""
        own_items = list(filter(uses_runner, session.items))
        if self.session.shard is None:  # a shard deselects what other shards run
            self.session.selection.select(own_items)
        note_repetitions(own_items)
        if self.session.is_worker and own_items:
            from pytest_dura.plugin.session.xdist import note_subjects

            note_subjects(session.config, session.items)
        node_ids = [item.nodeid for item in own_items]
        self.has_own_items = bool(node_ids) or self.session.active
        if node_ids:
            self._begin_guard()
        if self.has_own_items and session.config.getoption("allure_report_dir", None):
            from pytest_dura.plugin.session.allure_results import redact_results

            redact_results(session.config, self.session.redact)
        # The record of an earlier session must not be taken for that of this one, whatever it runs.
        earlier = bool(node_ids) and (self.session.options.evidence / "evidence.json").exists()
        foreign = (lacks_case(item) and self._refusal_of(item) is None for item in own_items)
        if earlier or not all(foreign):
            self.session.begin_evidence(own_items)
        if self.session.evidence.record is not None:
            marked = [item.nodeid for item in own_items if item.get_closest_marker("dura")]
            self.session.evidence.note_tests(node_ids, marked)
        self.session.evidence.expect([item.nodeid for item in session.items])
        make_old()  # else Python, which may look again from now on, looks at all of that first
        self._collecting.close()

    def pytest_report_collectionfinish(self, items: Sequence[pytest.Item]) -> list[str]:
        """Name the requirements that nothing uses, and who simulates."""
        lines = []
        if self.session.plan and (own_items := list(filter(uses_runner, items))):
            # The terminal may get here before `pytest_collection_finish` of this class.
            self.session.executor.choose(self.session, own_items)
            verbose = self.session.config.get_verbosity() > 0
            lines = self.session.executor.chosen(verbose=verbose)
        if not self.session.unused:
            return lines
        from pytest_dura.plugin.session.terminal import unused_requirements

        return lines + unused_requirements(self.session)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        """Begin an attempt; fail a test whose markers cannot be used before anything skips it."""
        self.session.recorder.attempt_begins(item)
        self.session.executor.item_begins(is_test=not isinstance(item, AtRoot))
        refusal = self._refusal_of(item)
        if refusal is not None:
            if self.has_own_items:
                self.session.recorder.remark("objection", f"{item.nodeid}: a marker cannot be used")
            pytest.fail(refusal, pytrace=False)

    def _refusal_of(self, item: pytest.Item) -> str | None:
        """Return why a test must not run: it would run nothing and pass."""
        refusal = self._refused.get(_test_of(item)) if self._refused else None
        names_scenario = any(
            marker.name == "dura" and not names_no_scenario(marker) for marker in item.own_markers
        )
        if refusal is None and names_scenario and not hasattr(item, "callspec"):
            return (
                "the marker dura runs nothing here: a test of unittest.TestCase takes no fixtures; "
                "write a function, or a class of its own"
            )
        parameters: Any = getattr(item, "callspec", None)
        if refusal is None and parameters is not None:
            return unread_marker(item, parameters.marks)
        return refusal

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_teardown(self, item: pytest.Item, nextitem: pytest.Item | None) -> None:
        """Repeat an episode of a case after the last item on it, while its roles are there."""
        if uses_runner(item):
            self.session.recorder.add(self.session.repeats.item_ends(item, nextitem))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtestloop(self) -> Generator[None, Any, Any]:
        """Note that the loop over the items ended by itself."""
        result = yield
        self.session.evidence.ran_to_end = True
        return result

    @pytest.hookimpl(wrapper=True, trylast=True)
    def pytest_fixture_setup(self, request: pytest.FixtureRequest) -> Generator[None, Any, Any]:
        """Escape the error of a fixture of our tests before it is passed on."""
        try:
            return (yield)
        except BaseException as error:  # also of `pytest.skip`; it is raised again
            if uses_runner(request):
                escape_error(error)
            raise

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, Any, Any]:
        """Record what an attempt at an item came to: not each that is made again is reported."""
        error: BaseException | None = None
        try:
            with explained_fixtures(item):
                return (yield)
        except DuraError as refusal:
            error = pytest.fail.Exception(str(refusal), pytrace=False)
            raise error from None
        except BaseException as raised:  # also of `pytest.fail`; it is raised again
            error = raised
            raise
        finally:
            ends = isinstance(error, (KeyboardInterrupt, pytest.exit.Exception))
            if uses_runner(item) and not ends:
                if error is not None:
                    escape_error(error)
                self.session.recorder.attempt_ends(item, error)

    @pytest.hookimpl(wrapper=True)
    def pytest_pyfunc_call(self, pyfuncitem: pytest.Function) -> Generator[None, Any, Any]:
        """Turn errors of this package into failures, and check what a pass rests on."""
        __tracebackhide__ = True
        try:
            run_marked_search(pyfuncitem)
            with self.session.properties.watching(pyfuncitem):
                result = yield
        except DuraError as error:
            outcome = self.session.recorder.outcome_of(error)
            raise outcome.with_traceback(error.__traceback__) from None
        finally:
            self.session.recorder.body_ended(pyfuncitem)
        if uses_runner(pyfuncitem):
            self.session.recorder.body_passed(pyfuncitem)
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Attach what the item recorded to its report, which crosses processes."""
        if call.excinfo is not None and self.has_own_items:
            redact_error(call.excinfo.value, self.session.redactor.redact)
        if call.excinfo is not None and uses_runner(item):
            escape_error(call.excinfo.value)
        report = yield
        self.session.properties.add_section(report)
        decided = self.session.recorder.attach(item, call, report)
        # A test that could not be set up is not called; wrong markers name nothing to judge.
        ended = call.when == "call" or (call.when == "setup" and call.excinfo is not None)
        if ended and uses_runner(item) and self._refusal_of(item) is None:
            self.session.judge_item(item, report, decided)
        reason = self.session.guests.reason_to_end()
        if reason and not item.session.shouldstop:
            item.session.shouldstop = reason
        if self.has_own_items:  # what is ours was added by now
            redact_report(report, self.session.redactor)
        return report

    @pytest.hookimpl(tryfirst=True)
    def pytest_warning_recorded(self, warning_message: warnings.WarningMessage) -> None:
        """Take secrets out of a warning, which the terminal sums up."""
        if self.has_own_items and isinstance(warning_message.message, Warning):
            redact_error(warning_message.message, self.session.redactor.redact)

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(
        self,
    ) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
        """Take secrets out of what imports of tests and conftests raise."""
        report = yield
        if self.session.active:
            redact_report(report, self.session.redactor)
        return report

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Gather what items recorded."""
        self._end_forked_copy()
        if self.has_own_items:  # other plugins may have added to it since it was made
            redact_report(report, self.session.redactor)
        self.session.recorder.passed_on(report)
        self.session.evidence.gather(report)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Write the evidence."""
        self._end_forked_copy()
        # What is still under way must not arrive once the episodes are removed.
        self.session.guests.stop()
        self.session.executor.close()
        if self.session.is_worker:
            workeroutput = vars(session.config)["workeroutput"]
            for part in self.session.parts_of_workers:
                part.send_to_controller(workeroutput)
        with rare_collections():  # what the session holds by now stays until its end
            self.session.evidence.finish(session)

    def pytest_keyboard_interrupt(self) -> None:
        """Note the interruption, also where ``pytest.exit`` reports a success."""
        self.session.evidence.interrupted = True

    @pytest.hookimpl(trylast=True)
    def pytest_unconfigure(self) -> None:
        """Enforce the exit code that the evidence supports, and release what is held."""
        self._end_forked_copy()
        if self._guard is not None:
            self._guard.close()
        simulators = sys.modules.get("pytest_dura.core.simulator_process")
        if simulators is not None:
            print_lines(simulators.close_classes())
        if self._pytest_session is not None:
            self.session.evidence.interrupt(self._pytest_session)  # if it was, before its end
            self.session.evidence.enforce_exit_code(self._pytest_session)
        self.session.executor.close()
        self.session.guests.end()
        # Pytest has just looked through all objects for garbage, and is about to do so again.
        self.session.config.stash[SET_ASIDE] = set_aside()

    def _begin_guard(self) -> None:
        """Keep any code from ending this process with a success; a second call does nothing."""
        if self._guard is None:
            self._guard = ExitStack()
            self._guard.enter_context(lasting_guard(self._say_past_capture))

    def _say_past_capture(self, line: str) -> None:
        """Print a line that no report will show, since the process is about to end."""
        capture = self.session.config.pluginmanager.getplugin("capturemanager")
        if capture is not None:
            capture.suspend_global_capture()
        os.write(2, f"{line}\n".encode())

    def _end_forked_copy(self) -> None:
        """End a copy of this process that some code forked and that returned to pytest."""
        if os.getpid() != self._pid:
            end_process(EXIT_CODE)

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Show cases, verdicts and failures."""
        evidence = self.session.evidence
        if evidence.final is not None:
            from pytest_dura.plugin.session.terminal import summary

            summary(
                self.session,
                terminalreporter,
                evidence.final,
                file=evidence.file,
                objections=evidence.objections,
                notes=self.session.executor.notes(),
                shared=self.session.shared,
            )

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: WorkerController) -> None:
        """Send a worker what it needs: it writes the traces of its episodes itself."""
        from pytest_dura.plugin.session.xdist import send_folder

        send_options(self.session.options, node.workerinput)
        send_folder(self.session.shared.worker_folder, node.workerinput)
        self.session.shared.send_to_worker(node.workerinput)
        self.session.guests.send_to_worker(node.workerinput)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: WorkerController, error: object) -> None:
        """Receive what a worker sends at its end, or note that it ended early."""
        workeroutput = getattr(node, "workeroutput", {})
        for part in self.session.parts_of_workers:
            part.receive_from_worker(workeroutput)
        self.session.shared.worker_ended(error)

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_make_scheduler(
        self, config: pytest.Config, log: Producer
    ) -> LoadScheduling | None:
        """Schedule by scenarios, so that workers share no episodes."""
        from pytest_dura.plugin.session.xdist import ScenarioScheduling, schedules_scenarios

        if not schedules_scenarios(config):
            return None
        return ScenarioScheduling(config, log, self.session.shared.worker_folder)

    @pytest.hookimpl(optionalhook=True, trylast=True)
    def pytest_handlecrashitem(self, report: pytest.TestReport, sched: Any) -> None:
        """Report the items that are not tried any more after a worker died."""
        if hasattr(sched, "report_given_up"):
            sched.report_given_up(report)

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(
        self,
        node: WorkerController,  # noqa: ARG002 - pluggy passes arguments by name
        ids: list[str],
    ) -> None:
        """Note what will run: under xdist the controller does not collect."""
        self.session.evidence.expect(ids)
