"""Attribution: violations under a fault that the same seed has without any fault as well."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import RecordHead


class Attribution(Conclusion):
    """Concludes ``also_without`` of verdicts: how many of their violations are not the fault's."""

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        self._compared: dict[tuple[str, str], dict[str, bool]] = {}
        """By component and episode, whether the requirement is violated without the fault too."""

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode with what is known of its faults."""
        if not episode.planned:
            return
        for fault in episode.faults:
            for requirement in fault.violated if fault.violated_without is not None else ():
                known = self._compared.setdefault((episode.component, episode.id), {})
                shared = requirement in (fault.violated_without or ())
                known[requirement] = known.get(requirement, False) or shared

    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Conclude it with the verdicts."""
        verdicts = []
        for verdict in head.verdicts:
            episodes = [
                self._compared.get((verdict.component, counterexample.episode), {})
                for counterexample in verdict.counterexamples
                if counterexample.valid
            ]
            name = verdict.requirement
            shared = [known[name] for known in episodes if name in known]
            # None where none was compared.
            verdicts.append(replace(verdict, also_without=sum(shared) if shared else None))
        return {"verdicts": verdicts}
