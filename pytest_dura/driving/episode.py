"""DrivingEpisode: an episode of driving as a type checker sees it."""

from __future__ import annotations

from pytest_dura.requirements.episode_verdicts import JudgedEpisode


class DrivingEpisode(JudgedEpisode):
    """An episode with the measures of driving, for annotations: `episode: DrivingEpisode`.

    Every episode has the measures that its simulator declares as attributes; a type checker knows
    them by such a class alone. A domain of one's own has one of its own.
    """

    collided: bool
    """Whether the ego was in contact with anything."""
    clearance_time: float
    """Seconds until the ego's rear had left the junction; NaN if it never did."""
    gridlock: bool
    """Whether the ego had not cleared the junction when the episode's time was up."""
    uncomfortable: bool | None
    """Whether a limit of comfort was exceeded; ``None`` where no oracle measures it."""
