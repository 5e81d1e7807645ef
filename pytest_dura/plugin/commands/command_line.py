"""``--dura-list``, ``--dura-replay``, ``--dura-replay-failures`` and ``--dura-reduce``: no tests.

The first lists what is known and what would run. The others run episodes of the evidence
again: to compare one with its record, to see which violations come by chance, or to find the
smallest set of an episode's faults that still violates a requirement.
"""

from __future__ import annotations

from bdb import BdbQuit
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.text import counted
from pytest_dura.guests import ListedCase, default_domain
from pytest_dura.plugin.commands.failures import replay_failures
from pytest_dura.plugin.commands.replay import (
    RecordedEpisode,
    damage_as_error,
    recorded_episodes,
    replay,
)
from pytest_dura.plugin.context import Planned, replay_command
from pytest_dura.plugin.messages import print_lines, sibling_directory, usage_errors
from pytest_dura.requirements.model import FAULTS

if TYPE_CHECKING:
    from pytest_dura.core.registry import Registry
    from pytest_dura.domains import Domain
    from pytest_dura.evidence.model import SessionRecord
    from pytest_dura.plugin.options import Options
    from pytest_dura.plugin.session.session import DuraSession
    from pytest_dura.search.shrinking import Reduction


def run_command(session: DuraSession) -> int:
    """Run the command that the options name, and return the exit code.

    Raises:
        pytest.UsageError: For options and files that cannot be used.
    """
    options = session.options
    session.extend_import_path()
    with usage_errors():
        if not (options.replay or options.reduce or options.replay_failures):
            session.roles.check()
            session.make_plan()
            return _show_list(session)
        try:
            with session.guests:
                if options.replay_failures:
                    return replay_failures(session)
                return reduce(session) if options.replay is None else replay(session)
        except BdbQuit:  # of a debugger, where pytest has not yet put its own in place
            print_lines(["Exit: Quitting debugger"], session.redact)
            return pytest.ExitCode.INTERRUPTED


def _fault_line(name: str) -> str:
    """Describe a fault type, or say why it cannot be used."""
    from pytest_dura.faults.catalogue import fault_class

    try:
        fault_type = fault_class(name)
    except ConfigurationError as error:  # another package's, which is not used here
        return f"  {name}: {error.problem}"
    summary = (fault_type.__doc__ or "").partition("\n")[0]
    return f"  {name} ({fault_type.acts_on}): {summary}"


def _show_list(session: DuraSession) -> int:
    from pytest_dura.faults.catalogue import FAULT_TYPES
    from pytest_dura.requirements.model import describe_check

    library, options = session.library(), session.options
    lines = ["scenarios"]
    for name, scenario in library.scenarios.items():
        faults = ", ".join(fault.name for fault in scenario.faults) or "none"
        lines.append(f"  {name}: {scenario.description}")
        runs = f"{scenario.planned} runs"
        if scenario.until_decided:
            runs = f"runs until decided, at most {scenario.planned}"
        lines.append(f"      {runs}, {scenario.lasts:g} s each, faults: {faults}")
        if scenario.campaigns:
            lines.append(f"      fault campaigns: {len(scenario.campaigns)}")
        lines.append(f"      requirements: {', '.join(scenario.requirements) or 'none'}")
    lines += ["", "faults (name them in a marker, a scenario or --dura-faults; docs/faults.md)"]
    domains = _listed_domains(session)
    lines += map(_fault_line, FAULT_TYPES if _shows_all(options) else _usable_in(domains))
    lines += ["", "requirements"]
    for name, requirement in library.requirements.items():
        lines.append(f"  {name} ({requirement.kind}): {requirement.text}")
        lines += [f"      {line}" for line in describe_check(requirement)]
    for domain in domains:
        lines += _domain_lines(domain)
    lines += _registered_lines()
    lines += ["", f"would run with --dura-scenarios, base seed {options.seed}"]
    episodes = 0
    for planned in session.plan:
        number = options.runs or planned.case.scenario.planned
        episodes += number
        lines += [f"  {planned.case.id}::{name}" for name in planned.requirements]
        lines.append(f"      {number} episodes")
    items = sum(len(planned.requirements) for planned in session.plan)
    lines.append(f"{items} items, {len(session.plan)} cases, {episodes} episodes")
    lines += session.guests.listed([_listed_case(session, planned) for planned in session.plan])
    lines += [f"warning: {warning}" for warning in library.warnings]
    lines += [
        f"warning: {place}: no scenario uses the requirement {name!r}"
        for name, place in library.unused.items()
    ]
    print_lines(lines, session.redact)
    return 0


