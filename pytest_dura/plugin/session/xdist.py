"""Scheduling over the workers of pytest-xdist: all items of a scenario on one worker.

So campaigns, pairs and twins are simulated once, and workers share nothing. The controller collects
no items: the first worker that has collected writes down what each of them looks at.
"""

from __future__ import annotations

import copy
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from xdist.scheduler import LoadScheduling

from pytest_dura.evidence.text import counted
from pytest_dura.plugin.items.outcomes import marked_target, target_of

if TYPE_CHECKING:
    import pytest
    from xdist.remote import Producer
    from xdist.workermanage import WorkerController

    from pytest_dura.plugin.context import SessionContext

Subject: TypeAlias = tuple[str, str]
"""What an item looks at: the name of a scenario, and one of its cases or runs."""
_SUBJECTS_KEY = "dura_subjects"
"""Key in the input of a worker: the folder for what items look at."""
_SUBJECTS_FILE = "subjects.json"
MAX_DEATHS = 2
"""Workers that may die in items on one case, or on one run, before the others of these fail."""


def schedules_scenarios(config: pytest.Config) -> bool:
    """Whether a scenario stays on one worker: the user chose no ``--dist`` of his own."""
    typed = config.known_args_namespace
    own = typed.dist != "no" or typed.distload
    return bool(config.getoption("dist") == "load" and not own)


def idle_workers(context: SessionContext) -> Iterator[str]:
    """Say that processes would simulate faster than workers, some of which have no scenario."""
    workers = len(context.config.getoption("tx"))
    scenarios = len({planned.case.scenario.name for planned in context.plan})
    if schedules_scenarios(context.config) and scenarios < workers:
        yield (
            "dura: this session is faster without -n: one worker simulates all of a scenario, "
            f"and {workers} workers have {counted(scenarios, 'scenario')}"
        )


def subject_of(item: pytest.Item) -> Subject | None:
    """What an item looks at; ``None`` where it chooses its episodes itself, or has none."""
    target = target_of(item)
    if target is None:
        return None
    run = "" if marked_target(item, ["episode"]) is None else f"#{target.run}"
    return target.case.scenario.name, target.case.id + run


def send_folder(folder: Path, workerinput: dict[str, object]) -> None:
    """Tell a worker where to write down what items look at."""
    workerinput[_SUBJECTS_KEY] = str(folder)


def note_subjects(config: pytest.Config, items: Sequence[pytest.Item]) -> None:
    """Write down what items look at, if this is the first worker that has collected them."""
    folder = vars(config)["workerinput"].get(_SUBJECTS_KEY)
    subjects = [] if folder is None else [subject_of(item) for item in items]
    if folder is not None and any(subjects):
        # The folder is another worker's, or cannot be made: then pytest-xdist schedules by itself.
        with suppress(OSError):
            Path(folder).mkdir(mode=0o700)
            Path(folder, _SUBJECTS_FILE).write_text(json.dumps(subjects))


def _read_subjects(folder: Path) -> list[Subject | None]:
    with suppress(OSError, ValueError):  # of another machine, or of a worker that was killed
        found = json.loads((folder / _SUBJECTS_FILE).read_text())
        return [each and (each[0], each[1]) for each in found]
    return []


class ScenarioScheduling(LoadScheduling):  # type: ignore[misc, unused-ignore]
    """Load scheduling that gives a worker all items of a scenario at once.

    Items without one are scheduled as pytest-xdist does, and so is a session that has no other.

    Args:
        folder: Where workers write down what items look at.
    """

    collection: list[str] | None
    maxschedchunk: int | None

    def __init__(self, config: pytest.Config, log: Producer | None, folder: Path) -> None:
        super().__init__(config, log)
        self._folder = folder
        self._subjects: list[Subject | None] = []
        self._deaths: Counter[Subject] = Counter()
        self.given_up: list[str] = []
        """Items that the last death made fail."""

    def schedule(self) -> None:
        """Begin with one scenario for each worker."""
        collection, *others = self.node2collection.values()
        if self.collection is None and all(other == collection for other in others):
            self._subjects = _read_subjects(self._folder)
            if len(self._subjects) != len(collection):
                self._subjects = []
        if self.collection is not None or not any(self._subjects):
            super().schedule()
            return
        self.collection = collection
        self.maxschedchunk = self.maxschedchunk or len(collection)
        first: dict[str | None, int] = {}
        places = [
            place if subject is None else first.setdefault(subject[0], place)
            for place, subject in enumerate(self._subjects)
        ]
        self.pending[:] = sorted(range(len(collection)), key=places.__getitem__)
        for node in self.nodes:
            self._send_tests(node, 2)
        for node in self.nodes:
            self.check_schedule(node)

    def check_schedule(self, node: WorkerController, duration: float = 0) -> None:
        """Give a worker more; it runs an item once it knows the next one, or that there is none."""
        super().check_schedule(node, duration)
        if self._subjects and len(self.node2pending[node]) < 2:
            super().check_schedule(node)

    def _send_tests(self, node: WorkerController, num: int) -> None:
        """Send the next scenario, or so many of the items before it."""
        if self._subjects and self.pending:
            subjects = (self._subjects[index] for index in self.pending)
            scenarios = (subject and subject[0] for subject in subjects)
            first = next(scenarios)
            most = len(self.pending) if first is not None else num
            num = 1
            while num < most and next(scenarios, _END) == first:
                num += 1
        super()._send_tests(node, num)

    def mark_test_pending(self, item: str) -> None:
        """Refuse to try an item again that looks at episodes and killed its worker.

        Raises:
            NotImplementedError: For such an item.
        """
        assert self.collection is not None
        if self._subjects and self._subjects[self.collection.index(item)] is not None:
            raise NotImplementedError
        super().mark_test_pending(item)

    def remove_node(self, node: WorkerController) -> str | None:
        """Return the item during which the worker died; its others are given to other workers.

        Those that look at the same fail with it once they have cost as many workers.
        """
        self.given_up = []
        pending = self.node2pending[node]
        subject = self._subjects[pending[0]] if self._subjects and pending else None
        if subject is not None:
            assert self.collection is not None
            self._deaths[subject] += 1
            if self._deaths[subject] >= MAX_DEATHS:
                same = [index for index in pending[1:] if self._subjects[index] == subject]
                self.given_up = [self.collection[index] for index in same]
                pending[:] = [index for index in pending if index not in same]
        crashed: str | None = super().remove_node(node)
        return crashed

    def report_given_up(self, crashed: pytest.TestReport) -> None:
        """Report the items that fail with the one during which a worker died."""
        for name in self.given_up:
            report = copy.copy(crashed)
            report.nodeid = name
            report.longrepr = f"{MAX_DEATHS} workers died in items on the same episodes"
            self.config.hook.pytest_runtest_logreport(report=report)


_END = object()
