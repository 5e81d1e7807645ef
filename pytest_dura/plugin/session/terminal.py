"""The header and the closing section of a session in pytest's terminal."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.evidence.objections import other_objections
from pytest_dura.evidence.text import counted, indent_if_reserved
from pytest_dura.plugin.context import replay_command, rerun_command
from pytest_dura.plugin.messages import SafeTerminal, safe_lines, typed_path
from pytest_dura.plugin.session.roles import (
    none_in_root_conftest,
    overrides_deeper_down,
    root_conftest_with,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pytest

    from pytest_dura.evidence.baseline import Baseline
    from pytest_dura.evidence.model import SessionRecord
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.plugin.session.episodes import SharedEpisodes
    from pytest_dura.plugin.session.executor import SessionExecutor
    from pytest_dura.plugin.session.roles import SessionRoles
    from pytest_dura.reports.document import Entry


def _resume_command(config: pytest.Config) -> str:
    arguments: list[Any] = [*config.invocation_params.args]
    option = "--dura-resume"
    if option not in arguments:
        arguments.append(option)
    return shlex.join(["pytest", *map(str, arguments)])


def _baseline_header(baseline: Baseline | None) -> list[str]:
    if baseline is None:
        return []
    names = sorted({claim.component for claim in baseline.claims})
    which = ", ".join([*names, baseline.session.created])
    lines = [f"dura: compared with the baseline {baseline.session.path} ({which})"]
    if baseline.session.status != "complete":
        lines.append(f"dura: warning: the baseline's session was {baseline.session.status}")
    return lines


def header(
    context: SessionContext,
    *,
    roles: SessionRoles,
    executor: SessionExecutor,
    shared: SharedEpisodes,
    baseline: Baseline | None,
) -> list[str]:
    """Name component under test, base seed, what will run, and what is probably not meant."""
    config, options, plan = context.config, context.options, context.plan
    parts = [f"base seed {options.seed}"]
    component = _component(context, roles)
    if component:
        parts.insert(0, f"component under test {component}")
    if plan:
        runs = sum(options.runs or planned.case.scenario.planned for planned in plan)
        parts.append(f"{counted(len(plan), 'case')}, {counted(runs, 'episode')}")
    lines = [*context.guests.first_lines(), "dura: " + ", ".join(parts)]
    lines += _which_scenarios(context)
    if options.runs is not None:
        lines.append(f"dura: --dura-runs={options.runs} replaces the planned number of runs")
    if options.shard is not None:
        lines.append(f"dura: {options.shard} of that; the others run elsewhere")
    lines += [f"dura: {role} is OFF: {where}" for role, where in _switched_off(context)]
    lines += executor.header()
    if context.runs_scenarios_alone and config.pluginmanager.hasplugin("dsession"):
        from pytest_dura.plugin.session.xdist import idle_workers

        lines += idle_workers(context)
    lines += [f"dura: {line}" for line in shared.lines]
    lines += context.guests.header()
    lines += _baseline_header(baseline)
    if plan:
        lines += [f"dura: warning: {warning}" for warning in context.library().warnings]
        lines += [
            f"dura: warning: {file} overrides `{role}`, which scenario items do not see; "
            "move the fixture to the root conftest.py"
            for file, role in overrides_deeper_down(config)
        ]
    return [safe_line for line in lines for safe_line in safe_lines(context.redact(line))]


def _which_scenarios(context: SessionContext) -> Iterator[str]:
    """Say whether the scenarios of the session are the project's own or the built-in ones."""
    if context.options.scenarios is None or context.own_arguments or not context.plan:
        return
    library = context.library()
    if context.options.scenarios == "builtin":
        yield "dura: the built-in scenarios"
    elif not library.own:
        yield "dura: the built-in scenarios, since the project has none of its own"
    elif library.builtin:
        yield "dura: the project's own scenarios; --dura-scenarios=builtin runs the built-in ones"
    else:
        yield "dura: the project's own scenarios"


