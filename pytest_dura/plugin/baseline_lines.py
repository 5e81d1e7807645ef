"""What the terminal shows of a baseline."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pytest_dura.evidence.text import name, one_line
from pytest_dura.plugin.tables import WIDTH, Data, counted

if TYPE_CHECKING:
    from pytest_dura.evidence.baseline.file import Baseline
    from pytest_dura.evidence.record.session_record import SessionRecord

NO_EVIDENCE = "no evidence of a change"
COLOURS: Mapping[str, dict[str, bool]] = {"worse": {"red": True}, "better": {"green": True}}
LEGEND = (
    "now, then: violations of valid runs; p: exact one-sided p-value in the direction of the",
    "change; Holm: p corrected for the number of comparisons, on which the word rests (p alone, at",
    "a confidence of 0.95, calls an unchanged rate worse in up to 5 % of all comparisons);",
    "McNemar: on equal seeds; (worse), (better): without the correction only; -: no evidence of a",
    "change, which is no evidence that nothing changed",
)


def baseline_header(baseline: Baseline | None) -> list[str]:
    """That a baseline is compared, and which."""
    if baseline is None:
        return []
    names = sorted({claim.component for claim in baseline.claims})
    which = ", ".join([*names, baseline.created])
    lines = [f"dura: compared with the baseline {baseline.path} ({which})"]
    if baseline.status != "complete":
        lines.append(f"dura: warning: the baseline's session was {baseline.status}")
    return lines


def show_baseline(terminal: Any, record: SessionRecord) -> None:
    """What was violated now or then with its figures, the rest by name, and what they come to."""
    baseline = record["baseline"]
    if baseline is None:
        return
    found = baseline["comparisons"]
    terminal.line("")
    terminal.line(f"baseline {baseline['path']}: {_summary(baseline)}")
    shown = [one for one in found if one["test"] is None or _violated(one)]
    rows = [one for word in (*COLOURS, NO_EVIDENCE) for one in shown if one["word"] == word]
    if rows:
        table = [HEAD, *map(_row, rows)]
        widths = [max(len(row[i]) for row in table) for i in range(len(HEAD))]
        for row, one in zip(table, [None, *rows], strict=True):
            cells = "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True))
            about = "requirement and case" if one is None else _name(one)
            fits = len(cells) + 2 + len(about) <= WIDTH
            lines = [f"{cells}  {about}"] if fits else [cells, f"{'':<{widths[0] + 2}}{about}"]
            for line in lines:
                terminal.line(line, **({} if one is None else COLOURS.get(one["word"], {})))
        for line in LEGEND:
            terminal.line(line)
    for reason, alike in _the_rest(found).items():
        text = f"{one_line(reason)}: {_names(alike)}"
        for line in textwrap.wrap(text, WIDTH, subsequent_indent="  ", break_on_hyphens=False):
            terminal.line(line)


HEAD = ("", "now", "then", "p", "Holm", "test")


def _row(one: Data) -> Sequence[str]:
    direction = "worse" if one["p_worse"] <= one["p_better"] else "better"
    word = one["word"]
    if word == NO_EVIDENCE:
        word = "-" if one["uncorrected"] == NO_EVIDENCE else f"({one['uncorrected']})"
    return (
        word,
        f"{one['violations']}/{one['episodes']}",
        f"{one['baseline_violations']}/{one['baseline_episodes']}",
        f"{one[f'p_{direction}']:.2g}",
        f"{one[f'p_{direction}_holm']:.2g}",
        one["test"],
    )


def _name(one: Data) -> str:
    return f"{name(one['requirement'])} on {name(one['case'])}"


def _summary(baseline: Data) -> str:
    words = [one["word"] for one in baseline["comparisons"]]
    compared = sum(one["test"] is not None for one in baseline["comparisons"])
    parts = [counted(compared, "comparison")]
    parts += [f"{words.count(word)} {word}" for word in ("worse", "better")]
    if baseline["tests"] != compared:
        parts.append(f"corrected for {baseline['tests']}")
    return ", ".join(parts)


def _violated(one: Data) -> bool:
    return bool(one["violations"] or one["baseline_violations"])


def _the_rest(found: Sequence[Data]) -> dict[str, list[Data]]:
    """What never was violated, stands in one record only, or cannot be compared, by reason."""
    alike: dict[str, list[Data]] = {}
    for one in found:
        if one["test"] is None:
            reason = f"{one['word']}: {one['reason']}" if one["reason"] else one["word"]
        elif not _violated(one):
            runs = f"0/{one['episodes']} now, 0/{one['baseline_episodes']} then"
            reason = f"{one['word']}, violated in {runs}"
        else:
            continue
        alike.setdefault(reason, []).append(one)
    return alike


def _names(found: Sequence[Data]) -> str:
    """The requirements, by case."""
    cases: dict[str, list[str]] = {}
    for one in found:
        cases.setdefault(one["case"], []).append(one["requirement"])
    return "; ".join(
        f"{', '.join(map(name, names))} on {name(case)}" for case, names in cases.items()
    )
