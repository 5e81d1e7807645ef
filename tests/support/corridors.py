"""Scenarios and expectations for the example project of the plugin's tests, a corridor."""

from __future__ import annotations

import re

SCENARIO = """
name: corridor/{name}
simulator: {simulator}
duration: {duration}
runs: {runs}
time_budget: 30.0
world: {world}
variation: {variation}
roles: {roles}
faults: {faults}
requirements: {requirements}
"""

# The budget is what no machine exceeds: a test of overruns gives `--dura-time-budget`.

IDLE = "[{type: ghost-obstacle, activation: {at: 0.1}}]"
"""A planned fault; the corridor has no lidar, and the injector `Idle` never activates it."""


def path(name):
    return name if ":" in name else f"corridor:{name}"


def scenario(
    project,
    name="it",
    *,
    simulator="Corridor",
    duration=0.5,
    runs=2,
    world="{}",
    variation="{}",
    generator="Careful",
    monitor="Watch",
    faults="[]",
    requirements="[GAP-1, GO-1]",
    **roles,
):
    """Write `corridor/<name>` into the project; roles are classes of its module `corridor`."""
    named = {"generator": generator, "safety_monitor": monitor, **roles}
    text = SCENARIO.format(
        name=name,
        simulator=path(simulator),
        duration=duration,
        runs=runs,
        world=world,
        variation=variation,
        roles="{" + ", ".join(f'{role}: "{path(one)}"' for role, one in named.items()) + "}",
        faults=faults,
        requirements=requirements,
    )
    project.write(f"scenarios/corridor/{name}.yaml", text)


def requirement(project, check, name="R-1", **keys):
    """Write a requirement file of its own for one requirement."""
    entry = {"id": name, "text": "As it should be.", "kind": "safety", "check": f'"{check}"'}
    entry = {key: value for key, value in (entry | keys).items() if value is not None}
    inner = ", ".join(f"{key}: {value}" for key, value in entry.items())
    project.write(f"scenarios/requirements_{name}.yaml", f"requirements:\n  - {{{inner}}}\n")


def expect(project, result, word, reason="", *, ret=None, requirement="R-1", case="corridor/it"):
    """The same word in the terminal and in the evidence, and the exit code; the verdict."""
    found = project.verdict(requirement, case)
    assert found.verdict == word
    assert reason in found.reason
    lines = result.outlines
    start = next(i for i, line in enumerate(lines) if re.fullmatch(r"=+ dura =+", line))
    told = "\n".join(lines[start:])
    assert re.search(rf"^gate.*: .*\d {word}\b", told, re.MULTILINE)
    if word != "supported":
        card = rf"^{word}: \w+ on {re.escape(case)}(?: and \d+ more cases?)? \(.*\)\n(?:  .*\n)*"
        # A line of its own, or in the list of those that have the same reason.
        row = rf"^  (?:and: .*)?\b{re.escape(requirement)}:"
        assert re.search(row, re.search(card, told, re.MULTILINE)[0], re.MULTILINE)
    assert result.ret == ((0 if word == "supported" else 1) if ret is None else ret)
    text = result.stdout.str() + result.stderr.str()
    assert "Traceback" not in text
    assert "INTERNALERROR" not in text
    return found
