"""The items of a session: scenario items, what ``-k`` and the like left of all, and shards.

A scenario item is a case and a requirement, such as ``intersection/nominal::SAF-1``.
``--dura-shard=2/5`` runs the second of five parts of a session, for jobs of a CI. It is split
into units: items that share episodes, and so run in one shard.
"""

from __future__ import annotations

import json
import os
from collections import Counter, defaultdict
from collections.abc import Generator, Iterable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.context import rerun_command
from pytest_dura.plugin.items.markers import decides_nothing, marked_requirements
from pytest_dura.plugin.items.outcomes import marked_target, target_of
from pytest_dura.plugin.options import option_rows

if TYPE_CHECKING:
    import pluggy
    from xdist.workermanage import WorkerController

    from pytest_dura.campaign.runner import Runner
    from pytest_dura.evidence.shard_units import ShardUnit
    from pytest_dura.execution.task import EpisodeTask
    from pytest_dura.library.cases import Case
    from pytest_dura.plugin.context import Planned, SessionContext
    from pytest_dura.plugin.option_values import Shard


_COLLECTOR = "::scenarios"
"""The node that collects all cases; no path is called so, whose conftest would apply."""


class ScenarioCases(pytest.Collector):
    """Collector of the items of all planned cases at once: each collector takes a report.

    It is no file: ``--lf`` would pass over it.
    """

    context: SessionContext

    def collect(self) -> Iterator[pytest.Item]:
        """Yield the items of each case in the order of the plan."""
        paths = {"": self.config.rootpath}  # of the files, each of which has many cases
        for planned in self.context.plan:
            name, file = planned.case.id, planned.case.scenario.file
            if file not in paths:
                paths[file] = Path(file).absolute()
            case: ScenarioCase = ScenarioCase.from_parent(
                self.session, name=name, nodeid=name, path=paths[file]
            )
            case.planned, case.cases = planned, self
            yield from case.collect()

    @cached_property
    def fixtures(self) -> Any:
        """Fixtures of all items, which are the same: of plugins and the root conftest."""
        first = pytest.Function.from_parent(self, name="fixtures", callobj=_judge)
        return first._fixtureinfo  # noqa: SLF001 - it is what `Function` takes as `fixtureinfo`

    @cached_property
    def markers(self) -> dict[str, pytest.MarkDecorator]:
        """Markers of the items, by their requirement."""
        known = self.context.library().requirements
        names = {name for planned in self.context.plan for name in planned.requirements}
        return {name: pytest.mark.requirement(name, text=known[name].text) for name in names}


class AtRoot:
    """Node to which the root conftest applies, wherever its file lies."""

    config: pytest.Config
    session: pytest.Session

    @property
    def ihook(self) -> pluggy.HookRelay:
        """Hooks of plugins and the root conftest."""
        return self.session.gethookproxy(self.config.rootpath)


class ScenarioCase(AtRoot, pytest.Collector):
    """Collector of the items of one case, at the path of its scenario file."""

    planned: Planned
    cases: ScenarioCases

    def collect(self) -> Iterator[pytest.Item]:
        """Yield one item per requirement."""
        for name in self.planned.requirements:
            item = ScenarioItem.from_parent(
                self, name=name, callobj=_judge, fixtureinfo=self.cases.fixtures
            )
            item.context, item.planned = self.cases.context, self.planned
            item.add_marker(self.cases.markers[name])
            yield item


class ScenarioItem(AtRoot, pytest.Function):
    """Item that judges one requirement on all episodes of a case."""

    context: SessionContext
    planned: Planned

    def reportinfo(self) -> tuple[os.PathLike[str] | str, int | None, str]:
        """Return the place where the scenario names the requirement, in lines from 0."""
        scenario = self.planned.case.scenario
        names = list(scenario.requirements)
        key = f"requirements.{names.index(self.name)}" if self.name in names else "requirements"
        return self.path, (scenario.line_of(key) or 1) - 1, self.nodeid


