"""Whether passengers were uncomfortable, by the account of the oracle."""

from __future__ import annotations

from pytest_dura.core.episode import Episode
from pytest_dura.core.measures import Measure
from pytest_dura.driving.roles.performance import DISCOMFORT


def uncomfortable(episode: Episode) -> bool | None:
    """Whether a limit of comfort was exceeded at any time; ``None`` where no oracle measures it."""
    felt = episode.metrics.column(DISCOMFORT)
    return bool((felt > 1.0).any()) if len(felt) else None


UNCOMFORTABLE = Measure(
    "uncomfortable",
    heading="comfort",
    meaning="runs that at some time were beyond what passengers take",
    function=uncomfortable,
    shown="share",
    table="reliance",
)
