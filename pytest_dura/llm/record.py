"""What the record has of language models: facts of each process, and the tables of them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from pytest_dura.core.codec import Count, Sha256, decode, encode
from pytest_dura.evidence import ConcludedColumn, Table
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import CellValue, Fact, RecordHead
from pytest_dura.evidence.text import counted, name
from pytest_dura.llm.stated import LIVE
from pytest_dura.llm.usage import Tokens

NAME = "language_models"
"""Of the table of models, and of the facts that it is concluded from."""
CASSETTE = "cassette"
"""What the fact on the cassette is about."""
_FIRST = 12
"""Characters of a hash in a table."""


@dataclass(frozen=True)
class Cassette:
    """A cassette as it was at the session's end."""

    file: str
    """Relative to the project's root."""
    sha256: Sha256 | None
    """SHA-256 of the file; null if it could not be read."""
    exchanges: Count
    """All that it holds."""


@dataclass(frozen=True)
class UsedModel:
    """A language model that a component asked, with the counts of a process or of a session."""

    component: str | None
    """The role that asked; null if a test did."""
    model: str
    """Its name."""
    about: str
    """What it is, in the words of the user who asked or recorded it; empty without any."""
    base_url: str | None
    """Of the server, without user, password and query; null if it is not known."""
    mode: Literal["live", "record", "replay"]
    """Who answered: the server each time, the server once, or the cassette alone."""
    fingerprint: str
    """SHA-256 of what the server tells of itself and the model."""
    capabilities: Mapping[str, Any] | None
    """What the probe found the server can do; null if it is not known."""
    prompts: str | None
    """SHA-256 of the prompts' templates; null for a component without."""
    asked: Count
    """Requests to the server, without those that were repeated."""
    repeated: Count
    """Calls by which requests were repeated, since the server was not available."""
    unavailable: Mapping[str, Count]
    """Calls that ended as `unavailable`, by cause: `HTTP 429` and the like, `connection`, or
    `request` for one that could not be made. Those that were repeated, and answers from the
    cassette, are among them."""
    asked_tokens: Tokens
    """Tokens of the requests to the server, those that were repeated included."""
    reused: Count
    """Answers from the cassette."""
    reused_tokens: Tokens
    """Tokens that those took when they were recorded."""
    injected: Count
    """Requests that an injected fault kept from the server."""
    missed: Count
    """Requests in replay to which the cassette has no answer."""

    @property
    def key(self) -> tuple[str | None, ...]:
        """What the counts of several processes have in common that are of one model."""
        return (
            self.component, self.model, self.fingerprint, self.prompts, self.base_url, self.mode,
        )  # fmt: skip

    def fact(self, process: str) -> Fact:
        """Make the fact of a process."""
        about = "; ".join("-" if part is None else part for part in self.key)
        return Fact(NAME, about, 0, encode(self), process)

    def __add__(self, other: UsedModel) -> UsedModel:
        counts = {
            key: getattr(self, key) + getattr(other, key)
            for key in ("asked", "repeated", "asked_tokens", "reused", "reused_tokens", "injected",
                        "missed")
        }  # fmt: skip
        causes = Counter(self.unavailable) + Counter(other.unavailable)
        return replace(self, **counts, unavailable=dict(sorted(causes.items())))

    @property
    def usage_text(self) -> str:
        """What was asked and taken from the cassette, in words; empty for nothing."""
        calls = self.asked + self.repeated
        texts = (
            (f"{counted(calls, 'request')} to the server", self.asked_tokens.text),
            (f"{counted(self.reused, 'answer')} from the cassette", self.reused_tokens.text),
        )
        return "; ".join(f"{what}: {text}" for what, text in texts if text)

    @property
    def causes(self) -> str:
        """Why calls found the server unavailable, and how many."""
        return ", ".join(f"{count} x {name(each)}" for each, count in self.unavailable.items())

    @property
    def unavailability_text(self) -> str:
        """Calls that found the server unavailable, in words; empty if there were none."""
        failed = sum(self.unavailable.values())
        if not failed and not self.repeated:
            return ""
        were = "was" if self.repeated == 1 else "were"
        repeated = (
            f"{counted(self.repeated, 'request')} {were} repeated"
            if self.repeated
            else "none was repeated"
        )
        return f"unavailable in {counted(failed, 'call')} ({self.causes}); {repeated}"


def models_of(head: RecordHead) -> list[UsedModel]:
    """Read the models of a record, each over all processes."""
    by_key: dict[tuple[Any, ...], UsedModel] = {}
    for fact in head.facts or ():
        if fact.table == NAME and fact.about != CASSETTE:
            used = decode(UsedModel, dict(fact.data))
            known = by_key.get(used.key)
            by_key[used.key] = used if known is None else known + used
    return [by_key[key] for key in sorted(by_key, key=str)]


def cassette_of(head: RecordHead) -> Cassette | None:
    """Read what the record has of a cassette; ``None`` in a live session."""
    found = (fact for fact in head.facts or () if (fact.table, fact.about) == (NAME, CASSETTE))
    fact = next(found, None)
    return None if fact is None else decode(Cassette, dict(fact.data))


