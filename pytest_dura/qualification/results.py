"""Results of a qualification, as the record keeps them: plain data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

NAME = "qualification"
"""Of the table of the results, and of the facts that it is concluded from."""
Status = Literal["caught", "survived", "no difference", "not run"]


@dataclass(frozen=True)
class Kill:
    """A requirement that catches a mutant on a case.

    Args:
        requirement: Its id.
        case: Id of the case.
        provoker: Name of the component that provoked it; empty for the suite's own.
        run: Number of the first run that it catches the mutant in.
        runs: Runs of the case with the mutant.
        violated: Those of them that it catches the mutant in; 0 where it is undecided.
        why: What the verdict with the mutant is, in words.
    """

    requirement: str
    case: str
    provoker: str
    run: int
    runs: int
    violated: int
    why: str


@dataclass(frozen=True)
class Margin:
    """How near a requirement came to catching a mutant.

    Args:
        requirement: Its id.
        case: Id of the case.
        provoker: As of a kill.
        left: Its worst margin with the mutant, in the unit of its check.
        before: Its worst margin without it.
        runs: Runs of the case with the mutant that have a margin.
        nearer: Those of them that come nearer than any without it.
    """

    requirement: str
    case: str
    provoker: str
    left: float
    before: float
    runs: int = 0
    nearer: int = 0

    @property
    def share(self) -> float:
        """Part of the margin that the mutant left."""
        return self.left / self.before


@dataclass(frozen=True)
class Qualified:
    """What a suite makes of a mutant.

    Args:
        name: Of the mutant.
        role: The part that it wraps.
        about: What is wrong, with the parameters.
        status: ``caught`` or ``survived``; ``no difference`` where no run differs from that of the
            part as it is; ``not run`` where an infrastructure error ended each case.
        runs: Episodes with it.
        kills: By requirement and case; one whose runs are not repeatable has the requirement
            ``repeatability``, one whose runs are no sample ``validity``.
        nearest: Of a survivor, the requirement whose margin it used up most; ``None`` if it used up
            none.
        problem: Why it was not run, or not run on some case.
    """

    name: str
    role: str
    about: str
    status: Status
    runs: int = 0
    kills: tuple[Kill, ...] = ()
    nearest: Margin | None = None
    problem: str = ""


REPEATABILITY = "repeatability"
"""Stands for the gate's rule that an episode, run again, comes out the same."""
VALIDITY = "validity"
"""Stands for the gate's rule that runs are a sample: faults manifest, and runs differ."""
