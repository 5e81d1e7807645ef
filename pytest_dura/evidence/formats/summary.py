"""``summary.md``: the session on one page of GitHub-flavoured Markdown, for the page of a CI job.

GitHub takes at most 1024 KiB. Each table has its share of that and begins with what failed; what
does not fit is left out, and a sentence says how much. No text of a user is a link, a mention,
HTML or the end of a cell.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import chain, groupby
from typing import Any

from pytest_dura.evidence.formats.in_words import not_shown, shown
from pytest_dura.evidence.formats.provenance_lines import provenance_lines
from pytest_dura.evidence.formats.search_rows import COLUMNS as _SEARCHES
from pytest_dura.evidence.formats.search_rows import search_failures, search_rows
from pytest_dura.evidence.formats.stated import bound, by_assertion, part, sample, selected
from pytest_dura.evidence.record.counts import Counts
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.evidence.text import code, markdown, name
from pytest_dura.evidence.views.failure_modes import NULL, ages, answers, in_words, percent, summed
from pytest_dura.evidence.views.replay_command import evidence_option, model_options, replay_command

FILE = "summary.md"
LIMIT = 1024 * 1024
"""Bytes that GitHub takes."""

Data = dict[str, Any]
_KIB = 1024
_SHARES = {"failures": 300 * _KIB, "verdicts": 320 * _KIB, "requirements": 100 * _KIB,
           "cases": 150 * _KIB, "failure modes": 30 * _KIB, "searches": 40 * _KIB}  # fmt: skip
"""Bytes of the tables; the rest is for what has a small bound: the head, reasons, provenance."""
_REASONS = 20
_CELLS = 10
_WORDS = ("violated", "undecided", "supported")
_LEFT_OUT = re.compile(r"^_(\d+) of (\d+) are left out here", re.MULTILINE)


def render(record: SessionRecord) -> str:
    """The page as text, of at most ``LIMIT`` bytes in UTF-8."""
    verdicts = sorted(record["verdicts"], key=_urgency)
    found = search_failures(record)
    failures = [one for one in verdicts if one["verdict"] != "supported"]
    lines = [
        *_head(record),
        *_in_words(record),
        *_section("Not supported", [], chain(_failures(record, failures), found), "failures"),
        *(
            _section("Searches", _SEARCHES, search_rows(record), "searches")
            if record["searches"]
            else ()
        ),
        *_section("Verdicts", _VERDICTS, map(_verdict, verdicts), "verdicts"),
        *_section("Requirements", _REQUIREMENTS, _requirements(record), "requirements"),
        *_section("Cases", _CASES, map(_case, record["cases"]), "cases"),
        *_overall(record),
        *_failure_modes(record),
        *_coverage(record),
        *provenance_lines(record, _CELLS),
    ]
    return "\n".join(lines) + "\n"


def read_counts(text: str) -> Counts:
    """What the page states: counted in the rows of its tables where none is left out.

    Raises:
        ValueError: If the text is no such page, or its rows are not what it states.
    """
    stated = _stated(text)
    for heading, count in (("Requirements", _rows), ("Cases", _rows), ("Verdicts", _words)):
        body = text.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
        if not body:
            raise ValueError(f"the page has no section {heading}")
        if not _LEFT_OUT.search(body):
            found = count(heading, body)
            differ = [key for key, number in found.items() if stated[key] != number]
            if differ:
                told = f"{differ[0]} = {stated[differ[0]]}, and lists {found[differ[0]]}"
                raise ValueError(f"the page states {told}")
            stated |= found
    return Counts.from_json(stated)


def _stated(text: str) -> Data:
    """The table of totals."""
    keys = list(Counts.__dataclass_fields__)
    header = f"| {' | '.join(keys)} |\n|{' --- |' * len(keys)}\n| "
    row = text.partition(header)[2].partition(" |\n")[0].split(" | ")
    if len(row) != len(keys):
        raise ValueError("the page has no table of totals")
    return {
        key: value if key == "gate" else int(value) for key, value in zip(keys, row, strict=True)
    }


def _rows(heading: str, body: str) -> Data:
    # The first two rows are the header and its rule.
    return {heading.lower(): sum(line.startswith("| ") for line in body.split("\n")) - 2}


def _words(_: str, body: str) -> Data:
    found = re.findall(r"^\| (supported|violated|undecided) \| (waived|-) \|", body, re.MULTILINE)
    words = Counter(word for word, _ in found)
    return {word: words[word] for word in _WORDS} | {
        "waived": [one for _, one in found].count("waived")
    }


def _urgency(verdict: Data) -> tuple[bool, int]:
    """What makes the gate fail comes first, violations before what is undecided."""
    word = verdict["verdict"]
    return word == "supported" or verdict["waiver"] is not None, _WORDS.index(word)


def _head(record: SessionRecord) -> Iterator[str]:
    counts, gate, status = Counts.of(record).to_json(), record["gate"], record["status"]
    whole = part(record)
    if status != "complete" or gate["result"] == "incomplete":
        yield f"# {whole.capitalize() or 'Session'} incomplete ({status}): this is no pass"
    elif whole:
        yield f"# Gate of {whole} {gate['result']}: a part of a session, not the whole"
    else:
        yield f"# Gate {', '.join(filter(None, [gate['result'], selected(record)]))}"
    yield from ["", f"| {' | '.join(counts)} |", f"|{' --- |' * len(counts)}"]
    yield f"| {' | '.join(map(str, counts.values()))} |"
    yield ""
    yield from (f"- {markdown(one, 300) or 'no reason'}" for one in gate["reasons"][:_REASONS])
    if len(gate["reasons"]) > _REASONS:
        yield f"- and {len(gate['reasons']) - _REASONS} more reasons"


def _in_words(record: SessionRecord) -> Iterator[str]:
    for heading, sentences in (("Shown", shown(record)), ("Not shown", not_shown(record))):
        yield from ["", f"**{heading}**", "", *(f"- {markdown(one, 400)}" for one in sentences)]


def _section(heading: str, columns: list[str], rows: Iterable[str], share: str) -> Iterator[str]:
    """A heading with as many of its rows as fit into its share."""
    yield from ["", f"## {heading}", ""]
    if columns:
        yield from [f"| {' | '.join(columns)} |", f"|{' --- |' * len(columns)}"]
    room, total, shown = _SHARES[share], 0, 0
    for row in rows:
        total += 1
        room -= len(row.encode()) + 1
        if room >= 0:
            shown += 1
            yield row
    if not total:
        yield from ["", "None."]
    if shown < total:
        yield ""
        yield (
            f"_{total - shown} of {total} are left out here, to stay below the limit of a summary; "
            "the report and evidence.json have all._"
        )


def _failures(record: SessionRecord, failures: list[Data]) -> Iterator[str]:
    """One row each; requirements of a case that are undecided for the same reason share one."""
    for (first, rest), same in groupby(failures, lambda one: _but_requirement(record, one)):
        names = ", ".join(_name(one["requirement"]) for one in same)
        yield f"- **{first}: {names}{rest}"


def _but_requirement(record: SessionRecord, one: Data) -> tuple[str, str]:
    """What is said of a verdict before and after the name of its requirement."""
    waiver = ""
    if one["waiver"] is not None:
        kind, why = markdown(one["waiver"]["kind"], 64), markdown(one["waiver"]["reason"], 200)
        waiver = f" (waived, {kind}: {why or 'no reason'})"
    told = (
        f" on {_name(one['case'])}, "
        f"component {_name(one['component'])}: {markdown(one['reason'], 400) or 'no reason'}. "
        f"{sample(one)}; {bound(one)}."
    )
    for line in by_assertion(one):
        told += f"\n  - {markdown(line, 600)}"
    if one["counterexamples"]:
        told += "\n  - " + _counterexample(record, one["counterexamples"])
    return f"{one['verdict']}**{waiver}", told


def _counterexample(record: SessionRecord, found: list[Data]) -> str:
    first = found[0]
    told = f"counterexample {_name(first['episode'])}"
    if first["time"] is not None:
        told += f" at {first['time']:.1f} s"
    if first["margin"] is not None:
        told += f", margin {first['margin']:.3g}"
    if len(found) > 1:
        told += f", and {len(found) - 1} more"
    command = _replay(record["command"], first["episode"])
    return told + (f"; replay: {command}" if command else "; replay by its id in the record")


def _replay(session: str, episode: str) -> str:
    """The command, where it can be shown as it has to be typed."""
    command = replay_command(episode, evidence_option(session), model_options(session))
    unchanged = name(command, 400) == command and "\\|" not in command and "  " not in command
    return code(command) if unchanged else ""


_VERDICTS = ["verdict", "waiver", "requirement", "case", "component", "valid n", "violations",
             "open", "without effect", "invalid", "missing", "upper bound"]  # fmt: skip
_REQUIREMENTS = ["requirement", "kind", "text", "supported", "violated", "undecided", "untested"]
_CASES = ["case", "component", "planned", "run", "valid", "invalid", "missing", "flagged",
          "collided", "gridlock", "clearance time", "rescued", "comfort failed",
          "reactions"]  # fmt: skip
_MODES = ["failure mode", "kind", "component", "decisions", "share %", "null %", "episodes"]


def _row(cells: Iterable[object]) -> str:
    return f"| {' | '.join(str(cell) for cell in cells)} |"


def _name(text: str | None) -> str:
    return code(name(text or "")) or "-"


def _verdict(one: Data) -> str:
    counts = [one["episodes"], one["violations"], len(one["open"])]
    counts += [one[key] for key in ("without_effect", "invalid", "missing")]
    waiver = "-" if one["waiver"] is None else "waived"
    names = (_name(one[key]) for key in ("requirement", "case", "component"))
    return _row([one["verdict"], waiver, *names, *counts, bound(one)])


def _requirements(record: SessionRecord) -> Iterator[str]:
    words = Counter((one["requirement"], one["verdict"]) for one in record["verdicts"])
    cells = record["coverage"]["cells"]
    untested = Counter(one["requirement"] for one in cells if one["verdict"] is None)
    more = " or more" if record["coverage"]["left_out"] else ""

    def failing(one: Data) -> tuple[bool, bool]:
        return not words[one["id"], "violated"], not words[one["id"], "undecided"]

    for one in sorted(record["requirements"], key=failing):
        counts = (words[one["id"], word] for word in ("supported", "violated", "undecided"))
        texts = (markdown(one[key] or "", 200) or "-" for key in ("kind", "text"))
        yield _row([_name(one["id"]), *texts, *counts, f"{untested[one['id']]}{more}"])


def _case(one: Data) -> str:
    metrics = one["metrics"]
    rates = []
    for key in ("flagged", "collided", "gridlock", "rescued", "comfort_failed"):
        rate = metrics[key]
        shown = "-" if rate is None else f"{rate['valid']} of {metrics['valid']}"
        beyond = 0 if rate is None else rate["run"] - rate["valid"]
        rates.append(f"{shown}, {beyond}*" if beyond else shown)
    reactions = ", ".join(f"{_name(kind)} {n}" for kind, n in metrics["reactions"].items())
    time = metrics["clearance_time"]
    shown = "-"
    if time is not None and time["mean"] is not None:
        shown = f"{time['mean']:.2f} s (n = {time['runs']})"
    counts = (metrics[key] for key in ("planned", "run", "valid", "invalid", "missing"))
    names = (_name(one["id"]), _name(one["component"]))
    return _row([*names, *counts, *rates[:3], shown, *rates[3:], reactions or "-"])


def _overall(record: SessionRecord) -> Iterator[str]:
    """All cases of each component together, and what the runs show of recovery and monitors.

    No rows of a table: the rows of cases are counted.
    """
    for one in record["overall"]:
        metrics = one["metrics"]
        counts = [
            f"{metrics[key]['valid']} {key.replace('_', ' ')}"
            for key in ("flagged", "collided", "gridlock", "rescued", "comfort_failed")
            if metrics[key] is not None
        ]
        runs = f"{metrics['valid']} valid of {metrics['planned']} planned runs"
        whose = f"all {one['cases']} cases of {_name(one['component'])}"
        yield from ["", f"- {whose}: {', '.join([runs, *counts])}"]
    found = record["effectiveness"]
    if found:
        yield ""
    for one in found[:_CELLS]:
        whose = f"{_name(one['role'])} with {_name(one['component'])}"
        yield f"- {whose}: {markdown(one['detail'], 400)}"
    if len(found) > _CELLS:
        yield f"- and {len(found) - _CELLS} more in the report"


def _failure_modes(record: SessionRecord) -> Iterator[str]:
    """Over all cases; nothing where no component gave accounts."""
    cases = record["cases"]
    rows = [
        _row([
            _name(in_words(one["name"])), one["kind"], _name(component),
            f"{one['hits']} of {one['of']}", percent(one["share"]), percent(one["null_share"]),
            f"{one['episodes']} of {one['of_episodes']}",
        ])
        for component, modes in summed(cases).items()
        for one in modes
    ]  # fmt: skip
    if rows:
        yield from _section("Failure modes", _MODES, rows, "failure modes")
        yield from ["", *(f"- answers of {_name(whose)}: {text}" for whose, text in answers(cases))]
        for whose, text in ages(cases):
            yield f"- decisions of {_name(whose)} came into force at an age of {text}"
        yield f"- {NULL}"


def _coverage(record: SessionRecord) -> Iterator[str]:
    cells, left_out = record["coverage"]["cells"], record["coverage"]["left_out"]
    untested = [one for one in cells if one["verdict"] is None]
    yield from ["", "## Coverage", ""]
    yield (
        f"{len(cells) - len(untested)} of {len(cells) + left_out} cells of requirement x scenario "
        f"x fault have a verdict; {len(untested) + left_out} untested."
    )
    for one in untested[:_CELLS]:
        yield f"- untested: {_name(one['requirement'])} on {_name(one['case'])}"
    if len(untested) + left_out > _CELLS:
        yield f"- and {len(untested[_CELLS:]) + left_out} more"