def scenario_items(context: SessionContext, root: pytest.Session) -> list[pytest.Item]:
    """Collect the items of all planned cases."""
    cases = ScenarioCases.from_parent(
        root, name=_COLLECTOR, nodeid=_COLLECTOR, path=context.config.rootpath
    )
    cases.context = context
    return list(root.genitems(cases))


def _judge(request: pytest.FixtureRequest, _dura_roles: None, dura_orchestrator: Runner) -> None:
    """Judge the requirement of the item on its case: the function that each item runs."""
    from pytest_dura.campaign.events import VerdictReached
    from pytest_dura.requirements.campaign_verdicts import without_advice

    context, planned = request.node.context, request.node.planned
    requirement = context.library().requirements[request.node.name]
    # A worker of pytest-xdist does not know which of the later items are its own.
    if dura_orchestrator.store.lacks_plan and not context.is_worker:
        dura_orchestrator.store.plan(_later_tasks(dura_orchestrator, request.node))
    campaign = dura_orchestrator.campaign(planned.case, requirement=requirement)
    try:
        verdict = campaign.judge(requirement)
        assert campaign.judgement is not None
        reached = VerdictReached(verdict, requirement, campaign.judgement)
        dura_orchestrator.events.emit(reached)
    except ConfigurationError as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from None
    if verdict.verdict == "supported":
        return
    # What happened, why, and what to do stands once, in the card of the cause.
    lines = list(map(without_advice, campaign.explain(verdict, requirement)[:2]))
    rerun = rerun_command(context, f"{planned.case.id}::{requirement.id}")
    lines[-1] += " (why: see its card)"
    message = "\n".join([*lines, f"rerun:    {rerun}"])
    if verdict.too_few and context.options.warn_undecided:
        pytest.skip(message)
    pytest.fail(message, pytrace=False)


def _later_tasks(runner: Runner, item: ScenarioItem) -> Iterator[EpisodeTask]:
    """Yield the tasks that scenario items need in any case, from one of them on.

    All of them see the same roles, those of the root conftest. Where runs end early, which will be
    needed is not known.
    """
    from pytest_dura.campaign.events import EventStream

    items = item.session.items
    known = runner.library().requirements
    # It keeps these roles while a test function has others.
    runner = replace(runner, events=EventStream())
    seen: set[tuple[str, int]] = set()
    for later in items[items.index(item) :]:
        if not isinstance(later, ScenarioItem):
            continue
        requirement = known[later.name]
        campaign = runner.campaign(later.planned.case, requirement=requirement)
        try:
            cases = [campaign.case]
            if campaign.course_of(requirement).judge.sequential:
                continue
            if requirement.paired is not None:
                pairs = requirement.paired
                cases += campaign.paired(pairs.without, reference=pairs.reference).others
            cases = [case for case in cases if (case.id, campaign.planned) not in seen]
            seen |= {(case.id, campaign.planned) for case in cases}
            tasks = [runner.task(case, run) for run in range(campaign.planned) for case in cases]
        except ConfigurationError:  # the item itself reports it
            continue
        yield from tasks


RECORDED_AS = pytest.StashKey[str]()
"""Node id under which the verdicts of an item are recorded that repeats a test."""


def note_repetitions(items: Sequence[pytest.Item]) -> None:
    """Note on each item that repeats a test the first one that does, for one verdict of them all.

    Plugins repeat a test by a parameter that neither the test nor a fixture of it asks for. It
    changes nothing in the test, and parameters that a user gives to a test are others.

    Args:
        items: In the order of the session.
    """
    first: dict[tuple[Any, ...], str] = {}
    known: dict[int, set[str]] = {}
    for item in items:
        parameters: dict[str, Any] = getattr(getattr(item, "callspec", None), "params", {})
        info: Any = getattr(item, "_fixtureinfo", None)  # the same for all items of a function
        if not parameters or info is None:
            continue
        if id(info) not in known:
            known[id(info)] = _requested(info)
        requested = known[id(info)]
        if not parameters.keys() <= requested:
            # The parameters of items that repeat a test are the same objects.
            own = {name: id(value) for name, value in parameters.items() if name in requested}
            place = item.parent.nodeid if item.parent else ""
            test = place, getattr(item, "originalname", item.name), *sorted(own.items())
            item.stash[RECORDED_AS] = first.setdefault(test, item.nodeid)


