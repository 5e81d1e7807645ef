"""SessionEvidence: the record of a session, kept and written by the controller only."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.overrides import root_conftest_with
from pytest_dura.plugin.reporter import ATTRIBUTE, case_record

if TYPE_CHECKING:
    from pytest_dura.campaign.cases import Case
    from pytest_dura.evidence.baseline_file import Baseline
    from pytest_dura.evidence.record import EvidenceRecord, Status
    from pytest_dura.evidence.session_record import SessionRecord
    from pytest_dura.plugin.session import DuraSession


REGULAR = (
    pytest.ExitCode.OK,
    pytest.ExitCode.TESTS_FAILED,
    pytest.ExitCode.NO_TESTS_COLLECTED,
)


class SessionEvidence:
    """Gathers the reports of all items, writes ``evidence.json``, and lets the gate fail closed.

    Args:
        session: The session of this process.
    """

    def __init__(self, session: DuraSession) -> None:
        self.session = session
        self.record: EvidenceRecord | None = None
        self.file: Path | None = None
        self.final: SessionRecord | None = None
        self.baseline: Baseline | None = None
        self.objections: list[str] = []

    def read_baseline(self) -> None:
        """Read what this session is compared with, which its own record may replace.

        Raises:
            ConfigurationError: If it cannot be used.
        """
        given = self.session.options.baseline
        if given is not None and not self.session.is_worker:
            from pytest_dura.evidence.baseline_file import Baseline

            self.baseline = Baseline.read(given, self.session.config.invocation_params.dir)

    def start(self) -> None:
        """Begin the record. What a killed session leaves behind says that it was running.

        Raises:
            ConfigurationError: If it cannot be written.
        """
        config = self.session.config
        if self.record is not None or self.session.is_worker or config.option.collectonly:
            return
        import pytest_dura
        from pytest_dura.evidence.environment import describe_environment
        from pytest_dura.evidence.record import EvidenceRecord

        options = self.session.options
        self.record = EvidenceRecord(
            {
                "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
                "tool": {"name": "pytest-dura", "version": pytest_dura.__version__},
                "command": shlex.join(["pytest", *map(str, config.invocation_params.args)]),
                "base_seed": options.seed,
                "environment": describe_environment(config.rootpath, options.evidence),
            },
            options.evidence,
        )
        self._write("running")

    def expect(self, items: list[str]) -> None:
        """Note the scenario items that will run; those that never report are undecided."""
        if self.record is None:
            return
        requirements = self.session.library().requirements if self.session.plan else {}
        chosen = set(items)
        for planned in self.session.plan:
            case = planned.case
            runs = self.session.options.runs or case.scenario.planned
            record = case_record(case, self._component(case), runs, self.session.options.runs)
            for name in planned.requirements:
                item = f"{case.id}::{name}"
                if item in chosen:
                    self.record.expect(item, requirements[name].to_json(), record)

    def gather(self, report: pytest.TestReport) -> None:
        """Take in what an item told."""
        told = getattr(report, ATTRIBUTE, None)
        if self.session.is_worker:
            return
        if told is not None:
            self.start()
            if self.record is not None:
                try:
                    self.record.add(json.loads(told))
                except ConfigurationError as error:
                    # Without its episodes there is nothing that the session could still show.
                    pytest.exit(str(error))
        if self.record is not None:
            self._waive(report)

    def finish(self, session: pytest.Session) -> None:
        """Write the record; a session that it does not support has failed, whatever tests say."""
        if self.record is None:
            return
        stopped = bool(session.shouldstop or session.shouldfail)
        interrupted = stopped or session.exitstatus not in REGULAR
        try:
            self._write("interrupted" if interrupted else "complete")
        except ConfigurationError as error:
            self.file = None
            self.objections = str(error).splitlines()
            session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED
            return
        self.objections = [*self.record.problems, *self._worse()]
        if session.exitstatus == pytest.ExitCode.OK:
            self.objections += self._unsupported()
            if self.objections:
                session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def _unsupported(self) -> list[str]:
        """Verdicts that no test failed for: of runs that ``-k`` left out, or a caught violation."""
        assert self.final is not None
        accepted = {"supported"} | ({"undecided"} if self.session.options.warn_undecided else set())
        return [
            f"the gate fails: {one['requirement']} on {one['case']} is {one['verdict']}, "
            "though every test passed"
            for one in self.final["verdicts"]
            if one["verdict"] not in accepted and one["waiver"] is None
        ]

    def _worse(self) -> list[str]:
        """What ``--dura-baseline-worse=fail`` does not let pass."""
        assert self.final is not None
        if not self.session.options.fail_worse:
            return []
        found = self.final["baseline"]["comparisons"]
        if all(one["test"] is None for one in found):
            return ["the gate fails: nothing in this session can be compared with the baseline"]
        return [
            f"the gate fails: {one['requirement']} on {one['case']} is worse than in the baseline"
            for one in found
            if one["word"] == "worse"
        ]

    def _component(self, case: Case) -> str:
        """The component's name, if it is known before anything runs."""
        if root_conftest_with(self.session.config, "generator") is not None:
            from pytest_dura.evidence.record import UNKNOWN

            return UNKNOWN
        return case.roles(self.session.chosen_roles())["generator"].label

    def _waive(self, report: pytest.TestReport) -> None:
        assert self.record is not None
        reason = getattr(report, "wasxfail", None)
        if reason is not None:
            self.record.waive(report.nodeid, "xfail", reason)
        elif str(report.outcome) == "rerun":  # of pytest-rerunfailures
            self.record.waive(report.nodeid, "rerun", "the item was run again")
        elif report.skipped and report.when == "setup":
            longrepr = report.longrepr
            reason = longrepr[2] if isinstance(longrepr, tuple) else str(longrepr)
            self.record.waive(report.nodeid, "skip", reason)

    def _write(self, status: Status) -> None:
        assert self.record is not None
        from pytest_dura.evidence.bundle import write_record

        record = self.record.record(status)
        finished = None if status == "running" else record
        baseline = None if self.baseline is None else self.baseline.to_json(finished)
        self.final = replace(record, head={**record.head, "baseline": baseline})
        self.file = write_record(self.session.options.evidence, self.final)
