"""What the argument says of episodes, gathered in one pass over them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pytest_dura.evidence.record.session_record import SessionRecord

Data = Mapping[str, Any]

SHOWN_COUNTEREXAMPLES = 5
"""Counterexamples of one verdict that become elements; the largest violations come first."""
_MOST_NAMES = 8


@dataclass
class Facts:
    """Of all episodes, in bounded memory.

    Args:
        policies: Recovery policies of the cases on which there is a verdict.
        simulators: Import paths of the simulators.
        seeds: How many episodes have a seed, and the least and the greatest one.
        counterexamples: Of the episodes that the argument shows, by id and component.
    """

    policies: set[str] = field(default_factory=set)
    simulators: set[str] = field(default_factory=set)
    seeds: tuple[int, int, int] | None = None
    counterexamples: dict[tuple[str, str], Data] = field(default_factory=dict)

    @classmethod
    def of(cls, record: SessionRecord) -> Facts:
        """One pass over the record's episodes."""
        told = cls()
        wanted = {
            (counterexample["episode"], verdict["component"])
            for verdict in record["verdicts"]
            for counterexample in shown(verdict)
        }
        judged = {verdict["case"] for verdict in record["verdicts"]}
        for one in record.episodes():
            told._take(one, judged=one["case"] in judged)
            key = (one["id"], one["component"])
            if key in wanted:
                told.counterexamples[key] = {"seed": one["seed"], "trace": one["trace"]}
        return told

    def _take(self, one: Data, *, judged: bool) -> None:
        spec, seed = one["spec"], one["seed"]
        if judged and len(self.policies) < _MOST_NAMES:
            self.policies.add(str(spec["policy"]))
        if len(self.simulators) < _MOST_NAMES:
            self.simulators.add(str(spec["simulator"]["path"]))
        count, least, greatest = self.seeds or (0, seed, seed)
        self.seeds = (count + 1, min(least, seed), max(greatest, seed))


def shown(verdict: Data) -> list[Data]:
    """The counterexamples of a verdict that become elements."""
    return list(verdict["counterexamples"][:SHOWN_COUNTEREXAMPLES])