def _requested(info: Any) -> set[str]:
    """Names of all fixtures that a test, or a fixture of it, asks for.

    Args:
        info: pytest's description of the fixtures of the test.
    """
    requested, pending = set(), list(info.initialnames)
    while pending:
        name = pending.pop()
        if name not in requested:
            requested.add(name)
            for definition in info.name2fixturedefs.get(name, ()):
                pending += definition.argnames
    return requested


_MOST_LISTED = 20
"""Verdicts that are named of those that were left out."""
_SELECTION_KEY = "dura_selection"
"""Key in the output of a worker; the controller collects nothing."""


class Selection:
    """Counts what ``-k``, ``--deselect``, a conftest and ``--dura-runs`` leave of the plan.

    The plan is what the arguments name: every verdict that the collected tests and scenario items
    would come to.

    Args:
        context: The session's context.
    """

    def __init__(self, context: SessionContext) -> None:
        self.context = context
        self._planned: dict[str, int] = {}
        """Runs that are declared for each verdict."""
        self._last: list[pytest.Item] | None = None
        """The items that were left last time."""
        self._selected: dict[str, Any] = {
            "planned": 0, "asked": 0, "left_out": [], "runs": None, "declared_runs": [],
        }  # fmt: skip

    def plan(self, items: Sequence[pytest.Item]) -> None:
        """Note the verdicts of all items that were collected."""
        self._planned = dict(self._verdicts(items))

    def select(self, items: Sequence[pytest.Item]) -> None:
        """Note the verdicts of those items that are left."""
        if items == self._last:
            return
        self._last = [*items]
        selected = dict(self._verdicts(items))
        left_out = [name for name in self._planned if name not in selected]
        runs = self.context.options.runs
        fewer = {declared for declared in selected.values() if runs is not None and runs < declared}
        self._selected = {
            "planned": len(self._planned | selected),
            "asked": len(selected),
            "left_out": sorted(left_out)[:_MOST_LISTED],
            "runs": runs if fewer else None,
            "declared_runs": [min(fewer), max(fewer)] if fewer else [],
        }

    def to_json(self) -> dict[str, Any]:
        """The record's key ``selection``."""
        return self._selected

    def send_to_controller(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Add to a worker's output what it collected."""
        workeroutput[_SELECTION_KEY] = json.dumps(self._selected)

    def receive_from_worker(self, workeroutput: Mapping[str, Any]) -> None:
        """Take over what a worker collected; each collects the same."""
        if _SELECTION_KEY in workeroutput:
            self._selected = json.loads(workeroutput[_SELECTION_KEY])

    def _verdicts(self, items: Sequence[pytest.Item]) -> Iterator[tuple[str, int]]:
        """Yield the verdicts that items would come to, each with its declared runs."""
        known: dict[tuple[str, int], list[str]] = {}
        for item in items:
            target = target_of(item)
            if hasattr(item, "planned"):
                yield item.nodeid, target.case.scenario.planned
            elif target is not None:
                test = item.nodeid.partition("[")[0]
                # Of all its items only those of parameters with marks decide something else.
                key = test, id(item) if item.callspec.marks else 0  # type: ignore[attr-defined]
                if key not in known:
                    known[key] = self._decided_by(item)
                for name in known[key]:
                    about = f"{name} on {target.case.id} by {test}" if name else ""
                    yield about or f"{test} on {target.case.id}", target.declared

    def _decided_by(self, item: pytest.Item) -> list[str]:
        """List the requirements that a test decides; an empty name for its own verdict."""
        if decides_nothing(item):
            return []
        try:
            names = [requirement.id for requirement in marked_requirements(self.context, item)]
        except ConfigurationError:  # the test reports it itself
            names = []
        return list(dict.fromkeys(names)) or [""]


_SHARD_KEY = "dura_shard"
"""Key in the output of a worker; the controller collects nothing."""
_LOST_ITEMS_KEY = "dura_shard_lost"
_COMPARED_OPTIONS_OF_OTHERS = ("override_ini", "runxfail", "reruns", "only_rerun", "rerun_except")
"""Options of others by which a failure may be none, or another configuration is read."""
_DISPLAY_SETTINGS = (
    "junit_",
    "log_",
    "console_",
    "cache_",
    "tmp_path_",
    "faulthandler_",
)
"""Prefixes of settings of others that ``-o`` may change in one shard alone."""


class ShardHooks:
    """Keeps the items of one shard, after every other plugin has chosen among them.

    The session is split into what it would run as a whole: after ``-k``, ``-m``, ``--deselect``,
    ``--lf``. Shards whose choice differed have different plans, and are never merged.

    Args:
        context: The session's context.
        shard: Which part it is to run.
    """

    def __init__(self, context: SessionContext, shard: Shard) -> None:
        self.context, self.shard = context, shard
        self._split: dict[str, Any] | None = None
        """Plan, units and what this shard holds, once items were collected."""
        self.lost: str | None = None
        """What stands against the shard: items that it holds and that do not run."""
        self._own_items: list[pytest.Item] = []

    def to_json(self) -> dict[str, Any]:
        """The record's key ``shard``."""
        split = self._split or {"plan": None, "units": None, "holds": []}
        return {**vars(self.shard), **split}

    @property
    def is_empty(self) -> bool:
        """Whether the session has units, and this shard rightly holds none of them."""
        return self._split is not None and self._split["units"] > 0 and not self._split["holds"]

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> Generator[None, Any, Any]:
        """Deselect the items of other shards."""
        from pytest_dura.core.codec import encode
        from pytest_dura.evidence.shard_units import plan_digest, split_units

        result = yield
        units = _units_of(self.context, items)
        holds = split_units(units, self.shard.count)[self.shard.index - 1]
        held_ids = {id(item) for unit in holds for item in units[unit]}
        deselected = [item for item in items if id(item) not in held_ids]
        self._own_items = items[:] = [item for item in items if id(item) in held_ids]
        if deselected:
            config.hook.pytest_deselected(items=deselected)
        self._split = {
            "plan": plan_digest(units),
            "units": len(units),
            "holds": [*map(encode, holds)],
        }
        if self.context.is_worker:
            config.workeroutput[_SHARD_KEY] = json.dumps(self._split)  # type: ignore[attr-defined]
        return result

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> None:
        """Check that all items which this shard holds will run: no other shard runs them."""
        present = set(map(id, session.items))
        lost = [item.nodeid for item in self._own_items if id(item) not in present]
        if lost:
            self.lost = (
                f"a plugin took out {len(lost)} of {len(self._own_items)} items after the session "
                f"was split, the first of them {lost[0]}: no shard runs them; let it choose in "
                "pytest_collection_modifyitems"
            )
        if self.context.is_worker:
            session.config.workeroutput[_LOST_ITEMS_KEY] = self.lost  # type: ignore[attr-defined]

    def pytest_report_collectionfinish(self) -> list[str]:
        """Report what this shard holds."""
        if self._split is None:
            return []
        held = self._split["holds"]
        episodes, items = (sum(unit[key] for unit in held) for key in ("episodes", "items"))
        text = f"{len(held)} of {self._split['units']} units, {items} items, {episodes} episodes"
        return [f"dura: {self.shard} holds {text}"]

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: WorkerController) -> None:
        """Take over what a worker collected."""
        split = getattr(node, "workeroutput", {}).get(_SHARD_KEY)
        if split is not None:
            self._split = json.loads(split)
        self.lost = getattr(node, "workeroutput", {}).get(_LOST_ITEMS_KEY) or self.lost

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Let a shard without items succeed, before its evidence is written."""
        if self.is_empty and session.exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:
            session.exitstatus = pytest.ExitCode.OK


def compared_options(context: SessionContext) -> dict[str, str]:
    """Return the options on which results depend, with their values as JSON."""
    options = vars(context.config.option)
    others = {name: options[name] for name in _COMPARED_OPTIONS_OF_OTHERS if name in options}
    ours = [row.ini for row in option_rows() if row.ini and not row.same_in_shards]
    display = (*_DISPLAY_SETTINGS, *ours)
    others["override_ini"] = sorted(
        setting for setting in others.get("override_ini") or [] if not setting.startswith(display)
    )
    given = context.options.compared_in_shards() | {
        f"--{name.replace('_', '-')}": json.dumps(value, default=str)
        for name, value in others.items()
        if value not in (None, False) and value != []
    }
    return dict(sorted(given.items()))


def _units_of(
    context: SessionContext, items: Sequence[pytest.Item]
) -> dict[ShardUnit, list[pytest.Item]]:
    """Split the items into units: all items of a case, and of cases that share episodes.

    A campaign that is compared with runs without faults runs those of another case, so that both
    are one unit. What a test asks of a runner itself is not known before it runs: an episode that
    two shards ran that way is recorded by both, and has to be the same one.

    Args:
        context: The session's context.
        items: Those that the whole session would run.
    """
    from pytest_dura.evidence.shard_units import ShardUnit

    groups = _Groups()
    tests: dict[str, list[pytest.Item]] = defaultdict(list)
    of_cases: list[tuple[str, pytest.Item]] = []
    for item in items:
        planned_case = _planned_case_of(context, item)
        if planned_case is None:
            tests[item.nodeid].append(item)
            continue
        case, planned, faults_left_out = planned_case
        groups.add(case.id, planned)
        if faults_left_out:
            twin = case.without_faults().id
            groups.add(twin, planned)
            groups.join(case.id, twin)
        of_cases.append((case.id, item))
    members: dict[str, list[pytest.Item]] = defaultdict(list)
    names: dict[str, str] = {}
    for name, item in of_cases:
        root = groups.root(name)
        members[root].append(item)
        names[root] = min(names.get(root, name), name)
    episodes = groups.episodes()
    units: dict[ShardUnit, list[pytest.Item]] = {}
    for root, own_items in members.items():
        ids = [item.nodeid for item in own_items]
        units[ShardUnit.of("case", names[root], ids, episodes[root])] = own_items
    for name, own_items in tests.items():
        # A test that chooses its episodes itself is counted as one episode.
        runs = any("dura_metrics" in getattr(item, "fixturenames", ()) for item in own_items)
        units[ShardUnit.of("test", name, [name] * len(own_items), int(runs))] = own_items
    return units


def _planned_case_of(context: SessionContext, item: pytest.Item) -> tuple[Case, int, bool] | None:
    """Return an item's case, its planned runs, and whether it pairs them with fault-free runs."""
    if isinstance(item, ScenarioItem):
        case, names = item.planned.case, item.planned.requirements
        runs = context.options.runs or case.scenario.planned
        return case, runs, _pairs(context, case, names)
    target = marked_target(item)
    if target is None:
        return None
    requirements = () if target.requirement is None else (target.requirement.id,)
    return target.case, target.planned, _pairs(context, target.case, requirements)


def _pairs(context: SessionContext, case: Case, names: Iterable[str]) -> bool:
    """Whether one of these requirements compares runs with their fault-free twins."""
    from pytest_dura.requirements.model import FAULTS

    known = context.library().requirements
    paired = [known[name].paired for name in names if name in known]
    return bool(case.faults) and any(
        pairing is not None and pairing.without == FAULTS for pairing in paired
    )


class _Groups:
    """Cases that share episodes, as disjoint sets, and the episodes of each set."""

    def __init__(self) -> None:
        self._above: dict[str, str] = {}
        self._planned: dict[str, int] = {}

    def add(self, case: str, planned: int) -> None:
        self._above.setdefault(case, case)
        self._planned[case] = max(planned, self._planned.get(case, 0))

    def root(self, case: str) -> str:
        while self._above[case] != case:
            self._above[case] = self._above[self._above[case]]
            case = self._above[case]
        return case

    def join(self, case: str, other: str) -> None:
        first, second = sorted((self.root(case), self.root(other)))
        self._above[second] = first

    def episodes(self) -> Counter[str]:
        """Episodes of each group, by its root."""
        counter: Counter[str] = Counter()
        for case, planned in self._planned.items():
            counter[self.root(case)] += planned
        return counter
