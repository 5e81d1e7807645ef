"""``--dura-list``: what is known, and what would run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pytest_dura.plugin.messages import say

if TYPE_CHECKING:
    from pytest_dura.plugin.session import DuraSession


def _fault(name: str) -> str:
    """A type of the catalogue, what it acts on, and what it does in one sentence."""
    from pytest_dura.faults.catalogue import fault_class

    kind = fault_class(name)
    first = (kind.__doc__ or "").partition("\n")[0]
    return f"  {name} ({kind.acts_on}): {first}"


def show_list(session: DuraSession) -> int:
    """Print everything and return the exit code."""
    from pytest_dura.campaign.domains import DOMAINS
    from pytest_dura.campaign.reasons import describe_check
    from pytest_dura.faults.catalogue import FAULT_TYPES

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
    lines += map(_fault, sorted(FAULT_TYPES))
    lines += ["", "requirements"]
    for name, requirement in library.requirements.items():
        lines.append(f"  {name} ({requirement.kind}): {requirement.text}")
        lines += [f"      {line}" for line in describe_check(requirement)]
    for alias, domain in DOMAINS.items():
        lines += ["", f"roles of the domain {alias} (override the fixture of that name)"]
        lines += [f"  {role}: {path}" for role, path in domain.roles.items()]
        for role, names in domain.short_names.items():
            use = "--dura-generator" if role == "generator" else "`roles` in a scenario"
            lines += ["", f"short names of {role} in the domain {alias} (for {use})"]
            lines += [f"  {name}: {path}" for name, path in names.items()]
    lines += ["", f"would run with --dura-scenarios, base seed {options.seed}"]
    episodes = 0
    for planned in session.plan:
        number = options.runs or planned.case.scenario.planned
        episodes += number
        lines += [f"  {planned.case.id}::{name}" for name in planned.requirements]
        lines.append(f"      {number} episodes")
    items = sum(len(planned.requirements) for planned in session.plan)
    lines.append(f"{items} items, {len(session.plan)} cases, {episodes} episodes")
    lines += [f"warning: {one}" for one in library.warnings]
    lines += [
        f"warning: {place}: no scenario uses the requirement {name!r}"
        for name, place in library.unused.items()
    ]
    say(lines)
    return 0
