"""Formulas over what a component tells of its proposals, where it told nothing."""

from __future__ import annotations

from collections.abc import Collection

from pytest_dura.core.accounts import PREFIX as ACCOUNTS
from pytest_dura.core.episode import Episode
from pytest_dura.requirements.stl.language.formula import Formula


def never_measured(formula: Formula, episode: Episode) -> list[str]:
    """Failure modes in a formula that no decision of the episode could have shown.

    Their signals are 0 throughout. That such a formula holds says nothing.
    """
    names = [name.removeprefix(ACCOUNTS) for name in formula.signals if name.startswith(ACCOUNTS)]
    tallies = episode.metrics.tallies
    return [name for name in names if name in tallies and tallies[name].of == 0]


def untold(formula: Formula, known: Collection[str]) -> list[str]:
    """The signals of a formula that only accounts give, of an episode that has none."""
    if any(name.startswith(ACCOUNTS) for name in known):
        return []
    return [name for name in formula.signals if name.startswith(ACCOUNTS)]
