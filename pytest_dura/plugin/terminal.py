"""What the terminal shows: a header, and after the run cases, verdicts and failures."""

from __future__ import annotations

import os
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
    parts = [f"component under test {_component(session)}", f"base seed {options.seed}"]
    if plan:
        runs = sum(options.runs or planned.case.scenario.runs for planned in plan)
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


def _component(session: DuraSession) -> str:
    if session.options.generator is not None:
        return session.default_role("generator").label
    conftest = root_conftest_with(session.config, "generator")
    if conftest is not None:
        return f"from the fixture `generator` in {os.path.relpath(conftest, session.config.rootpath)}"
    names = {planned.case.roles({})["generator"].label for planned in session.plan}
    return ", ".join(sorted(names)) or "of the scenarios"


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
    for problem in session.evidence.record.problems if session.evidence.record else []:
        terminal.line(problem, red=True)
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
    head = ["n", "flagged", "collided", "clearance time", "gridlock", "recov", "alerts", "invalid"]
    rows = [_row(case["metrics"], users) for case in cases]
    table = [[*head, *users], *rows]
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    room = max(20, WIDTH - sum(widths) - 2 * len(widths))
    left = min(max(map(len, ["case", *names])), room)
    lines = []
    for name, row in zip(["case", *names], table, strict=True):
        cells = "".join(f"  {cell:>{width}}" for cell, width in zip(row, widths, strict=True))
        if len(name) > left:
            lines.append(name)
            name = ""  # noqa: PLW2901 - the cells stand on a line of their own
        lines.append(f"{name:<{left}}{cells}")
    return lines


def _row(metrics: Data, users: Sequence[str]) -> list[str]:
    invalid = str(metrics["invalid"])
    if metrics["missing"]:
        invalid += f" (+{metrics['missing']} missing)"
    return [
        f"{metrics['valid']}" if metrics["valid"] == metrics["planned"]
        else f"{metrics['valid']}/{metrics['planned']}",
        _percent(metrics["flagged"]),
        _percent(metrics["collided"]),
        _time(metrics["clearance_time"]),
        "-" if metrics["gridlock"] is None else str(metrics["gridlock"]["valid"]),
        str(metrics["recoveries"]),
        str(metrics["alerts"]),
        invalid,
        *(_user(metrics["user"].get(name)) for name in users),
    ]  # fmt: skip


def _percent(share: Data | None) -> str:
    if share is None or share["share_of_valid"] is None:
        return "-"
    return f"{100 * share['share_of_valid']:.0f} %"


def _time(clearance: Data | None) -> str:
    if clearance is None or clearance["mean"] is None:
        return "-"
    spread = "" if clearance["sd"] is None else f" +- {clearance['sd']:.1f}"
    return f"{clearance['mean']:.1f}{spread} s ({clearance['runs']})"


def _user(value: Data | None) -> str:
    return "-" if value is None or value["mean"] is None else f"{value['mean']:.4g}"


def _show_verdicts(session: DuraSession, terminal: Any, record: Data) -> None:
    verdicts = record["verdicts"]
    if not verdicts:
        return
    terminal.line("")
    wide = max(len(one["requirement"]) for one in verdicts)
    for verdict in verdicts:
        word = verdict["verdict"]
        terminal.write(f"{word:<9}", **COLOURS[word])
        counts = f"n = {verdict['episodes']}, {_counted(verdict['violations'], 'violation')}"
        waiver = f" [{verdict['waiver']['kind']}]" if verdict["waiver"] else ""
        terminal.line(f"  {verdict['requirement']:<{wide}}  {verdict['case']}: {counts}{waiver}")
    for verdict in verdicts:
        if verdict["verdict"] != "supported":
            _show_failure(session, terminal, record, verdict)


def _show_failure(session: DuraSession, terminal: Any, record: Data, verdict: Data) -> None:
    terminal.line("")
    terminal.line(
        f"{verdict['verdict']}: {verdict['requirement']} on {verdict['case']}", **COLOURS["violated"]
    )
    terminal.line(f"  {verdict['reason']}")
    requirement = next(
        (one for one in record["requirements"] if one["id"] == verdict["requirement"]), None
    )
    check = verdict["check"] or (requirement["check"] if requirement else "")
    if check and check != verdict["requirement"]:
        terminal.line(f"  check:  {check}")
    episode = None
    if verdict["counterexamples"]:
        worst = verdict["counterexamples"][0]
        episode = worst["episode"]
        terminal.line(f"  worst:  {_counterexample(worst)}")
    else:
        failed = [
            one
            for one in record["episodes"]
            if one["case"] == verdict["case"] and one["validity"] != "valid"
        ]
        if failed:
            episode = failed[0]["id"]
            terminal.line(f"  {failed[0]['failure'] or 'invalid: ' + failed[0]['invalid_reason']}")
    if episode is not None:
        terminal.line(f"  replay: {replay_command(session, episode)}")
    for item in verdict["item"].split(", "):
        terminal.line(f"  rerun:  {rerun_command(session, item)}")


def _counterexample(worst: Data) -> str:
    when = "" if worst["time"] is None else f" at t = {worst['time']:.2f} s"
    by = "" if worst["margin"] is None else f", by {abs(worst['margin']):.3g}"
    return f"run {worst['episode']}{when}{by}"


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def _relative(session: DuraSession, file: Any) -> str:
    return os.path.relpath(file, session.config.invocation_params.dir)
