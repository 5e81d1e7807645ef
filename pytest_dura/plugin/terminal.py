"""What the terminal shows: a header, and after the run cases, verdicts and failures."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pytest_dura.plugin.commands import replay_command, rerun_command
from pytest_dura.plugin.overrides import overrides_deeper_down, root_conftest_with

if TYPE_CHECKING:
    from pytest_dura.plugin.session import DuraSession

Data = Mapping[str, Any]

WIDTH = 100
COLOURS = {"supported": {"green": True}, "violated": {"red": True}, "undecided": {"yellow": True}}


def header(session: DuraSession) -> list[str]:
    """Component under test, base seed, what will run, and what is probably not meant."""
    options, plan = session.options, session.plan
    parts = [f"base seed {options.seed}"]
    component = _component(session)
    if component:
        parts.insert(0, f"component under test {component}")
    if plan:
        runs = sum(options.runs or planned.case.scenario.planned for planned in plan)
        parts.append(f"{_counted(len(plan), 'case')}, {_counted(runs, 'episode')}")
    lines = ["dura: " + ", ".join(parts)]
    if options.runs is not None:
        lines.append(f"dura: --dura-runs={options.runs} replaces the planned number of runs")
    if plan:
        lines += [f"dura: warning: {one}" for one in session.library().warnings]
        lines += [
            f"dura: warning: {file} overrides `{role}`, which scenario items do not see; "
            "move the fixture to the root conftest.py"
            for file, role in overrides_deeper_down(session.config)
        ]
    return lines


def unused(session: DuraSession) -> list[str]:
    """Requirements that are defined and decided by nothing, which is probably not meant."""
    return [
        f"dura: warning: {place}: no scenario and no collected test uses the requirement {name!r}"
        for name, place in session.unused.items()
    ]


def _component(session: DuraSession) -> str:
    """Its name, or where it comes from, as far as that is known before anything runs."""
    if session.options.generator is not None:
        return session.default_role("generator").label
    conftest = root_conftest_with(session.config, "generator")
    if conftest is not None:
        return f"from the fixture `generator` in {conftest}"
    names = {planned.case.roles({})["generator"].label for planned in session.plan}
    return ", ".join(sorted(names))


def summary(session: DuraSession, terminal: Any) -> None:
    """Cases, verdicts and failures, from the record alone."""
    record = session.evidence.final
    if record is None or not record["cases"]:
        return
    terminal.section("dura", "=")
    terminal.line(f"component under test: {_names(record)}, base seed {record['base_seed']}")
    if session.options.runs is not None:
        terminal.line(f"--dura-runs={session.options.runs} replaced the planned number of runs")
    terminal.line("")
    for line in case_table(record["cases"]):
        terminal.line(line)
    by_hand = sum(not episode["planned"] for episode in record["episodes"])
    if by_hand:
        terminal.line(f"and {_counted(by_hand, 'episode')} with a seed chosen by hand")
    _show_verdicts(session, terminal, record)
    for objection in session.evidence.objections:
        terminal.line(objection, red=True)
    terminal.line("")
    terminal.line(f"evidence: {_relative(session, session.evidence.file)}")


def _names(record: Data) -> str:
    names = sorted({case["component"] for case in record["cases"]})
    under_test = record["component_under_test"]
    opaque = " (a bare instance, in this process only)" if under_test.get("opaque") else ""
    return ", ".join(names) + opaque


def case_table(cases: Sequence[Data]) -> list[str]:
    """The paper's table: one line per case and component."""
    several = len({case["component"] for case in cases}) > 1
    users = sorted({name for case in cases for name in case["metrics"]["user"]})
    names = [f"{case['id']} ({case['component']})" if several else case["id"] for case in cases]
    table = [[*COLUMNS, *users], *(_row(case["metrics"], users) for case in cases)]
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    room = max(24, WIDTH - sum(widths) - 2 * len(widths))
    left = min(max(map(len, ["case", *names])), room)
    lines = []
    for name, row in zip(["case", *names], table, strict=True):
        cells = "".join(f"  {cell:>{width}}" for cell, width in zip(row, widths, strict=True))
        if len(name) > left:
            lines += [name, " " * left + cells]
        else:
            lines.append(f"{name:<{left}}{cells}")
    return [*lines, *LEGEND]


COLUMNS = ("n", "flag %", "coll %", "clearance s", "grid", "recov", "alerts", "inv")
LEGEND = (
    "n: valid runs (of those planned); flag, coll: runs with an unsafe proposal, with a collision;",
    "clearance: mean +- sd over cleared runs (their number); grid: gridlock, not cleared in time",
)


def _row(metrics: Data, users: Sequence[str]) -> list[str]:
    valid, planned = metrics["valid"], metrics["planned"]
    grid = metrics["gridlock"]
    missing = f"+{metrics['missing']} missing" if metrics["missing"] else ""
    return [
        str(valid) if valid == planned else f"{valid} ({planned})",
        _percent(metrics["flagged"]),
        _percent(metrics["collided"]),
        _time(metrics["clearance_time"]),
        "-" if grid is None else str(grid["valid"]),
        str(metrics["recoveries"]),
        str(metrics["alerts"]),
        f"{metrics['invalid']}{missing}",
        *(_user(metrics["user"].get(name)) for name in users),
    ]


