"""What the terminal shows: a header, and after the run cases, verdicts and failures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.evidence.record.effectiveness import RECOVERY
from pytest_dura.plugin.baseline_lines import baseline_header, show_baseline
from pytest_dura.plugin.failure_mode_lines import failure_mode_table
from pytest_dura.plugin.fault_lines import fault_table
from pytest_dura.plugin.messages import Shown, apart, shown_lines
from pytest_dura.plugin.overrides import (
    none_in_root_conftest,
    overrides_deeper_down,
    root_conftest_with,
)
from pytest_dura.plugin.places import from_here
from pytest_dura.plugin.repeats import show_repeats
from pytest_dura.plugin.reuse_lines import resume_lines, reuse_lines, searched_lines
from pytest_dura.plugin.search_lines import counts as search_counts
from pytest_dura.plugin.search_lines import show_searches
from pytest_dura.plugin.shortening import ELSEWHERE, MOST, worst_cases
from pytest_dura.plugin.tables import (
    attack_table,
    case_table,
    counted,
    effectiveness_lines,
    monitor_table,
    pair_table,
    reliance_table,
)
from pytest_dura.plugin.verdict_lines import show_verdicts

if TYPE_CHECKING:
    from pytest_dura.evidence.record.session_record import SessionRecord
    from pytest_dura.plugin.session import DuraSession

_COUNTED = ("supported", "violated", "undecided", "waived")


def header(session: DuraSession) -> list[str]:
    """Component under test, base seed, what will run, and what is probably not meant."""
    options, plan = session.options, session.plan
    parts = [f"base seed {options.seed}"]
    component = _component(session)
    if component:
        parts.insert(0, f"component under test {component}")
    if plan:
        runs = sum(options.runs or planned.case.scenario.planned for planned in plan)
        parts.append(f"{counted(len(plan), 'case')}, {counted(runs, 'episode')}")
    lines = [*session.models.replayed(), "dura: " + ", ".join(parts)]
    if options.runs is not None:
        lines.append(f"dura: --dura-runs={options.runs} replaces the planned number of runs")
    if options.shard is not None:
        lines.append(f"dura: {options.shard} of that; the others run elsewhere")
    lines += [f"dura: {role} is OFF: {where}" for role, where in _switched_off(session)]
    lines += session.simulating.header()
    lines += [f"dura: {one}" for one in session.shared.lines]
    lines += session.models.header()
    lines += baseline_header(session.evidence.given.baseline)
    if plan:
        lines += [f"dura: warning: {one}" for one in session.library().warnings]
        lines += [
            f"dura: warning: {file} overrides `{role}`, which scenario items do not see; "
            "move the fixture to the root conftest.py"
            for file, role in overrides_deeper_down(session.config)
        ]
    return [one for line in lines for one in shown_lines(line)]


def _switched_off(session: DuraSession) -> list[tuple[str, str]]:
    """Roles that run nowhere, as far as that is known before anything runs, and who says so."""
    found = {role: f"the fixture in {file}" for file, role in none_in_root_conftest(session.config)}
    for planned in session.plan:
        for role in planned.case.roles_off({}):
            found.setdefault(role, f"the scenario {planned.case.scenario.name}")
    return sorted(found.items())


def unused(session: DuraSession) -> list[str]:
    """Requirements that are defined and decided by nothing, which is probably not meant."""
    return [
        f"dura: warning: {place}: no scenario and no collected test uses the requirement {name!r}"
        for name, place in session.unused.items()
    ]


def _component(session: DuraSession) -> str:
    """Its name, or where it comes from, as far as that is known before anything runs."""
    if session.options.generator is not None:
        return session.roles.default("generator").label
    conftest = root_conftest_with(session.config, "generator")
    if conftest is not None:
        return f"from the fixture `generator` in {conftest}"
    names = {planned.case.roles({})["generator"].label for planned in session.plan}
    return ", ".join(sorted(names))


def summary(session: DuraSession, terminal: Any) -> None:
    """Cases, verdicts and failures, from the record alone."""
    record = session.evidence.final
    told = ("cases", "searches", "baseline", "shard")
    if record is None or not (any(record[key] for key in told) or any(searched_lines(record))):
        return
    terminal.section("dura", "=")
    terminal = Shown(terminal)
    if not session.active:  # then there was no header
        for line in session.shared.lines:
            terminal.line(line)
    if record["cases"]:
        _show_cases(session, terminal, record)
    show_verdicts(session, terminal, record)
    show_searches(session, terminal, record)
    for line in searched_lines(record):
        terminal.line(line)
    show_repeats(session, terminal, record)
    show_baseline(terminal, record)
    for note in session.simulating.notes():
        terminal.line(note)
    _show_objections(terminal, session.evidence.objections)
    terminal.line("")
    if session.evidence.file is not None:
        terminal.line(_gate_line(record))
        if record["shard"]:
            terminal.line("a part of a session: `python -m pytest_dura merge` gates on the whole")
        page = from_here(_page(session.evidence.file), session.config.invocation_params.dir)
        terminal.line(f"evidence: {page}")
        for line in resume_lines(session):
            terminal.line(line)


def _show_objections(terminal: Any, objections: list[str]) -> None:
    for objection in objections[:MOST]:
        terminal.line(apart(objection), red=True)
    if len(objections) > MOST:
        told = f"and {len(objections) - MOST} more like the last one; evidence.json has them"
        terminal.line(told, red=True)


def _gate_line(record: SessionRecord) -> str:
    """The gate's word, and the verdicts that it rests on."""
    from pytest_dura.evidence.formats.stated import part, selected

    totals = record["totals"]
    parts = [f"{totals[word]} {word}" for word in _COUNTED if totals[word]]
    whose = f"gate of {part(record)}" if part(record) else "gate"
    found = search_counts(record)
    told = f"; searches: {found}" if found else ""
    gate = [totals["gate"], *filter(None, [selected(record)]), *(parts or ["no verdict"])]
    return f"{whose}: {', '.join(gate)}{told}"


