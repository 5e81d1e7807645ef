"""What the session's verdicts say of each of its hazards.

A requirement names the hazards that it mitigates. The evidence on a hazard is that of these
requirements, and no more: whether they suffice to mitigate it is for its analysis to say.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.requirements.hazards import Hazard
from pytest_dura.requirements.model import Requirement

HazardStatus = Literal[
    "violated", "no requirement", "no verdict", "none supported", "partly supported", "supported"
]
WITHOUT_EVIDENCE: tuple[HazardStatus, ...] = ("no requirement", "no verdict", "none supported")
"""What a hazard has come to whose mitigation nothing in the session supports."""


@dataclass(frozen=True)
class HazardEvidence:
    """A hazard with what the session has on it.

    Args:
        hazard: The hazard.
        requirements: Those of the record that name it, in its order.
        verdicts: On these, in the record's order.
    """

    hazard: Hazard
    requirements: tuple[Requirement, ...]
    verdicts: tuple[ItemVerdict, ...]

    @property
    def status(self) -> HazardStatus:
        """What the verdicts come to. A violation counts before anything else, waived or not."""
        statuses = {verdict.verdict for verdict in self.verdicts}
        judged = {verdict.requirement for verdict in self.verdicts}
        if "violated" in statuses:
            return "violated"
        if not self.requirements:
            return "no requirement"
        if not self.verdicts:
            return "no verdict"
        if "supported" not in statuses:
            return "none supported"
        whole = statuses == {"supported"} and len(judged) == len(self.requirements)
        return "supported" if whole else "partly supported"

    @property
    def has_evidence(self) -> bool:
        """Whether any verdict supports a requirement that mitigates it."""
        return any(verdict.verdict == "supported" for verdict in self.verdicts)

    def verdicts_on(self, requirement: Requirement) -> list[ItemVerdict]:
        """List the verdicts on one of its requirements."""
        return [verdict for verdict in self.verdicts if verdict.requirement == requirement.id]


def hazard_evidence(record: SessionRecord) -> list[HazardEvidence]:
    """What the session has on each of its hazards, in the order of the record."""
    requirements = record.head.requirements
    by_hazard: dict[str, list[Requirement]] = {}
    for requirement in requirements:
        for mitigated in requirement.mitigates:
            by_hazard.setdefault(mitigated, []).append(requirement)
    by_requirement: dict[str, list[ItemVerdict]] = {}
    for verdict in record.head.verdicts:
        by_requirement.setdefault(verdict.requirement, []).append(verdict)
    evidence: list[HazardEvidence] = []
    for hazard in record.head.hazards or ():
        own = by_hazard.get(hazard.id, [])
        verdicts = [verdict for each in own for verdict in by_requirement.get(each.id, ())]
        evidence.append(HazardEvidence(hazard, tuple(own), tuple(verdicts)))
    return evidence
