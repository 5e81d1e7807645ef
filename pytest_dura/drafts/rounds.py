"""Rounds of drafts: what a model answers is checked, and what is refused goes back to it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pytest_dura.drafts.asking import Conversation, Draft
from pytest_dura.drafts.checks import RecordedRun, Shown, refusal_of_text, shown_on
from pytest_dura.drafts.earning import Suite
from pytest_dura.drafts.files import Passed
from pytest_dura.requirements.checks import read_formula

Judged = Iterator[tuple[str, bool, str]]
"""Of each draft its name, whether it was kept, and what it catches or why it was refused."""
NO_DEFECTS = "none"
"""Stands for no part that defects are seeded into."""
_VIOLATED = (
    "the suite's own component violates it in each scenario that decides it, so that nothing shows "
    "what it catches"
)
_UNSHOWN = (
    "no recorded run violates it and no defect is seeded, so that nothing shows that it can be "
    "violated"
)


@dataclass(frozen=True)
class Seeding:
    """Defects that drafts have to catch.

    Args:
        parts: Where they are seeded: ``component``, ``all``, or ``none``.
        cases: Scenarios with defects for each draft: those whose margins are least.
        runs: Runs of each case with a defect, at most.
    """

    parts: str = "component"
    cases: int = 1
    runs: int = 1


@dataclass(frozen=True)
class Outcome:
    """What became of a draft, or of an answer without one.

    Args:
        round: The number of the round, from 1.
        name: Id of the draft; empty for an answer without one.
        kept: Whether it passed.
        text: What it catches, or why it was refused.
    """

    round: int
    name: str
    kept: bool
    text: str


def outcomes_of(
    conversation: Conversation, rounds: int, judged: Callable[[Mapping[str, Any], str], Judged]
) -> Iterator[Outcome]:
    """Yield what became of each draft; what is refused goes back to the model.

    Args:
        conversation: With the model, on one sentence.
        rounds: Times that the model is asked, at most.
        judged: Judges an answer, made of the prompt with this digest.
    """
    for number in range(1, rounds + 1):
        digest = conversation.prompt_digest
        reading, answer = conversation.ask()
        refused: list[str] = []
        if reading.answered:
            for name, kept, text in judged(reading.content, digest):
                yield Outcome(number, name, kept, text)
                if not kept:
                    refused.append(f"{name}: {text}" if name else text)
        else:
            refused.append(f"the answer is none ({reading.outcome}): {reading.detail}")
            yield Outcome(number, "", kept=False, text=refused[0])
            if reading.outcome in ("unavailable", "timeout"):  # the model is not to blame
                return
        if not refused:
            return
        conversation.send_back(answer, refused)


@dataclass
class Drafting:
    """Rounds of a conversation.

    Args:
        conversation: With the model, on one sentence.
        suite: Whose requirements the drafts are held against.
        runs: The recorded runs that they are judged on.
        rounds: Times that the model is asked, at most.
        seeding: Defects that they have to catch.
    """

    conversation: Conversation
    suite: Suite
    runs: Sequence[RecordedRun]
    rounds: int = 3
    seeding: Seeding = Seeding()
    passed: list[Passed] = field(default_factory=list, init=False)

    def outcomes(self) -> Iterator[Outcome]:
        """Yield what became of each draft, round by round."""
        return outcomes_of(self.conversation, self.rounds, self._judged)

    def _judged(self, content: Mapping[str, Any], digest: str) -> Judged:
        """Yield the id of each draft of an answer, whether it was kept, and why."""
        if not content["requirements"]:
            yield "", False, "the answer has no requirement"
        for name, kept, text in self._round(content["requirements"], digest):
            yield name or "(no id)", kept, text

    def _round(self, entries: Sequence[Mapping[str, Any]], digest: str) -> Judged:
        """Yield the id of each draft, whether it was kept, and why."""
        taken, stated = self.suite.taken, self.suite.stated
        sound: dict[str, tuple[Draft, Shown]] = {}
        for entry in entries:
            draft = Draft.of(entry)
            name = draft.requirement.id
            reason = refusal_of_text(draft, self.suite.domain, taken, stated)
            taken[name] = "another draft"
            if not reason:
                shown = shown_on(draft, self.runs)
                reason = shown.refusal
            if reason:
                yield name, False, reason
            else:
                sound[name] = draft, shown
                stated[read_formula(draft.requirement.check).root] = name
        yield from self._earning(sound, digest)

    def _earning(self, sound: Mapping[str, tuple[Draft, Shown]], digest: str) -> Judged:
        """Yield what became of drafts that judge something: of those that catch nothing, why."""
        seeding, seeded = self.seeding, self.seeding.parts != NO_DEFECTS
        usable: dict[str, Draft] = {}
        where: set[str] = set()
        first = [case.scenario.name for case in self.suite.cases]
        for name, (draft, shown) in sound.items():
            places = shown.supported if shown.scenarios else first
            if seeded and not places:
                yield name, False, _VIOLATED
            elif not (seeded or shown.violated):
                yield name, False, _UNSHOWN
            else:
                usable[name] = draft
                where.update(places[: seeding.cases])
        earned = (
            self.suite.earned(usable, where, seeding.parts, seeding.runs)
            if seeded and usable
            else {}
        )
        for name, draft in usable.items():
            shown = sound[name][1]
            text = earned[name].text if seeded else "no defect was seeded"
            if seeded and not earned[name].alone:
                yield name, False, f"it {text}"
                continue
            applies = [*shown.scenarios] or (first[: seeding.cases] if seeded else [])
            self.suite.keep(draft.requirement, applies)
            text = f"{shown.text}; {text}"
            self.passed.append(Passed(draft.requirement, applies, text, digest))
            alone = f" ({', '.join(earned[name].alone)})" if seeded else ""
            yield name, True, f"{draft.requirement.check}; {text}{alone}"
