"""Reading the report back: its counts, taken from the rows that a reader sees."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from html.parser import HTMLParser

from pytest_dura.evidence.record.counts import Counts
from pytest_dura.requirements.verdicts.campaigns import CAMPAIGN_STATUSES

GATES = ("passed", "failed", "incomplete")
_MARKS = ("gate-word", "word", "waived", "folded-supported", "folded-cases")
COUNTED = ("run", "valid", "invalid", "missing")


def read_counts(text: str) -> Counts:
    """The counts of a report, each from the rows of the table that it stands for.

    Args:
        text: The file as a text.

    Raises:
        ValueError: If it is no such report, or its rows are not as they were written.
    """
    page = _Page()
    page.feed(text)
    page.close()
    if not page.seen >= {"verdicts", "case-counts"}:
        raise ValueError("the table of verdicts or that of episodes by case is not there")
    episodes = page.episodes
    if episodes["run"] < episodes["valid"] + episodes["invalid"] + episodes["missing"]:
        raise ValueError("there are more valid, invalid and missing episodes than were run")
    return Counts(
        gate=_gate(page.gates),
        requirements=page.requirements,
        cases=page.cases,
        episodes=episodes["run"],
        valid=episodes["valid"],
        invalid=episodes["invalid"],
        missing=episodes["missing"],
        **{word: page.words[word] for word in CAMPAIGN_STATUSES},
        waived=page.waived,
    )


def _gate(found: list[str]) -> str:
    if len(set(found)) != 1 or found[0] not in GATES:
        raise ValueError(f"the gate's result is {' and '.join(found) or 'missing'}")
    return found[0]


@dataclass
class _Row:
    """A row of a table while it is read."""

    kinds: list[str]
    cells: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    waived: bool = False
    folded: int = 0
    """What the row stands for that has none."""


class _Page(HTMLParser):
    """The rows of the two tables that count, and the words for the gate."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.seen: set[str] = set()
        self.gates: list[str] = []
        self.requirements = 0
        self.cases = 0
        self.waived = 0
        self.words: Counter[str] = Counter()
        self.episodes: Counter[str] = Counter()
        self._table = ""
        self._columns: list[str] = []
        self._row: _Row | None = None
        self._text: list[str] = []
        self._marked = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        kinds = (found.get("class") or "").split()
        if tag == "table":
            self._table = found.get("id") or ""
            self.seen.add(self._table)
            self._columns = []
        elif tag == "tbody":
            self.requirements += self._table == "verdicts" and "requirement" in kinds
        elif tag == "tr":
            self._row = _Row(kinds)
        elif tag in ("td", "th"):
            self._text = []
        elif tag in ("b", "strong") and len(kinds) == 1 and kinds[0] in _MARKS:
            self._marked = kinds[0]
            self._text = []

    def handle_data(self, data: str) -> None:
        self._text.append(data)

    def handle_endtag(self, tag: str) -> None:
        told = "".join(self._text).strip()
        if tag in ("b", "strong") and self._marked:
            self._mark(told)
            self._marked = ""
        elif tag in ("td", "th") and self._row is not None:
            self._row.cells.append(told)
        elif tag == "tr" and self._row is not None:
            self._end_row(self._row)
            self._row = None
        elif tag == "table":
            self._table = ""

    def _mark(self, told: str) -> None:
        if self._marked == "gate-word":
            self.gates.append(told)
        elif self._row is not None and self._marked == "word":
            self._row.words.append(told)
        elif self._row is not None and self._marked.startswith("folded-"):
            if not told.isdecimal():
                raise ValueError(f"what is not shown is counted as {told!r}")
            self._row.folded = int(told)
        elif self._row is not None:
            self._row.waived = True

    def _end_row(self, row: _Row) -> None:
        if self._table == "verdicts" and "verdict" in row.kinds:
            if len(row.words) != 1 or row.words[0] not in CAMPAIGN_STATUSES:
                raise ValueError(f"a verdict reads {row.words}")
            self.words[row.words[0]] += 1
            self.waived += row.waived
        elif self._table == "verdicts" and "folded" in row.kinds:
            self.words["supported"] += row.folded
        elif self._table == "case-counts":
            self._count(row)

    def _count(self, row: _Row) -> None:
        if not self._columns:
            self._columns = [cell.lower() for cell in row.cells]
            if not set(COUNTED) <= set(self._columns):
                raise ValueError(f"episodes by case are told in the columns {self._columns}")
            return
        if not {"case", "unlisted", "folded"} & set(row.kinds):
            return
        self.cases += row.folded + ("case" in row.kinds)
        for word in COUNTED:
            self.episodes[word] += _number(row.cells, self._columns.index(word))


def _number(cells: list[str], place: int) -> int:
    if place >= len(cells) or not cells[place].isdecimal():
        raise ValueError(f"a count of episodes is missing, or no number, in {cells}")
    return int(cells[place])
