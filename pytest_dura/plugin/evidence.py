"""SessionEvidence: the record of a session, kept and written by the controller only."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterable
from datetime import datetime, timezone
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.gate import REGULAR, Gate, claims_against
from pytest_dura.plugin.given_files import GivenFiles
from pytest_dura.plugin.messages import error_text
from pytest_dura.plugin.reporter import ATTRIBUTE
from pytest_dura.plugin.waivers import waiver_of

if TYPE_CHECKING:
    from pytest_dura.evidence.bundle.lock import DirectoryLock
    from pytest_dura.evidence.record.evidence_record import EvidenceRecord, Status
    from pytest_dura.evidence.record.session_record import SessionRecord
    from pytest_dura.plugin.inputs import SessionInputs
    from pytest_dura.plugin.session import DuraSession


class SessionEvidence:
    """Gathers the reports of all items, writes the bundle, and lets the gate fail closed.

    Args:
        session: The session of this process.
    """

    def __init__(self, session: DuraSession) -> None:
        self.session = session
        self.record: EvidenceRecord | None = None
        self.file: Path | None = None
        self.final: SessionRecord | None = None
        self.given = GivenFiles(session)
        self.objections: list[str] = []
        """What the terminal says against the session beside its verdicts."""
        self._lock: DirectoryLock | None = None
        self._begun = perf_counter()
        self._spent = 0.0
        self.interrupted = False
        """Whether a key or ``pytest.exit`` ended it, whatever the exit code."""
        self._heard = False
        self._due: set[str] = set()
        """Items of ours that have not reported yet, where this process runs them."""
        self._telling: set[str] = set()
        self._failed: set[str] = set()
        self._inputs: SessionInputs | None = None
        self._expected: list[str] = []

    def start(self, *, late: bool = False) -> None:
        """Begin the record. What a killed session leaves behind says that it was running.

        Args:
            late: Whether workers may have written traces already.

        Raises:
            ConfigurationError: If it cannot be written.
        """
        config = self.session.config
        if self.record is not None or self.session.is_worker or config.option.collectonly:
            return
        from pytest_dura.evidence.bundle.directory import begin_bundle, check_directory
        from pytest_dura.evidence.bundle.lock import DirectoryLock
        from pytest_dura.evidence.record.evidence_record import EvidenceRecord
        from pytest_dura.provenance.environment import describe_environment
        from pytest_dura.provenance.ourselves import describe_tool

        options = self.session.options
        check_directory(options.evidence)
        self._lock = DirectoryLock(options.evidence)
        try:
            self.record = EvidenceRecord(
                {
                    "created": _now(),
                    "tool": describe_tool(),
                    "command": shlex.join(["pytest", *map(str, config.invocation_params.args)]),
                    "base_seed": options.seed,
                    "evidence_level": options.evidence_level,
                    "require_repeatable": options.require_repeatable,
                    "environment": describe_environment(config.rootpath, options.evidence),
                    "execution": self.session.simulating.to_json(),
                    "argument": self.given.argument,
                    "reuse": self.session.shared.to_json(),
                    "shard": self.session.shard and self.session.shard.to_json(),
                    "merged_from": None,
                    "selection": self.session.selection.to_json(),
                },
                options.evidence,
            )
            if not late:
                self.session.shared.begin()
            gate = Gate.running(warn_undecided=options.warn_undecided)
            begin_bundle(self._concluded("running", gate), traces=not late)
        except BaseException:  # also on ctrl-C the next session may write here; it is raised again
            self._unlock()
            raise

    def expect(self, items: list[str]) -> None:
        """Note the scenario items that will run; those that never report are undecided."""
        # Workers of xdist collect the same, and each of them says so.
        if self.record is None or items == self._expected:
            return
        from pytest_dura.plugin.expected_items import expected_items

        self._expected = items
        expected = expected_items(self.session, items)
        for one in self.session.redact(expected):  # as the items themselves will tell it
            self.record.expect(*one)

    def read_from(self, items: list[str], telling: Iterable[str] = ()) -> None:
        """Note the tests that will run, and their files, as near as can be to when they were read.

        Args:
            items: Node ids of tests that use the bench.
            telling: Those of them whose reports carry what they are to decide.
        """
        if self.record is not None:
            self._due.update(items)
            self._telling.update(telling)
            for item in items:
                self._sources().item(item)

    def gather(self, report: pytest.TestReport) -> None:
        """Take in what an item told."""
        if self.session.is_worker:
            return
        begun, self._heard = perf_counter(), True
        # Terminal and others keep the reports of all items.
        told = vars(report).pop(ATTRIBUTE, None)
        if told is not None or report.nodeid not in self._telling:
            self._due.discard(report.nodeid)
        if report.failed:
            self._failed.add(report.nodeid)
        if told is not None:
            self._add(json.loads(told))
        if self.record is not None:
            self._waive(report)
        self._spent += perf_counter() - begun

    def take(self, part: str) -> None:
        """Take in episodes of the item that is running in this process; see ItemReport."""
        from pytest_dura.evidence.record.item_report import unpacked

        begun = perf_counter()
        self._add(unpacked(part))
        self._spent += perf_counter() - begun

    def _add(self, told: dict[str, Any]) -> None:
        self.start(late=True)
        if self.record is None:
            return
        try:
            self.record.add(told)
            self._sources().heard(told)
        except ConfigurationError as error:
            # Without its episodes there is nothing that the session could still show.
            pytest.exit(error_text(error))

    def finish(self, session: pytest.Session) -> None:
        """Write the bundle; a session that it does not support has failed, whatever tests say."""
        if self.record is None:
            return
        from pytest_dura.evidence.bundle.writing import write_bundle

        try:
            gate, self.final = self._judged(session)
            self.final = write_bundle(self.final)
            whole = len(self.final["gate"]["reasons"]) == len(gate.reasons)
            self.session.shared.end(self.final, written=whole)
            self.file = self.final.directory / "evidence.json"
        except ConfigurationError as error:
            self.objections += error_text(error).splitlines()
            session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED
        else:
            # What could not be rendered counts against the session, too.
            written = self.final["gate"]
            self.objections += written["reasons"][len(gate.reasons) :]
            session.exitstatus = written["exit_code"]
        finally:
            self._unlock()

    def insist(self, session: pytest.Session) -> None:
        """Let no plugin that comes later turn the exit code of a failed session into a success."""
        if self.record is None or session.exitstatus != pytest.ExitCode.OK:
            return
        code = int(pytest.ExitCode.INTERNAL_ERROR)  # the evidence was never written
        if self.final is not None and self.file is not None:
            code = self.final["gate"]["exit_code"]
        if code:
            print(  # noqa: T201 - the terminal's own report is over
                f"dura: the gate did not pass, and another plugin set exit code 0: it is {code}",
                file=sys.stderr,
            )
            session.exitstatus = code

    def _unheard(self, session: pytest.Session) -> list[str]:
        """What other plugins kept from running, in a session that they let end as a success."""
        shard = self.session.shard
        if shard is not None and shard.lost is not None:
            return [shard.lost]
        if shard is not None and shard.is_empty:
            return []
        if session.exitstatus == pytest.ExitCode.OK and not self._heard:
            return ["no test was run"]
        return [f"{name} never told what it came to" for name in sorted(self._due)]

    def _judged(self, session: pytest.Session) -> tuple[Gate, SessionRecord]:
        """What the session comes to, and its record."""
        assert self.record is not None
        begun = perf_counter()
        stopped = self.interrupted or bool(session.shouldstop or session.shouldfail)
        interrupted = stopped or session.exitstatus not in REGULAR
        status: Status = "interrupted" if interrupted else "complete"
        warn_undecided = self.session.options.warn_undecided
        header = {**self.record.header, "selection": self.session.selection.to_json()}
        self.record.header = self.session.properties.described(header)
        record = self.given.compared(self.record.record(status))
        told = [*self.record.problems, *self.record.objections]
        self.objections = [*told, *self.given.worse(record)]
        if self.session.options.require_repeatable:
            from pytest_dura.evidence.record.repeats import repeat_objections

            self.objections += repeat_objections(record["cases"])
        if not interrupted:
            self.objections += self._unheard(session)
        gate = Gate.of(
            record["verdicts"],
            self.objections,
            searches=record["searches"],
            interrupted=interrupted,
            exit_code=int(session.exitstatus),
            failed=len(self._failed),
            warn_undecided=warn_undecided,
        )
        if session.exitstatus == pytest.ExitCode.OK and not interrupted:
            # Of runs that `-k` left out, or a violation that a test caught.
            self.objections += [
                f"the gate fails: {one}, though every test passed"
                for one in claims_against(
                    record["verdicts"], record["searches"], warn_undecided=warn_undecided
                )
            ]
        concluded = self._concluded(status, gate, record)
        self._spent += perf_counter() - begun
        return gate, concluded

    def _concluded(
        self, status: Status, gate: Gate, record: SessionRecord | None = None
    ) -> SessionRecord:
        """The record with everything that follows from it."""
        assert self.record is not None
        from pytest_dura.evidence.record.conclusion import concluded

        if record is None:
            record = self.given.compared(self.record.record(status))
        if status != "running":
            record = self.session.models.completed(record, self._sources())
        return concluded(
            record,
            finished=None if status == "running" else _now(),
            gate=gate.to_json(),
            inputs=self._sources().to_json(),
            wall_seconds=perf_counter() - self._begun,
            evidence_seconds=self._spent,
            redact=self.session.redact,
        )

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def _sources(self) -> SessionInputs:
        """The files that the session is run from, as far as it is known by now."""
        if self._inputs is None:
            from pytest_dura.plugin.inputs import SessionInputs

            self._inputs = SessionInputs(self.session)
            self._inputs.begin()
        return self._inputs

    def _waive(self, report: pytest.TestReport) -> None:
        assert self.record is not None
        waiver = waiver_of(report)
        if waiver is not None:
            self.record.waive(*self.session.redact([report.nodeid, *waiver]))


def _now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="seconds")