class LanguageModels(Table):
    """One row for each model that a component asked."""

    name = NAME
    title = "Language models"
    detail = True
    columns = (
        ConcludedColumn("component", "the role that asked"),
        ConcludedColumn("model"),
        ConcludedColumn("server"),
        ConcludedColumn("mode", "whether the server answered, the server once, or the cassette"),
        ConcludedColumn("structured output", "what the server can do, by its probe"),
        ConcludedColumn("asked", "answers from the server"),
        ConcludedColumn("repeated", "requests to a server that was not available"),
        ConcludedColumn("reused", "answers from the cassette"),
        ConcludedColumn("injected", "requests that an injected fault kept from the server"),
        ConcludedColumn("missed", "requests to which the cassette has no answer"),
        ConcludedColumn("unavailable", "calls that found the server unavailable, by cause"),
        ConcludedColumn("fingerprint", "of what the server tells of itself and the model"),
    )

    def add(self, episode: EpisodeEntry) -> None:
        """Add nothing: processes count their requests."""

    def rows(self) -> Iterator[Sequence[CellValue]]:
        """Yield a row for each model."""
        cassette = cassette_of(self.head)
        self.about = (  # type: ignore[misc]
            ""
            if cassette is None
            else f"cassette {name(cassette.file)}, {counted(cassette.exchanges, 'exchange')}, "
            f"SHA-256 {cassette.sha256 or 'could not be read'}"
        )
        for used in models_of(self.head):
            structured = None
            if used.capabilities is not None:
                enforced = "enforced" if used.capabilities.get("enforced") else "not enforced"
                structured = f"{used.capabilities.get('structured', 'unknown')}, {enforced}"
            yield (
                used.component or "tests",
                used.model + (f" ({used.about})" if used.about else ""),
                used.base_url,
                used.mode,
                structured,
                used.asked,
                used.repeated,
                used.reused,
                used.injected,
                used.missed,
                used.causes or None,
                used.fingerprint[:_FIRST],
            )

    def lines(self) -> Iterator[str]:
        """Yield what each model was asked, and whether it was available."""
        for used in models_of(self.head):
            for text in filter(None, (used.usage_text, used.unavailability_text)):
                yield f"language model {name(used.model)}: {text}"

    @classmethod
    def alike(cls, head: RecordHead) -> Iterator[tuple[str, Any, str]]:
        """Yield what the servers can do, and the cassette."""
        remedy = "let all parts replay one cassette: --dura-llm=replay"
        for used in models_of(head):
            key = f"models {used.component} {used.model} {used.fingerprint} {used.mode}"
            yield key, used.capabilities, remedy
            yield f"cassette of {used.mode}", cassette_of(head), remedy

    def check_head(self) -> Iterator[str]:
        """Compare the cassette with the inputs, and what was not repeated with the models."""
        cassette = cassette_of(self.head)
        hashed = {(file.path, file.sha256) for file in self.head.inputs}
        if cassette is not None and (cassette.file, cassette.sha256) not in hashed:
            yield f"inputs: the cassette {cassette.file} is not among them as it was replayed"
        if any(used.mode != "replay" for used in models_of(self.head)):
            return
        for case in self.head.cases:
            repeat = case.repeat
            if repeat is not None and repeat.result == "skipped" and LIVE in repeat.declared:
                yield (
                    f"case {case.id}: {repeat.episode} was not repeated for the sake of a "
                    "live model, and none was asked"
                )


@dataclass
class _Usage:
    """What the decisions of a case used."""

    episodes: int = 0
    decisions: int = 0
    counts: Counter[str] = field(default_factory=Counter)


class TokensOfCases(Table):
    """One row for each case whose episodes tell what their decisions used."""

    name = "tokens"
    title = "Tokens of language models by case"
    detail = True
    columns = (
        ConcludedColumn("case"),
        ConcludedColumn("component"),
        ConcludedColumn("episodes", "episodes that tell"),
        ConcludedColumn("decisions"),
        ConcludedColumn("requests", "to the model, those beside the decisions included"),
        ConcludedColumn("prompt tokens", "tokens of the requests, as the server counted them"),
        ConcludedColumn("answer tokens", "tokens of the answers"),
        ConcludedColumn(
            "per decision", "tokens of both for a decision and what is asked beside it"
        ),
        ConcludedColumn("uncounted", "answers for which the server counted no tokens"),
    )

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        self._used: dict[tuple[str, str], _Usage] = defaultdict(_Usage)

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode."""
        usage = episode.metrics.answer_usage
        if usage is None or not episode.planned:
            return
        own = self._used[episode.case, episode.component]
        own.episodes += 1
        own.decisions += len(episode.metrics.answer_seconds)
        own.counts.update(usage)

    def rows(self) -> Iterator[Sequence[CellValue]]:
        """Yield a row for each case, in their order."""
        for case in self.head.cases:
            used = self._used.get((case.id, case.component))
            if used is not None:
                prompt, answer = used.counts["prompt"], used.counts["completion"]
                yield (
                    case.id, case.component, used.episodes, used.decisions,
                    used.counts["requests"], prompt, answer,
                    round((prompt + answer) / used.decisions) if used.decisions else None,
                    used.counts["uncounted"],
                )  # fmt: skip

    def lines(self) -> Iterable[str]:
        """Sum them up, without the second runs of pairs."""
        twins = {verdict.pairs.case for verdict in self.head.verdicts if verdict.pairs}
        shown = {
            (case.id, case.component)
            for case in self.head.cases
            if not case.without or case.id not in twins
        }
        counts = Counter[str]()
        for key, used in self._used.items():
            if key in shown:
                counts.update(used.counts)
        if self._used:
            requests = counted(counts["requests"], "request")
            yield (
                f"tokens: {counts['prompt']} of prompts and {counts['completion']} of answers in "
                f"{requests}"
            )
