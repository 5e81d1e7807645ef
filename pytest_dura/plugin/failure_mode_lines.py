"""What the terminal shows of failure modes: those that a component's own accounts show."""

from __future__ import annotations

from collections.abc import Sequence

from pytest_dura.evidence.views.failure_modes import (
    HEADINGS,
    ages,
    answers,
    by_kind,
    in_words,
    percent,
    summed,
    told,
)
from pytest_dura.plugin.tables import Data, aligned

COLUMNS = ("decisions", "share %", "null %", "episodes")
LEGEND = (
    "decisions: those that showed it, of those that could; episodes: those in which it ever did;",
    "null: a component that ignores its input, on the same decisions: what it also reaches says",
    "nothing about the model",
)


def failure_mode_table(cases: Sequence[Data], *, by_case: bool = False) -> list[str]:
    """One line per failure mode and component, over all cases, and with ``by_case`` for each too.

    The negative control, and what is no failure by itself, stand apart below.
    """
    found = summed(cases)
    several = len(found) > 1
    lines = []
    for component, modes in found.items():
        lines += _table(modes, f" of {component}" if several else "")
    for component, text in answers(cases):
        lines.append(f"answers{f' of {component}' if several else ''}: {text}")
    for component, text in ages(cases):
        whose = f" of {component}" if several else ""
        lines.append(f"decisions{whose} came into force at an age of {text}")
    for case in told(cases) if by_case else ():
        whose = f" of {case['component']}" if several else ""
        lines += [
            "",
            *_table(by_kind(case["metrics"]["failure_modes"]), f" on {case['id']}{whose}"),
        ]
    return [*lines, *LEGEND] if lines else []


def _table(modes: Sequence[Data], whose: str) -> list[str]:
    names, rows, kind = [], [], ""
    for one in modes:
        if one["kind"] != kind:
            kind = one["kind"]
            if kind != "failure":
                names.append(f"{HEADINGS[kind]}:")
                rows.append([""] * len(COLUMNS))
        names.append(in_words(one["name"]))
        rows.append(_row(one))
    return [line.rstrip() for line in aligned(HEADINGS["failure"] + whose, COLUMNS, names, rows)]


def _row(one: Data) -> list[str]:
    return [
        f"{one['hits']}/{one['of']}",
        percent(one["share"]),
        percent(one["null_share"]),
        f"{one['episodes']}/{one['of_episodes']}",
    ]