def _percent(share: Data | None) -> str:
    if share is None or share["share_of_valid"] is None:
        return "-"
    return f"{100 * share['share_of_valid']:.0f}"


def _time(clearance: Data | None) -> str:
    if clearance is None or clearance["mean"] is None:
        return "-"
    spread = "" if clearance["sd"] is None else f" +- {clearance['sd']:.1f}"
    return f"{clearance['mean']:.1f}{spread} ({clearance['runs']})"


def _user(value: Data | None) -> str:
    return "-" if value is None or value["mean"] is None else f"{value['mean']:.4g}"


def _show_verdicts(session: DuraSession, terminal: Any, record: Data) -> None:
    verdicts = record["verdicts"]
    if not verdicts:
        return
    terminal.line("")
    same: dict[tuple[str, ...], list[Data]] = {}
    for verdict in verdicts:
        same.setdefault((verdict["verdict"], _counts(verdict)), []).append(verdict)
    for (word, counts), group in same.items():
        terminal.write(f"{word:<9}", **COLOURS[word])
        terminal.line(f"  {counts}")
        names = ", ".join(dict.fromkeys(one["requirement"] for one in group))
        for line in textwrap.wrap(names, WIDTH - 11, break_on_hyphens=False):
            terminal.line(f"{'':<11}{line}")
    alike: dict[tuple[str, ...], list[Data]] = {}
    for verdict in verdicts:
        if verdict["verdict"] != "supported":
            # What is undecided for one reason is told once for all requirements of a case.
            apart = (
                verdict["requirement"] if verdict["verdict"] == "violated" else verdict["reason"]
            )
            alike.setdefault((verdict["case"], verdict["component"], apart), []).append(verdict)
    for group in alike.values():
        _show_failure(session, terminal, record, group)


def _counts(verdict: Data) -> str:
    """On which case, and the figures that the verdict rests on."""
    counts = f"n = {verdict['episodes']}, {_counted(verdict['violations'], 'violation')}"
    bound = verdict["bound"]
    if bound["upper"] is not None:
        counts += f" (rate <= {bound['upper']:.2g} at {bound['confidence']:.0%})"
    waiver = f" [{verdict['waiver']['kind']}]" if verdict["waiver"] else ""
    return f"{verdict['case']} ({verdict['component']}): {counts}{waiver}"


def _show_failure(
    session: DuraSession, terminal: Any, record: Data, verdicts: Sequence[Data]
) -> None:
    first = verdicts[0]
    names = ", ".join(dict.fromkeys(one["requirement"] for one in verdicts))
    terminal.line("")
    terminal.line(
        f"{first['verdict']}: {names} on {first['case']} ({first['component']})",
        **COLOURS[first["verdict"]],
    )
    for line in textwrap.wrap(first["reason"], WIDTH - 2):
        terminal.line(f"  {line}")
    check = first["check"] or _check_of(record, first["requirement"])
    if check and len(verdicts) == 1 and check != first["requirement"]:
        terminal.line(f"  check:  {check}")
    episode = None
    if first["counterexamples"]:
        from pytest_dura.campaign.reasons import describe_counterexample

        episode = first["counterexamples"][0]["episode"]
        terminal.line(f"  worst:  {describe_counterexample(first['counterexamples'][0])}")
        for event in _critical(record, episode):
            terminal.line(f"  event:  at t = {event['time']:.2f} s {event['detail']}")
    else:
        spoilt = _spoilt(record, first)
        if spoilt is not None:
            episode = spoilt["id"]
            terminal.line(f"  {spoilt['failure'] or 'invalid: ' + spoilt['invalid_reason']}")
    if episode is not None:
        terminal.line(f"  replay: {replay_command(session, episode)}")
    items = list(dict.fromkeys(item for one in verdicts for item in one["item"].split(", ")))
    if len(items) > 1 and all(item.startswith(f"{first['case']}::") for item in items):
        items = [first["case"]]
    for item in items:
        terminal.line(f"  rerun:  {rerun_command(session, item)}")


def _check_of(record: Data, requirement: str) -> str:
    return next((one["check"] for one in record["requirements"] if one["id"] == requirement), "")


def _critical(record: Data, episode: str) -> list[Data]:
    """What ended an episode before its time, if anything did."""
    return [
        event
        for one in record["episodes"]
        if one["id"] == episode
        for event in one["events"]
        if event["kind"] == "critical"
    ]


def _spoilt(record: Data, verdict: Data) -> Data | None:
    """The first episode of the case that says nothing; a missing one before an invalid one."""
    found = [
        one
        for one in record["episodes"]
        if (one["case"], one["component"]) == (verdict["case"], verdict["component"])
        and one["planned"]
        and one["validity"] != "valid"
    ]
    return min(found, key=lambda one: one["validity"] != "missing", default=None)


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def _relative(session: DuraSession, file: Any) -> str:
    return os.path.relpath(file, session.config.invocation_params.dir)
