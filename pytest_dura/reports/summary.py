"""``summary.md``: the session on one page of GitHub-flavoured Markdown, for the page of a CI job.

GitHub takes at most 1024 KiB. Each table has its share of that and begins with what failed;
what does not fit is left out, and a sentence says how much. No text of a user is a link, a
mention, HTML or the end of a cell.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, groupby
from typing import Any

from pytest_dura.evidence.gate import OBJECTIONABLE_OUTCOMES, outcome_status
from pytest_dura.evidence.model import Counts, SessionRecord, components_under_test
from pytest_dura.evidence.text import code, markdown, name
from pytest_dura.reports.tables import (
    NULL_NOTE,
    decision_age_lines,
    decision_time_lines,
    failure_mode_text,
    failure_modes_by_component,
    outcome_headline,
    parameter_changes,
    percent_text,
    search_coverage_text,
)
from pytest_dura.reports.wording import (
    UNREVIEWED,
    assertion_sentences,
    conclusion_sentences,
    evidence_option,
    limitation_sentences,
    merge_text,
    model_options,
    rate_bound,
    replay_command,
    sample_text,
    selection_text,
    shard_text,
)


def _model_lines(models: Sequence[Mapping[str, Any]], most: int) -> Iterator[str]:
    """A line for each entry of the record's key ``models``.

    Args:
        models: The entries.
        most: So many of them; a last line tells how many are left out.
    """
    yield from map(_model_line, models[:most])
    if len(models) > most:
        yield f"- and {len(models) - most} more language models"


def _model_line(item: Mapping[str, Any]) -> str:
    can = item["capabilities"] or {}
    level = _name(str(can.get("structured", "unknown")))
    kept = "enforced" if can.get("enforced") else "not enforced"
    about = f" ({_name(item['about'])})" if item["about"] else ""
    text = (
        f"- language model of {_name(item['component'])}: {_name(item['model'])}{about} at "
        f"{_name(item['base_url'])}, {item['mode']}, structured output {level} ({kept}), "
        f"fingerprint {_name(item['fingerprint'])}; {item['asked']} answers from the server, "
        f"{item['reused']} from the cassette, {item['injected']} injected faults, "
        f"{item['missed']} missed"
    )
    tape = item["cassette"]
    if tape is None:
        return text
    return f"{text}; cassette {_name(tape['file'])}, SHA-256 {_name(tape['sha256'])}"


def _name(text: str | None) -> str:
    return code(name(text or "")) or "-"


def _provenance_lines(record: SessionRecord, most: int) -> Iterator[str]:
    """The section, with at most so many components and models of each kind."""
    git, tool, told = record["environment"]["git"] or {}, record["tool"], record["environment"]
    commit = _name(git.get("commit")) + (" with local changes" if git.get("dirty") else "")
    yield from ["", "## Provenance", ""]
    for episode in components_under_test(record)[:most]:
        version = f", version {_name(str(episode['version']))}" if episode.get("version") else ""
        digest = f", SHA-256 {_name(episode['digest'])}" if episode.get("digest") else ", no digest"
        yield f"- component under test: {_name(episode['name'])}{version}{digest}"
    yield from _model_lines(record["models"], most)
    yield from [f"- merged from {shards}"] if (shards := merge_text(record)) else []
    yield f"- commit: {commit}"
    yield f"- tool: {_name(tool['name'])} {_name(tool['version'])}"
    yield f"- Python {_name(told['python'])} on {_name(told['platform'])}"
    yield f"- base seed: {record['base_seed']}"
    yield f"- created {_name(record['created'])}, finished {_name(record['finished'])}"
    yield f"- command: {code(record['command'], 1000) or '-'}"
    yield f"- {UNREVIEWED}"


Data = Mapping[str, Any]

_SEARCH_COLUMNS = ["search", "waiver", "requirement", "case", "component", "simulations",
           "robustness",
           "found by", "trivial baselines alone", "counterexample"]  # fmt: skip
MOST_CHANGES = 6
_OUTCOME_RANK = {
    objectionable_outcome: rank for rank, objectionable_outcome in enumerate(OBJECTIONABLE_OUTCOMES)
}


def _search_rows(record: SessionRecord) -> Iterator[str]:
    """Rows of a table with :data:`COLUMNS`."""
    for search, outcome in _ordered_outcomes(record):
        yield f"| {' | '.join(_search_cells(search, outcome))} |"


def _search_failures(record: SessionRecord) -> Iterator[str]:
    """A line for each outcome that the gate does not accept, or that is waived."""
    for search, outcome in _ordered_outcomes(record):
        if outcome_status(search, outcome) in OBJECTIONABLE_OUTCOMES:
            waiver = ""
            if search["waiver"] is not None:
                kind, why = (markdown(search["waiver"][key], 200) for key in ("kind", "reason"))
                waiver = f" (waived, {kind}: {why or 'no reason'})"
            yield (
                f"- **search: {code(name(outcome['requirement']))}** on "
                f"{code(name(search['case']))}, component {code(name(search['component']))}"
                f"{waiver}: {markdown(outcome_headline(search, outcome), 400)}"
            )


def _ordered_outcomes(record: SessionRecord) -> list[tuple[Data, Data]]:
    """Searches with their outcomes, the worst first."""
    found = [(search, outcome) for search in record["searches"] for outcome in search["outcomes"]]
    return sorted(
        found, key=lambda pair: _OUTCOME_RANK.get(outcome_status(*pair), len(_OUTCOME_RANK))
    )


def _search_cells(search: Data, outcome: Data) -> Iterator[str]:
    status = outcome_status(search, outcome)
    yield "violated by a baseline" if status == "baseline" else status
    yield "-" if search["waiver"] is None else "waived"
    for text in (outcome["requirement"], search["case"], search["component"]):
        yield code(name(text)) or "-"
    yield f"{outcome['simulations']} of {search['budget']}"
    yield "-" if outcome["best"] is None else f"{outcome['best']:.4g}"
    yield "-" if outcome["searcher"] is None else markdown(outcome["searcher"], 100)
    yield _baseline_cell(search, outcome["requirement"])
    yield _search_counterexample(search, outcome["counterexample"])


def _baseline_cell(search: Data, requirement: str) -> str:
    """Where each trivial baseline met a violation by itself."""
    told = []
    for baseline in search["baselines"]:
        first = baseline["first"].get(requirement)
        end = f"none in {baseline['simulations']}" if first is None else f"at {first}"
        told.append(f"{markdown(baseline['name'], 100)} {end}")
    return "; ".join(told) or "none was run"


def _search_counterexample(search: Data, found: Data | None) -> str:
    """What it takes, and the file that keeps it; or how much was covered without one."""
    if found is None:
        return f"coverage {search_coverage_text(search)}"
    told = [
        f"{code(path)} {markdown(how, 100)}" for path, how in parameter_changes(found, MOST_CHANGES)
    ]
    more = len(found["changes"]) - len(told)
    text = ", ".join(told) or "the case as it stands"
    text += f" and {more} more" if more > 0 else ""
    return text if found["file"] is None else f"{text}; kept in {code(found['file'])}"


FILE = "summary.md"
MAX_BYTES = 1024 * 1024
"""Bytes that GitHub takes."""

JsonObject = dict[str, Any]
_KIB = 1024
_SHARES = {"failures": 300 * _KIB, "verdicts": 320 * _KIB, "requirements": 100 * _KIB,
           "cases": 150 * _KIB, "failure modes": 30 * _KIB, "searches": 40 * _KIB}  # fmt: skip
"""Bytes of the tables; the rest is for what has a small bound: the head, reasons, provenance."""
_REASONS = 20
_MAX_CELLS = 10
_VERDICT_ORDER = ("violated", "undecided", "supported")
_LEFT_OUT = re.compile(r"^_(\d+) of (\d+) are left out here", re.MULTILINE)


def render(record: SessionRecord) -> str:
    """The page as text, of at most ``MAX_BYTES`` bytes in UTF-8."""
    verdicts = sorted(record["verdicts"], key=_urgency)
    found = _search_failures(record)
    failures = [verdict for verdict in verdicts if verdict["verdict"] != "supported"]
    lines = [
        *_head_lines(record),
        *_conclusion_lines(record),
        *_section("Not supported", [], chain(_failure_lines(record, failures), found), "failures"),
        *(
            _section("Searches", _SEARCH_COLUMNS, _search_rows(record), "searches")
            if record["searches"]
            else ()
        ),
        *_section("Verdicts", _VERDICT_COLUMNS, map(_verdict_row, verdicts), "verdicts"),
        *_section("Requirements", _REQUIREMENT_COLUMNS, _requirement_rows(record), "requirements"),
        *_section("Cases", _CASE_COLUMNS, map(_case_row, record["cases"]), "cases"),
        *_overall_lines(record),
        *_failure_mode_section(record),
        *_coverage_lines(record),
        *_provenance_lines(record, _MAX_CELLS),
    ]
    return "\n".join(lines) + "\n"


def read_counts(text: str) -> Counts:
    """What the page states: counted in the rows of its tables where none is left out.

    Raises:
        ValueError: If the text is no such page, or its rows are not what it states.
    """
    stated = _read_totals(text)
    for heading, count in (
        ("Requirements", _read_rows),
        ("Cases", _read_rows),
        ("Verdicts", _read_verdicts),
    ):
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


def _read_totals(text: str) -> JsonObject:
    """The table of totals."""
    keys = list(Counts.__dataclass_fields__)
    header = f"| {' | '.join(keys)} |\n|{' --- |' * len(keys)}\n| "
    row = text.partition(header)[2].partition(" |\n")[0].split(" | ")
    if len(row) != len(keys):
        raise ValueError("the page has no table of totals")
    return {
        key: value if key == "gate" else int(value) for key, value in zip(keys, row, strict=True)
    }


def _read_rows(heading: str, body: str) -> JsonObject:
    # The first two rows are the header and its rule.
    return {heading.lower(): sum(line.startswith("| ") for line in body.split("\n")) - 2}


def _read_verdicts(_: str, body: str) -> JsonObject:
    findall = re.findall(r"^\| (supported|violated|undecided) \| (waived|-) \|", body, re.MULTILINE)
    words = Counter(word for word, _ in findall)
    return {word: words[word] for word in _VERDICT_ORDER} | {
        "waived": [item for _, item in findall].count("waived")
    }


def _urgency(verdict: JsonObject) -> tuple[bool, int]:
    """What makes the gate fail comes first, violations before what is undecided."""
    word = verdict["verdict"]
    return word == "supported" or verdict["waiver"] is not None, _VERDICT_ORDER.index(word)


def _head_lines(record: SessionRecord) -> Iterator[str]:
    counts, gate, status = Counts.of(record).to_json(), record["gate"], record["status"]
    whole = shard_text(record)
    if status != "complete" or gate["result"] == "incomplete":
        yield f"# {whole.capitalize() or 'Session'} incomplete ({status}): this is no pass"
    elif whole:
        yield f"# Gate of {whole} {gate['result']}: a part of a session, not the whole"
    else:
        yield f"# Gate {', '.join(filter(None, [gate['result'], selection_text(record)]))}"
    yield from ["", f"| {' | '.join(counts)} |", f"|{' --- |' * len(counts)}"]
    yield f"| {' | '.join(map(str, counts.values()))} |"
    yield ""
    yield from (
        f"- {markdown(reason, 300) or 'no reason'}" for reason in gate["reasons"][:_REASONS]
    )
    if len(gate["reasons"]) > _REASONS:
        yield f"- and {len(gate['reasons']) - _REASONS} more reasons"


def _conclusion_lines(record: SessionRecord) -> Iterator[str]:
    for heading, sentences in (
        ("Shown", conclusion_sentences(record)),
        ("Not shown", limitation_sentences(record)),
    ):
        yield from [
            "",
            f"**{heading}**",
            "",
            *(f"- {markdown(sentence, 400)}" for sentence in sentences),
        ]


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


def _failure_lines(record: SessionRecord, failures: list[JsonObject]) -> Iterator[str]:
    """One row each; requirements of a case that are undecided for the same reason share one."""
    for (first, rest), same in groupby(failures, lambda failure: _failure_context(record, failure)):
        names = ", ".join(_name(verdict["requirement"]) for verdict in same)
        yield f"- **{first}: {names}{rest}"


def _failure_context(record: SessionRecord, item: JsonObject) -> tuple[str, str]:
    """What is said of a verdict before and after the name of its requirement."""
    waiver = ""
    if item["waiver"] is not None:
        kind, why = markdown(item["waiver"]["kind"], 64), markdown(item["waiver"]["reason"], 200)
        waiver = f" (waived, {kind}: {why or 'no reason'})"
    text = (
        f" on {_name(item['case'])}, "
        f"component {_name(item['component'])}: {markdown(item['reason'], 400) or 'no reason'}. "
        f"{sample_text(item)}; {rate_bound(item)}."
    )
    for line in assertion_sentences(item):
        text += f"\n  - {markdown(line, 600)}"
    if item["counterexamples"]:
        text += "\n  - " + _counterexample(record, item["counterexamples"])
    return f"{item['verdict']}**{waiver}", text


def _counterexample(record: SessionRecord, objects: list[JsonObject]) -> str:
    first = objects[0]
    text = f"counterexample {_name(first['episode'])}"
    if first["time"] is not None:
        text += f" at {first['time']:.1f} s"
    if first["margin"] is not None:
        text += f", margin {first['margin']:.3g}"
    if len(objects) > 1:
        text += f", and {len(objects) - 1} more"
    command = _replay(record["command"], first["episode"])
    return text + (f"; replay: {command}" if command else "; replay by its id in the record")


def _replay(session: str, episode: str) -> str:
    """The command, where it can be shown as it has to be typed."""
    command = replay_command(episode, evidence_option(session), model_options(session))
    unchanged = name(command, 400) == command and "\\|" not in command and "  " not in command
    return code(command) if unchanged else ""


_VERDICT_COLUMNS = ["verdict", "waiver", "requirement", "case", "component", "valid n",
             "violations",
             "open", "without effect", "invalid", "missing", "upper bound"]  # fmt: skip
_REQUIREMENT_COLUMNS = [
    "requirement",
    "kind",
    "text",
    "supported",
    "violated",
    "undecided",
    "untested",
]
_CASE_COLUMNS = ["case", "component", "planned", "run", "valid", "invalid", "missing", "flagged",
          "collided", "gridlock", "clearance time", "rescued", "comfort failed",
          "reactions"]  # fmt: skip
_FAILURE_MODE_COLUMNS = [
    "failure mode",
    "kind",
    "component",
    "decisions",
    "share %",
    "null %",
    "episodes",
]


def _table_row(cells: Iterable[object]) -> str:
    return f"| {' | '.join(str(cell) for cell in cells)} |"


def _verdict_row(item: JsonObject) -> str:
    counts = [item["episodes"], item["violations"], len(item["open"])]
    counts += [item[key] for key in ("without_effect", "invalid", "missing")]
    waiver = "-" if item["waiver"] is None else "waived"
    names = (_name(item[key]) for key in ("requirement", "case", "component"))
    return _table_row([item["verdict"], waiver, *names, *counts, rate_bound(item)])


def _requirement_rows(record: SessionRecord) -> Iterator[str]:
    words = Counter((verdict["requirement"], verdict["verdict"]) for verdict in record["verdicts"])
    cells = record["coverage"]["cells"]
    untested = Counter(cell["requirement"] for cell in cells if cell["verdict"] is None)
    more = " or more" if record["coverage"]["left_out"] else ""

    def failing(item: JsonObject) -> tuple[bool, bool]:
        return not words[item["id"], "violated"], not words[item["id"], "undecided"]

    for requirement in sorted(record["requirements"], key=failing):
        counts = (words[requirement["id"], word] for word in ("supported", "violated", "undecided"))
        texts = (markdown(requirement[key] or "", 200) or "-" for key in ("kind", "text"))
        yield _table_row(
            [_name(requirement["id"]), *texts, *counts, f"{untested[requirement['id']]}{more}"]
        )


def _case_row(item: JsonObject) -> str:
    metrics = item["metrics"]
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
    names = (_name(item["id"]), _name(item["component"]))
    return _table_row([*names, *counts, *rates[:3], shown, *rates[3:], reactions or "-"])


def _overall_lines(record: SessionRecord) -> Iterator[str]:
    """All cases of each component together, and what the runs show of recovery and monitors.

    No rows of a table: the rows of cases are counted.
    """
    for item in record["overall"]:
        metrics = item["metrics"]
        counts = [
            f"{metrics[key]['valid']} {key.replace('_', ' ')}"
            for key in ("flagged", "collided", "gridlock", "rescued", "comfort_failed")
            if metrics[key] is not None
        ]
        runs = f"{metrics['valid']} valid of {metrics['planned']} planned runs"
        whose = f"all {item['cases']} cases of {_name(item['component'])}"
        yield from ["", f"- {whose}: {', '.join([runs, *counts])}"]
    effectiveness = record["effectiveness"]
    if effectiveness:
        yield ""
    for item in effectiveness[:_MAX_CELLS]:
        whose = f"{_name(item['role'])} with {_name(item['component'])}"
        yield f"- {whose}: {markdown(item['detail'], 400)}"
    if len(effectiveness) > _MAX_CELLS:
        yield f"- and {len(effectiveness) - _MAX_CELLS} more in the report"


def _failure_mode_section(record: SessionRecord) -> Iterator[str]:
    """Over all cases; nothing where no component gave accounts."""
    cases = record["cases"]
    rows = [
        _table_row([
            _name(failure_mode_text(mode["name"])), mode["kind"], _name(component),
            f"{mode['hits']} of {mode['of']}", percent_text(mode["share"]),
            percent_text(mode["null_share"]),
            f"{mode['episodes']} of {mode['of_episodes']}",
        ])
        for component, modes in failure_modes_by_component(cases).items()
        for mode in modes
    ]  # fmt: skip
    if rows:
        yield from _section("Failure modes", _FAILURE_MODE_COLUMNS, rows, "failure modes")
        yield from [
            "",
            *(f"- answers of {_name(whose)}: {text}" for whose, text in decision_time_lines(cases)),
        ]
        for whose, text in decision_age_lines(cases):
            yield f"- decisions of {_name(whose)} came into force at an age of {text}"
        yield f"- {NULL_NOTE}"


def _coverage_lines(record: SessionRecord) -> Iterator[str]:
    cells, left_out = record["coverage"]["cells"], record["coverage"]["left_out"]
    untested = [cell for cell in cells if cell["verdict"] is None]
    yield from ["", "## Coverage", ""]
    yield (
        f"{len(cells) - len(untested)} of {len(cells) + left_out} cells of requirement x scenario "
        f"x fault have a verdict; {len(untested) + left_out} untested."
    )
    for verdict in untested[:_MAX_CELLS]:
        yield f"- untested: {_name(verdict['requirement'])} on {_name(verdict['case'])}"
    if len(untested) + left_out > _MAX_CELLS:
        yield f"- and {len(untested[_MAX_CELLS:]) + left_out} more"