def _switched_off(context: SessionContext) -> list[tuple[str, str]]:
    """List the roles that run nowhere, as far as known before anything runs, and why."""
    places = {
        role: f"the fixture in {file}" for file, role in none_in_root_conftest(context.config)
    }
    for planned in context.plan:
        for role in planned.case.roles_off({}):
            places.setdefault(role, f"the scenario {planned.case.scenario.name}")
    return sorted(places.items())


def unused_requirements(context: SessionContext) -> list[str]:
    """Warn of requirements that nothing decides, which is probably not meant."""
    lines = (
        f"dura: warning: {place}: no scenario and no collected test uses the requirement {name!r}"
        for name, place in context.unused.items()
    )
    return [safe_line for line in lines for safe_line in safe_lines(line)]


def _component(context: SessionContext, roles: SessionRoles) -> str:
    """Name the component, or where it comes from, as far as known before anything runs."""
    if context.options.generator is not None:
        return roles.default("generator").label
    conftest = root_conftest_with(context.config, "generator")
    if conftest is not None:
        return f"from the fixture `generator` in {conftest}"
    names = {planned.case.roles({})["generator"].label for planned in context.plan}
    return ", ".join(sorted(names))


_COLOURS: Mapping[str, str] = {
    "violated": "red", "incomplete": "red", "worse": "red", "falsified": "red",
    "not repeatable": "red", "baseline": "red", "undecided": "yellow", "supported": "green",
    "better": "green",
}  # fmt: skip
"""Colours by status."""


def summary(
    context: SessionContext,
    terminal: Any,
    record: SessionRecord,
    *,
    file: Path | None,
    objections: list[str],
    notes: list[str],
    shared: SharedEpisodes,
) -> None:
    """Show the document of the session, from the record alone, and where its evidence lies.

    Args:
        context: The session's context.
        terminal: pytest's own.
        record: Of the session that has ended.
        file: The record's file, if it could be written.
        objections: What stands against the session beside its verdicts.
        notes: Where episodes were simulated against what an option says.
        shared: What was taken over, and what can be.
    """
    from pytest_dura.reports.document import Level
    from pytest_dura.reports.pens.terminal import MOST_ROWS, TerminalPen
    from pytest_dura.reports.story import document_of

    verbose = context.config.option.verbose > 0
    document = document_of(record, Level.SUMMARY if verbose else Level.TERMINAL)

    def command(entry: Entry) -> str:
        return (replay_command if entry.kind == "replay" else rerun_command)(context, entry.text)

    pen = TerminalPen(document, command, verbose=verbose)
    lines = list(pen.lines())
    if not lines and not record.head.shard:
        return
    terminal.section("dura", "=")
    terminal = SafeTerminal(terminal)
    if not context.active:  # then there was no header
        for line in shared.lines:
            terminal.line(line)

    for text, status in lines:
        terminal.line(text, **{_COLOURS[status]: True} if status in _COLOURS else {})
    for note in notes:
        terminal.line(note)
    # Those of the record have cards.
    carded = set(other_objections(record.head))
    left = [objection for objection in objections if objection not in carded]
    for objection in left[:MOST_ROWS]:
        terminal.line(indent_if_reserved(objection), red=True)
    if len(left) > MOST_ROWS:
        text = f"and {len(left) - MOST_ROWS} more like the last one; evidence.json has them"
        terminal.line(text, red=True)
    terminal.line("")
    if file is not None:
        terminal.line(document.verdict)
        if record.head.shard:
            terminal.line("a part of a session: `python -m pytest_dura merge` gates on the whole")
        report = file.with_name("report.html")
        opened = report if report.is_file() else file
        terminal.line(f"evidence: {typed_path(opened, context.config.invocation_params.dir)}")
        if not shared.is_whole and shared.cache.count():
            terminal.line(f"to go on: {context.redact(_resume_command(context.config))}")