def _listed_case(session: DuraSession, planned: Planned) -> ListedCase:
    """Describe a case for the lines of guests."""
    known, runner = session.library().requirements, session.runner
    case = planned.case
    pairs = [known[name].paired for name in planned.requirements]
    others = {side for pair in pairs if pair for side in (pair.without, pair.reference) if side}
    if case.faults and session.options.twins:
        others.add(FAULTS)

    def component() -> Any:
        return case.roles(runner.roles)["generator"].resolve()

    return ListedCase(
        episodes=(session.options.runs or case.scenario.planned) * (1 + len(others)),
        component=component,
        task=lambda: runner.task(case),
    )


def _listed_domains(session: DuraSession) -> list[str | Domain]:
    """List the domains to show: all, or those of the project."""
    from pytest_dura.domains import DOMAINS

    options = session.options
    if _shows_all(options):
        return [*DOMAINS]
    systems = [scenario.system for scenario in session.library().scenarios.values()]
    used = {system.name: system for system in systems if system is not None}
    if not used or options.domain != default_domain():
        used.setdefault(options.domain, DOMAINS[options.domain])
    return [used[name] for name in sorted(used)]


def _shows_all(options: Options) -> bool:
    """Whether all domains are shown: with the built-in files, and where a project names none."""
    return options.builtin_scenarios or not options.domain


def _usable_in(domains: Sequence[str | Domain]) -> list[str]:
    """List the fault types that can act in one of these domains."""
    from pytest_dura.faults.catalogue import FAULT_TYPES
    from pytest_dura.library.fault_campaigns import catalogue_of

    usable = {fault for domain in domains for fault in catalogue_of(_loaded(domain))}
    return [name for name in FAULT_TYPES if name in usable]


def _loaded(domain: str | Domain) -> Domain:
    from pytest_dura.domains import DOMAINS

    return DOMAINS[domain] if isinstance(domain, str) else domain


def _domain_lines(listed: str | Domain) -> Iterator[str]:
    """Yield what a domain declares, its default roles, and the short names of others."""
    from pytest_dura.library.domain_reference import declared

    try:
        domain = _loaded(listed)
        tables = declared(domain)
        roles, short_names = domain.default_roles, domain.short_names
    except ConfigurationError as error:  # another package's, which is not used here
        yield from ("", f"domain {listed}", f"  {error.problem}")
        return
    name = domain.name
    for table in tables:
        yield from ("", f"{table.title} of the domain {name}")
        for first, *rest in table.rows:
            yield f"  {first}: " + "; ".join(filter(None, rest))
    yield from ("", f"roles of the domain {name} (override the fixture of that name)")
    yield from (f"  {role}: {path}" for role, path in roles.items())
    for role, names in short_names.items():
        use = "--dura-generator" if role == "generator" else "`roles` in a scenario"
        yield from ("", f"short names of {role} in the domain {name} (for {use})")
        yield from (f"  {short}: {path}" for short, path in names.items())


def _registered_lines() -> Iterator[str]:
    """Yield simulators, executors and formats with what registers them, and what is wrong there."""
    from pytest_dura.core.messages import MESSAGES
    from pytest_dura.core.simulator import SIMULATORS
    from pytest_dura.domains import DOMAINS, ROLES
    from pytest_dura.evidence.bundle import FORMATS
    from pytest_dura.evidence.conclusions.tables import TABLES
    from pytest_dura.execution.executors import EXECUTORS
    from pytest_dura.faults.catalogue import FAULT_TYPES
    from pytest_dura.reports.html.panels import PANELS
    from pytest_dura.reports.plots.plot import PLOTS

    listed: dict[str, Registry[Any]] = {
        "simulators (for `simulator` in a scenario)": SIMULATORS,
        "executors (for --dura-executor)": EXECUTORS,
        "report formats (files of each bundle)": FORMATS,
        "tables of a session": TABLES,
        "plots of a session": PLOTS,
        "panels of the player": PANELS,
    }
    for title, registry in listed.items():
        yield from ("", title)
        for name in registry:
            yield _registered_line(registry, name)
    others: list[Registry[Any]] = [DOMAINS, ROLES, FAULT_TYPES, MESSAGES]
    for registry in (*others, *listed.values()):
        for problem in registry.problems():
            yield f"warning: {problem.problem}"


def _registered_line(registry: Registry[Any], name: str) -> str:
    try:
        entry = registry.entry(name)
    except ConfigurationError as error:
        return f"  {name}: {error.problem}"
    return f"  {name}: {entry.path} ({entry.provider})"


_REDUCE_OPTION = "--dura-reduce"
_REDUCED = "reduced"
"""Behind the name of the evidence: where the reduced episode is recorded, to be replayed from."""


