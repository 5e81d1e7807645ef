"""Situations: whether the runs of a campaign differ by more than their seeds.

Runs with equal trajectories are one observation, however many they are: no rate follows from them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Literal

from pytest_dura.core.episode import Episode

Situation = Literal["repeated", "without effect"]
REPEATED: Situation = "repeated"
"""All runs are equal, and nothing is declared to vary: one situation, repeated."""
WITHOUT_EFFECT: Situation = "without effect"
"""All runs are equal, though something is declared to vary: it has no effect."""

SITUATIONS: dict[str, str] = {
    REPEATED: "one situation, repeated",
    WITHOUT_EFFECT: "the declared variation has no effect",
}
"""How users are told of them."""
EQUAL_RUNS = 2
"""Runs after which a campaign ends if nothing is declared to vary and they are equal."""


class Situations:
    """Takes in the runs of a campaign, and of its twins, in any order; none of them is kept.

    Args:
        varies: Whether something is declared to vary, see :func:`varies`.
    """

    def __init__(self, *, varies: bool) -> None:
        self._varies = varies
        self._first: dict[str, tuple[int, str]] = {}
        self._several: set[str] = set()
        self._differ = False

    def add(self, episode: Episode) -> None:
        """A run, or its twin."""
        spec = episode.spec
        self.add_run(
            spec.case,
            spec.run,
            episode.trajectory,
            valid=episode.validity == "valid",
            drawn=episode.drawn,
        )

    def add_run(self, case: str, number: int, trajectory: str, *, valid: bool, drawn: bool) -> None:
        """A run as the record has it.

        Args:
            case: Id of its case.
            number: Of the run.
            trajectory: :attr:`Episode.trajectory`.
            valid: Whether it is valid; others show nothing, and so not that all are equal.
            drawn: Whether random numbers were drawn in it: what draws declares that it varies.
        """
        first, known = self._first.setdefault(case, (number, trajectory))
        if number != first:
            self._several.add(case)
        self._differ |= trajectory != known or not valid
        self._varies |= drawn

    @property
    def situation(self) -> Situation | None:
        """What the runs are if all are equal; ``None`` if they differ, or there is only one."""
        if self._differ or not self._first or self._several != self._first.keys():
            return None
        return WITHOUT_EFFECT if self._varies else REPEATED


def varies(paths: Iterable[str], faults: Collection[str]) -> bool:
    """Whether a scenario varies anything of a case.

    Args:
        paths: What it varies: ``world.x``, ``faults.id.x``.
        faults: Ids of the case's faults.
    """
    of_faults = {tuple(path.split(".", 2)[:2]) for path in paths}
    return any(path[0] != "faults" or path[-1] in faults for path in of_faults)