def _page(file: Path) -> Path:
    """What to open: the report, or the record itself where the report could not be made."""
    report = file.with_name("report.html")
    return report if report.is_file() else file


def _show_cases(session: DuraSession, terminal: Any, record: SessionRecord) -> None:
    """What was run, and the tables of what it came to."""
    from pytest_dura.evidence.formats.stated import roles_off

    terminal.line(f"component under test: {_names(record)}, base seed {record['base_seed']}")
    for line in roles_off(record):
        terminal.line(line, yellow=True)
    if session.options.runs is not None:
        terminal.line(f"--dura-runs={session.options.runs} replaced the planned number of runs")
    terminal.line("")
    # Runs without a role that serve a comparison are told in its table.
    twins = {one["pairs"]["case"] for one in record["verdicts"] if one["pairs"]}
    shown = [case for case in record["cases"] if not case["without"] or case["id"] not in twins]
    most = None if session.config.option.verbose > 0 else MOST
    listed = worst_cases(shown, record["verdicts"], most=most)
    overall = record["overall"]
    for line in case_table(listed, overall):
        terminal.line(line)
    if len(listed) < len(shown):
        told = "those with the worst verdicts are shown"
        terminal.line(f"and {counted(len(shown) - len(listed), 'case')} more: {told}; {ELSEWHERE}")
    left = {case["id"] for case in shown}.difference(case["id"] for case in listed)
    verdicts = [verdict for verdict in record["verdicts"] if verdict["case"] not in left]
    early = sum(case["metrics"]["ended_early"] for case in record["cases"])
    if early:
        told = "ended early, once all was decided; figures are up to then"
        terminal.line(f"{counted(early, 'episode')} {told}")
    for line in reuse_lines(record):
        terminal.line(line)
    by_hand = sum(not episode["planned"] for episode in record.episodes())
    if by_hand:
        terminal.line(f"and {counted(by_hand, 'episode')} with a seed chosen by hand")
    for lines in (
        failure_mode_table(shown, by_case=session.config.option.verbose > 0),
        reliance_table(listed, overall),
        fault_table(listed),
        attack_table(verdicts, record["cases"]),
        [
            *pair_table(verdicts, record["cases"]),
            *effectiveness_lines(record["effectiveness"], RECOVERY),
        ],
        [
            *monitor_table(
                [one for one in record["monitors"] if one["case"].partition("~")[0] not in left]
            ),
            *effectiveness_lines(record["effectiveness"]),
        ],
    ):
        for line in lines and ["", *lines]:
            terminal.line(line)


def _names(record: SessionRecord) -> str:
    names = sorted({case["component"] for case in record["cases"]})
    under_test = record["component_under_test"]
    opaque = " (a bare instance, in this process only)" if under_test.get("opaque") else ""
    return ", ".join(names) + opaque
