"""Monitors: rates and times of each monitor's quality, from its counts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import RecordHead


class Monitors(Conclusion):
    """Concludes the key ``monitors``."""

    def add(self, episode: EpisodeEntry) -> None:
        """Take no episode in: a monitor is measured on signals, where they are."""

    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Conclude them from their counts and times."""
        return {"monitors": [monitor.with_rates() for monitor in head.monitors]}

    def check_head(self) -> Iterator[str]:
        """Yield the contradictions within counts, and the monitors on no listed case."""
        cases = {(case.id, case.component) for case in self.head.cases}
        for number, monitor in enumerate(self.head.monitors):
            if (monitor.case, monitor.component) not in cases:
                yield f"monitors/{number}: its case is not listed"
            for problem in monitor.contradictions():
                yield f"monitors/{number}: {problem}"
