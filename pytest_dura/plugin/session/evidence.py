"""SessionEvidence: the record of a session, kept and written by the controller only.

With it: the baseline that the user gives, what scenario items are expected to decide, what waives
an item, and the exit codes that the gate regards as regular.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.boundary import HeldInterruptions
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.gate import Gate, verdict_objections
from pytest_dura.plugin.items.guest_items import expected_lines
from pytest_dura.plugin.messages import error_text
from pytest_dura.plugin.session.recorder import REPORT_ATTRIBUTE, case_plan
from pytest_dura.plugin.session.roles import root_conftest_with

if TYPE_CHECKING:
    from collections.abc import Callable

    from pytest_dura.evidence.baseline import Baseline
    from pytest_dura.evidence.files import DirectoryLock
    from pytest_dura.evidence.gather import RecordBuilder, Status
    from pytest_dura.evidence.item_verdicts import WaiverKind
    from pytest_dura.evidence.lines import Line
    from pytest_dura.evidence.model import SessionRecord
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.plugin.items.property_tests import PropertyTests
    from pytest_dura.plugin.items.scenario_items import Selection, ShardHooks
    from pytest_dura.plugin.session.episodes import SharedEpisodes
    from pytest_dura.plugin.session.executor import SessionExecutor
    from pytest_dura.plugin.session.formula_engines import FormulaEngines
    from pytest_dura.plugin.session.inputs import SessionInputs
    from pytest_dura.plugin.session.roles import SessionRoles


_REGULAR_EXIT_CODES = (
    pytest.ExitCode.OK,
    pytest.ExitCode.TESTS_FAILED,
    pytest.ExitCode.NO_TESTS_COLLECTED,
)
"""Exit codes of sessions that ran to their end."""


_PHASES = ("setup", "call", "teardown")
_OUTCOMES = ("passed", "failed", "skipped")


def waiver_of(report: pytest.TestReport) -> tuple[WaiverKind, str] | None:
    """Return the kind of waiver and its reason, if a report has one."""
    reason = getattr(report, "wasxfail", None)
    if reason is not None:
        return "xfail", reason
    if report.when not in _PHASES and str(report.outcome) not in _OUTCOMES:
        # No process is left that knows of this attempt: pytest-rerunfailures takes it for a rerun.
        return "rerun", "the item was run again after a worker had died"
    if report.skipped and report.when == "setup":
        longrepr = report.longrepr
        return "skip", longrepr[2] if isinstance(longrepr, tuple) else str(longrepr)
    return None


_MOST_WHY = 500
"""Characters of what stopped an item."""


def _configuration(report: pytest.TestReport) -> str:
    """What an item found wrong in its configuration, on one line; empty for other failures."""
    text = report.longreprtext
    lines = [" ".join(line.split()) for line in text.splitlines()]
    return "; ".join(filter(None, lines))[:_MOST_WHY] if "\n  expected:" in text else ""


class GivenBaseline:
    """The baseline that the user gives, read once by the controller.

    Args:
        context: The session's context.
    """

    def __init__(self, context: SessionContext) -> None:
        self.context = context
        self.baseline: Baseline | None = None
        """The earlier evidence that the session is compared with."""

    def read(self) -> None:
        """Read it, before the session's own record replaces an earlier one.

        Raises:
            ConfigurationError: If it cannot be used.
        """
        options, config = self.context.options, self.context.config
        if self.context.is_worker:
            return
        if options.baseline is not None:
            from pytest_dura.evidence.baseline import Baseline

            self.baseline = Baseline.read(options.baseline, config.invocation_params.dir)

    def with_baseline(self, record: SessionRecord) -> SessionRecord:
        """Add the comparison with the baseline to a record."""
        finished = None if record.head.status == "running" else record
        baseline = None if self.baseline is None else self.baseline.compared(finished)
        return record.changed(baseline=baseline)

    def regressions(self, record: SessionRecord) -> list[str]:
        """List what ``--dura-baseline-worse=fail`` does not let pass."""
        baseline = record.head.baseline
        if baseline is None or not self.context.options.fail_worse:
            return []
        from pytest_dura.evidence.baseline import regression_objections

        return regression_objections(baseline)


def _expected_lines(
    context: SessionContext, roles: SessionRoles, chosen: Iterable[str]
) -> list[Line]:
    """Return what the chosen scenario items are to decide.

    There may be tens of thousands of cases: what many of them share is looked up once.

    Args:
        context: The session's context, with its plan.
        roles: The roles of the session.
        chosen: Node ids of what will run, also of other tests.
    """
    if not context.plan:
        return []
    from pytest_dura.evidence.conclusions.verdicts import UNKNOWN_COMPONENT
    from pytest_dura.evidence.gather import claim
    from pytest_dura.evidence.lines import ClaimedCase

    chosen_ids, library, used = set(chosen), context.library(), set()
    overrides = roles.chosen()
    in_conftest = root_conftest_with(context.config, "generator") is not None
    components: dict[tuple[str, tuple[str, ...]], str] = {}
    expected: list[Line] = []
    for planned in context.plan:
        case = planned.case
        names = [name for name in planned.requirements if f"{case.id}::{name}" in chosen_ids]
        if names:
            runs = context.options.runs or case.scenario.planned
            key = case.scenario.name, case.without  # a case's faults make no difference
            if key not in components:
                components[key] = (
                    UNKNOWN_COMPONENT if in_conftest else case.roles(overrides)["generator"].label
                )
            off = case.roles_off(overrides)
            plan = case_plan(case, components[key], runs, context.options.runs, off)
            expected.append(ClaimedCase.from_data(plan.to_json()))
            expected += [claim(f"{case.id}::{name}", name, plan) for name in names]
            used.update(names)
    requirements = [library.requirements[name] for name in sorted(used)]
    if expected:
        hazards = {name for requirement in requirements for name in requirement.mitigates}
        expected += [*requirements, *library.hazards_of(hazards)]
    return expected


class SessionEvidence:
    """Gathers the reports of all items, writes the bundle, and lets the gate fail closed.

    Args:
        context: The session's context.
        roles: The roles of the session.
        properties: Its property tests.
        selection: What was left of its plan.
        shared: Its episodes.
        executor: Who simulates them.
        formulas: Who evaluates their formulas.
        shard: Which part of a session it is, if it is one, once options are read.
    """

    def __init__(
        self,
        context: SessionContext,
        *,
        roles: SessionRoles,
        properties: PropertyTests,
        selection: Selection,
        shared: SharedEpisodes,
        executor: SessionExecutor,
        formulas: FormulaEngines,
        shard: Callable[[], ShardHooks | None],
    ) -> None:
        self.context = context
        self._roles, self._properties = roles, properties
        self._selection, self._shared, self._executor = selection, shared, executor
        self._formulas, self._shard = formulas, shard
        self.record: RecordBuilder | None = None
        self.file: Path | None = None
        self.final: SessionRecord | None = None
        self.given = GivenBaseline(context)
        self.objections: list[str] = []
        """What the terminal says against the session beside its verdicts."""
        self._lock: DirectoryLock | None = None
        self._started = perf_counter()
        self._seconds_spent = 0.0
        self.interrupted = False
        """Whether a key or ``pytest.exit`` ended it, whatever the exit code."""
        self.ran_to_end = False
        """Whether the loop over the items ended by itself; a second Ctrl-C leaves no other sign."""
        self._any_report = False
        self._unreported: set[str] = set()
        """Items of ours that have not reported yet, where this process runs them."""
        self._claiming: set[str] = set()
        self._failed: set[str] = set()
        self._waived: list[tuple[str, WaiverKind, str]] = []
        """Waivers that the record does not have yet: node id, kind and reason."""
        self._inputs: SessionInputs | None = None
        self._expected: list[str] = []

    def start(self, *, late: bool = False) -> None:
        """Begin the record, which says that the session runs until it is finished.

        Args:
            late: Whether workers may have written traces already.

        Raises:
            ConfigurationError: If it cannot be written.
        """
        config = self.context.config
        if self.record is not None or self.context.is_worker or config.option.collectonly:
            return
        from pytest_dura.evidence.bundle import begin_bundle, check_directory
        from pytest_dura.evidence.files import DirectoryLock
        from pytest_dura.evidence.gather import RecordBuilder
        from pytest_dura.evidence.looks import earlier_looks
        from pytest_dura.plugin.items.scenario_items import compared_options
        from pytest_dura.plugin.session.inputs import files_of_roles
        from pytest_dura.provenance import describe_environment, describe_tool

        options = self.context.options
        check_directory(options.evidence)
        if not late:
            self._shared.look_around()
        self._lock, begun = DirectoryLock(options.evidence), False
        try:
            looks = earlier_looks(self._earlier_records())
            self.record = RecordBuilder(
                {
                    "created": _now(),
                    "tool": describe_tool(),
                    "command": shlex.join(["pytest", *map(str, config.invocation_params.args)]),
                    "base_seed": options.seed,
                    "evidence_level": options.evidence_level,
                    "require_repeatable": options.require_repeatable,
                    "environment": describe_environment(
                        config.rootpath,
                        options.evidence,
                        files_of_roles(self.context, self._roles.chosen_simulator()),
                    ),
                    "execution": self._executor.to_json(),
                    "resume": self._shared.to_json(),
                    "shard": self._shard_json(),
                    "merged_from": None,
                    "selection": self._selection.to_json(),
                    **({"options": given} if (given := compared_options(self.context)) else {}),
                    **({"looks": looks} if looks else {}),
                },
                options.evidence,
            )
            for failed in self._failed:
                self.record.fail(failed)
            if not late:
                self._shared.begin()
            gate = Gate.running(warn_undecided=options.warn_undecided)
            record = self._concluded("running", gate)
            with HeldInterruptions():
                begin_bundle(record, traces=not late)
                begun = True
            self._shared.put_sources()
        except BaseException:  # also on ctrl-C the next session may write here; it is raised again
            if not begun:  # otherwise the record has to say first how the session ended
                self._unlock()
            raise

    def _earlier_records(self) -> Iterator[Path]:
        """Yield the files of the record that is to be replaced, and of the baseline."""
        from pytest_dura.evidence.bundle import RECORD_FILE

        yield self.context.options.evidence / RECORD_FILE
        if self.given.baseline is not None:
            file = self.context.config.invocation_params.dir / self.given.baseline.session.path
            yield file / RECORD_FILE if file.is_dir() else file

    def expect(self, items: list[str]) -> None:
        """Note the scenario items that will run; those that never report are undecided."""
        # Workers of xdist collect the same, and each of them says so.
        if self.record is None or items == self._expected:
            return

        from pytest_dura.evidence.lines import without_secrets

        self._expected = items
        expected = _expected_lines(self.context, self._roles, items)
        expected += expected_lines(self.context, items)
        self.record.add(without_secrets(expected, self.context.redact))

    def note_tests(self, items: list[str], claiming: Iterable[str] = ()) -> None:
        """Note the tests that will run, and hash their files close to when they were read.

        Args:
            items: Node ids of tests that use the runner.
            claiming: Those of them whose reports carry what they are to decide.
        """
        if self.record is not None:
            self._unreported.update(items)
            self._claiming.update(claiming)
            for item in items:
                self._sources().add_item(item)

    def gather(self, report: pytest.TestReport) -> None:
        """Take what an item recorded out of its report, and into the session's record."""
        if self.context.is_worker:
            return
        started, self._any_report = perf_counter(), True
        # It is taken out, since the terminal and others keep the reports of all items.
        texts = vars(report).pop(REPORT_ATTRIBUTE, None)
        if texts is not None or report.nodeid not in self._claiming:
            self._unreported.discard(report.nodeid)
        for text in texts or ():
            self._add(text)
        if texts is not None and self.record is not None:
            self._sources().add_item(report.nodeid)
        if report.failed:
            self._failed.add(report.nodeid)
            if self.record is not None:
                self.record.fail(report.nodeid, self.context.redact(_configuration(report)))
        waiver = waiver_of(report)
        if waiver is not None:
            name, reason = self.context.redact([report.nodeid, waiver[1]])
            self._waived.append((name, waiver[0], reason))
        if self.record is not None:
            for waived in self._waived:  # of items before the record began, too
                self.record.waive(*waived)
            self._waived.clear()
        self._seconds_spent += perf_counter() - started

    def take(self, text: str) -> None:
        """Add packed lines of the item that runs in this process."""
        started = perf_counter()
        self._add(text)
        self._seconds_spent += perf_counter() - started

    def _add(self, text: str) -> None:
        self.start(late=True)
        if self.record is None:
            return
        from pytest_dura.evidence.lines import unpack_lines

        lines = unpack_lines(text)
        try:
            self.record.add(lines)
            for line in lines:
                self._sources().add_line(line)
        except ConfigurationError as error:
            # Without the episodes the session can show nothing.
            pytest.exit(error_text(error))

    @contextmanager
    def ending(self, session: pytest.Session) -> Iterator[None]:
        """Context of the session's end, in which :meth:`finish` is called.

        An interruption in it is in the record before it goes on, and a second one waits for that.
        What the session can be resumed from goes last.
        """
        with HeldInterruptions(passing=1):
            try:
                yield
            except KeyboardInterrupt:
                self.interrupt(session)
                raise
            else:
                with HeldInterruptions():
                    self._shared.remove_if_whole()
            finally:
                self._unlock()

    def interrupt(self, session: pytest.Session) -> None:
        """Let the record of a session that runs say that it was interrupted, if it does not yet."""
        written = None if self.file is None else self.final
        says_so = written is not None and written.head.status == "interrupted"
        refused = session.exitstatus == pytest.ExitCode.USAGE_ERROR
        if self.record is None or self._lock is None or says_so or refused:
            return
        from pytest_dura.evidence.bundle import begin_bundle

        self.interrupted = True
        with HeldInterruptions():
            try:
                _, self.final = self._judged(session)
                begin_bundle(self.final, traces=False)
                self._shared.end(self.final, written=False)
                session.exitstatus = self.final.head.gate.exit_code
                note = "dura: the session was interrupted; --dura-resume goes on"
            except ConfigurationError as error:
                note = error_text(error)
            finally:
                self._unlock()
            print(note, file=sys.stderr)  # noqa: T201 - the terminal's own report is not made

    def finish(self, session: pytest.Session) -> None:
        """Write the bundle; a session that it does not support has failed, whatever tests say."""
        if self.record is None:
            return
        from pytest_dura.evidence.bundle import write_bundle

        try:
            gate, self.final = self._judged(session)
            self.final = write_bundle(self.final, self.context.options.export)
            whole = len(self.final.head.gate.reasons) == len(gate.reasons)
            self._shared.end(self.final, written=whole)
            self.file = self.final.directory / "evidence.json"
        except ConfigurationError as error:
            self.objections += error_text(error).splitlines()
            session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED
        else:
            # What could not be rendered counts against the session, too.
            written = self.final.head.gate
            self.objections += written.reasons[len(gate.reasons) :]
            session.exitstatus = written.exit_code

    def enforce_exit_code(self, session: pytest.Session) -> None:
        """Keep later plugins from turning the exit code of a failed session into a success."""
        if self.record is None or session.exitstatus != pytest.ExitCode.OK:
            return
        code = int(pytest.ExitCode.INTERNAL_ERROR)  # the evidence was never written
        if self.final is not None and self.file is not None:
            code = self.final.head.gate.exit_code
        if code:
            print(  # noqa: T201 - the terminal's own report is over
                f"dura: the gate did not pass, and another plugin set exit code 0: it is {code}",
                file=sys.stderr,
            )
            session.exitstatus = code

    def _missing_reports(self, session: pytest.Session) -> list[str]:
        """List what other plugins kept from running in a session that ends as a success."""
        shard = self._shard()
        if shard is not None and shard.lost is not None:
            return [shard.lost]
        if shard is not None and shard.is_empty:
            return []
        if session.exitstatus == pytest.ExitCode.OK and not self._any_report:
            return ["no test was run"]
        return [f"{name} never reported its outcome" for name in sorted(self._unreported)]

    def _judged(self, session: pytest.Session) -> tuple[Gate, SessionRecord]:
        """Judge the session; returns the gate and the concluded record."""
        from pytest_dura.evidence.lines import without_secrets

        assert self.record is not None
        started = perf_counter()
        stopped = self.interrupted or bool(session.shouldstop or session.shouldfail)
        regular = self.ran_to_end and session.exitstatus in _REGULAR_EXIT_CODES
        interrupted = stopped or not regular
        status: Status = "interrupted" if interrupted else "complete"
        warn_undecided = self.context.options.warn_undecided
        header = {
            **self.record.header,
            "execution": self._executor.to_json(),
            "selection": self._selection.to_json(),
            "shard": self._shard_json(),
            **self._formulas.to_json(),
        }
        self.record.header = self._properties.with_profile(header)
        # Those of an item that never reported, and of episodes that were begun ahead in vain.
        lines = self.context.guests.take_last(self._sources().inputs)
        self.record.add(without_secrets(lines, self.context.redact))
        record = self.given.with_baseline(self.record.record(status))
        recorded = [*self.record.problems, *self.record.objections]
        self.objections = [*recorded, *self.given.regressions(record)]
        self.objections += self.context.guests.objections(record.head)
        if self.context.options.require_repeatable:
            from pytest_dura.evidence.gate import repeat_objections

            self.objections += repeat_objections(record.head.cases)
        if not interrupted:
            self.objections += self._missing_reports(session)
        gate = Gate.of(
            record.head.verdicts,
            self.objections,
            searches=record.head.searches,
            interrupted=interrupted,
            exit_code=int(session.exitstatus),
            failed=len(self._failed),
            warn_undecided=warn_undecided,
        )
        if session.exitstatus == pytest.ExitCode.OK and not interrupted:
            # Such as runs that `-k` left out, or a violation that a test caught.
            self.objections += [
                f"the gate fails: {objection}, though every test passed"
                for objection in verdict_objections(
                    record.head.verdicts, record.head.searches, warn_undecided=warn_undecided
                )
            ]
        concluded = self._concluded(status, gate, record)
        self._seconds_spent += perf_counter() - started
        return gate, concluded

    def _concluded(
        self, status: Status, gate: Gate, record: SessionRecord | None = None
    ) -> SessionRecord:
        """Return the record with everything that follows from it."""
        assert self.record is not None
        from pytest_dura.evidence.conclude import complete

        if record is None:
            record = self.given.with_baseline(self.record.record(status))
        return complete(
            record,
            finished=None if status == "running" else _now(),
            gate=gate,
            inputs=self._sources().to_json(),
            wall_seconds=perf_counter() - self._started,
            evidence_seconds=self._seconds_spent,
            redact=self.context.redact,
        )

    def _shard_json(self) -> dict[str, Any] | None:
        shard = self._shard()
        return None if shard is None else shard.to_json()

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def _sources(self) -> SessionInputs:
        """Return the files that the session is run from, as far as known by now."""
        if self._inputs is None:
            from pytest_dura.plugin.session.inputs import SessionInputs

            self._inputs = SessionInputs(self.context, self.given.baseline)
            self._inputs.begin()
        return self._inputs


def _now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="seconds")