def reduce(session: DuraSession) -> int:
    """Reduce the faults of an episode; the exit code is 0 if its violation came up again, else 1.

    Raises:
        ConfigurationError: For an unknown episode, and one that violated nothing or has no faults.
    """
    from pytest_dura.search.shrinking import REDUCTION_BUDGET, reduce_faults

    options = session.options
    name = str(options.reduce)
    record, candidates = recorded_episodes(session.config, options, name, _REDUCE_OPTION)
    # Verdicts name episodes without their seeds, and rest on planned runs.
    candidates.sort(key=lambda candidate: not candidate.planned)
    recorded = next((candidate for candidate in candidates if candidate.violated), candidates[0])
    _check_reducible(recorded, name)
    session.guests.prepare(recorded.spec)
    requirements = [
        requirement for requirement in recorded.requirements if requirement.id in recorded.violated
    ]
    budget = REDUCTION_BUDGET if options.runs is None else options.runs
    spec = recorded.spec
    violates = f"violates {', '.join(recorded.violated)}; at most {budget} runs"
    print_lines([f"{name} ({spec.component}): {counted(len(spec.faults), 'fault')}, {violates}"])
    with damage_as_error(options, name, _REDUCE_OPTION):
        reduction = reduce_faults(spec, requirements, recorded.run, budget=budget, on_run=_show_run)
    lines = _result_lines(reduction, budget)
    if reduction.episode is not None:
        folder = sibling_directory(options.evidence, _REDUCED)
        with damage_as_error(options, name, _REDUCE_OPTION):
            _write_reduced(record, recorded, reduction, folder)
        lines.append(f"  replay: {replay_command(session, reduction.episode.id, folder)}")
    print_lines(lines, session.redact)
    return 0 if reduction.reproduced else 1


def _check_reducible(recorded: RecordedEpisode, name: str) -> None:
    if not recorded.spec.faults:
        raise ConfigurationError(
            f"the episode {name!r} has no faults to leave out",
            key=_REDUCE_OPTION,
            found=name,
            expected="an episode with at least one fault",
        )
    checked = {
        requirement.id
        for requirement in recorded.requirements
        if requirement.check and not requirement.paired
    }
    if not set(recorded.violated) & checked:
        raise ConfigurationError(
            f"the episode {name!r} is no counterexample to a requirement that could be asked again",
            key=_REDUCE_OPTION,
            found=", ".join(recorded.violated) or "no violation",
            expected="an episode that a verdict names as a counterexample, by a check in a file",
            remedy="choose an episode that the terminal shows as `worst` or `also in`",
        )


def _show_run(faults: Sequence[str], violated: Sequence[str]) -> None:
    text = f"violates {', '.join(violated)}" if violated else "violates nothing"
    print_lines([f"  {' + '.join(faults) or 'none'}: {text}"])


def _result_lines(reduction: Reduction, budget: int) -> list[str]:
    runs = f"{reduction.runs} of {budget} runs"
    if reduction.missing:
        runs += f", of which {reduction.missing} failed and say nothing"
    if reduction.reproduced is None:
        return [f"the budget ended before it was known whether it comes up again ({runs})"]
    if not reduction.reproduced:
        return [f"not reproduced: the same faults do not violate it again ({runs})"]
    faults = " + ".join(reduction.faults)
    violated = ", ".join(reduction.violated)
    if not reduction.faults:
        return [f"no fault is needed: it violates {violated} without any ({runs})"]
    if reduction.smallest:
        sure = "every smaller set was tried"
    elif reduction.one_minimal:
        sure = "none of them can be left out; smaller sets of others were not all tried"
    elif reduction.missing:
        sure = "it is not known whether one can be left out"
    else:
        sure = "the budget ended before it was known whether one can be left out"
    return [f"smallest set that violates {violated}: {faults} ({sure}; {runs})"]


def _write_reduced(
    record: SessionRecord, recorded: RecordedEpisode, reduction: Reduction, folder: Path
) -> None:
    """Write a record of the reduced episode alone, in the form of the original one."""
    from pytest_dura.evidence.bundle import write_record
    from pytest_dura.evidence.conclude import conclude
    from pytest_dura.evidence.episode_model import EpisodeEntry
    from pytest_dura.evidence.episodes import episode_record
    from pytest_dura.evidence.files import MANIFEST_FILE, file_entry, manifest_text, write_file
    from pytest_dura.evidence.model import SessionRecord

    episode = reduction.episode
    assert episode is not None
    key = recorded.spec.case, recorded.spec.component
    (original,) = [case for case in record.head.cases if (case.id, case.component) == key]
    faults = [fault.plain() for fault in episode.spec.faults]
    case = original.replace(id=episode.spec.case, planned=1, faults=faults)
    entry = EpisodeEntry.from_data(episode_record(episode, planned=True))
    head = record.head.replace(
        cases=[case],
        measures=episode.described_measures,
        judgements=[],
        waivers={},
        doubts=[],
        searches=[],
        monitors=[],
        baseline=None,
    )
    file = write_record(folder, conclude(SessionRecord(head, folder, lambda: iter([entry]))))
    write_file(folder / MANIFEST_FILE, [manifest_text({file.name: file_entry(file)})])
