"""Reference of what domains declare; ``python -m pytest_dura.library.domain_reference`` writes it.

With names of domains, such as ``... domain_reference lift``, it prints their page instead.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

from pytest_dura.core.metrics import COMMAND
from pytest_dura.domains import DOMAINS, Action, Domain
from pytest_dura.faults.model import Channel

PAGE = "channels.md"


class Declared(NamedTuple):
    """A table of what a domain declares.

    Args:
        title: What it lists.
        columns: Heads of the columns.
        rows: Cells, the name first.
    """

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def declared(domain: Domain) -> list[Declared]:
    """Tabulate the channels, signals, actions, fault targets and measures of a domain.

    Tables without rows are left out.

    Raises:
        ConfigurationError: If the simulator of the domain cannot be imported.
    """
    channels = {name: each for name, each in (domain.channels or {}).items() if name != COMMAND}
    signals = [
        (f"{prefix}{signal.name}", f"[{signal.unit}]", signal.meaning)
        for prefix, declared_signals in (
            ("", domain.signals),
            ("percept.", domain.percept_signals),
            ("proposal.", domain.proposal_signals),
        )
        for signal in declared_signals or ()
    ]
    tables = [
        Declared(
            "channels",
            ("channel", "holds", "numbers", "frame", "meaning"),
            [_channel(domain, name, channel) for name, channel in channels.items()],
        ),
        Declared("signals", ("signal", "unit", "meaning"), signals),
        Declared(
            "actions", ("action", "unit", "range", "meaning"), list(map(_action, domain.actions))
        ),
        Declared(
            "fault targets",
            ("a fault that acts on", "acts by default on"),
            list(domain.fault_targets.items()),
        ),
        Declared(
            "measures",
            ("measure", "shown as", "unit", "meaning"),
            [(each.name, each.shown, each.unit, each.meaning) for each in domain.measures],
        ),
    ]
    return [table for table in tables if table.rows]


def _channel(domain: Domain, name: str, channel: Channel) -> tuple[str, ...]:
    parts = channel.fields or tuple(f"column {place}" for place in range(channel.columns))
    numbers = [
        (f"{part} [{unit}]" if unit else part)
        + (f" {ends[0]:g} to {ends[1]:g}" if ends else "")
        + (f", typical error {error:g}" if error else "")
        for part, unit, ends, error in zip_longest(
            parts, channel.units, channel.ranges, channel.errors
        )
    ]
    aliases = [alias for alias, own in domain.channel_aliases.items() if own == name]
    meaning = "; ".join(filter(None, (channel.meaning, *map("alias: {}".format, aliases))))
    return name, channel.kind, ", ".join(numbers), channel.frame, meaning


def _action(action: Action) -> tuple[str, ...]:
    ends = ["" if end is None else f"{end:g}" for end in (action.least, action.greatest)]
    span = f"{ends[0] or 'any'} to {ends[1] or 'any'}" if any(ends) else "any"
    return f"{COMMAND}.{action.name}", f"[{action.unit}]", span, action.meaning


def reference_page(names: Sequence[str]) -> str:
    """Render the page of these domains in Markdown; equal domains give equal texts.

    Raises:
        ConfigurationError: For an unknown domain.
    """
    lines = [
        "# Channels and signals",
        "",
        "<!-- Written by `python -m pytest_dura.library.domain_reference`; do not edit. -->",
        "",
        "What each domain declares. Sensors report **channels**, on which faults act; requirements",
        "read **signals**: the truth by their name, the percept with the prefix `percept.`, what a",
        "component says of its proposals with `proposal.`. `pytest --dura-list` shows the same of",
        "every registered domain.",
    ]
    for name in names:
        tables = [*_tables(DOMAINS[name])]
        lines += ["", f"## {name}", *tables] if tables else []
    return "\n".join([*lines, ""])


def _tables(domain: Domain) -> Iterator[str]:
    for table in declared(domain):
        yield from ("", f"### {table.title.capitalize()} of {domain.name}", "")
        yield _row(table.columns)
        yield "|" + "---|" * len(table.columns)
        for first, *rest in table.rows:
            yield _row((f"`{first}`", *rest))


def _row(cells: Sequence[str]) -> str:
    plain = (" ".join(cell.split()).replace("|", "\\|") for cell in cells)
    return "| " + " | ".join(plain) + " |"


def builtin_domains() -> list[str]:
    """List the domains that this package itself registers."""
    return [name for name in DOMAINS if DOMAINS.is_ours(name)]


if __name__ == "__main__":
    if sys.argv[1:]:
        sys.stdout.write(reference_page(sys.argv[1:]))
    else:
        _page = Path(__file__).resolve().parents[2] / "docs" / PAGE
        _page.write_text(reference_page(builtin_domains()), "utf-8")
