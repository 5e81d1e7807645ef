"""A failure mode that no decision could have shown: that it did not show says nothing."""

from __future__ import annotations

import numpy as np
import pytest
from loops import run_loop
from thermostat import Thermostat

from pytest_dura import Proposal, Requirement
from pytest_dura.requirements import judge_episode


class Told(Thermostat):
    """A room in which an account may admit to guessing, or to nothing."""

    def account_measures(self, ticks, percepts, accounts):
        column = np.array([one.get("guess", np.nan) for one in accounts], float)
        return {"guessed": column, "obeyed": np.full(len(accounts), np.nan)}


def verdict(check, *guesses):
    def propose(view):
        return Proposal(0.5, account={"decided": True} | guesses[view.index])

    episode = run_loop(propose, simulator=Told(), seconds=len(guesses) / 10)
    found = judge_episode(Requirement("R-1", check=check), episode)
    return found.verdict, found.vacuous


@pytest.mark.parametrize(
    "check, guesses, expected",
    [
        ("always (proposal.guessed < 0.5)", [{"guess": 0}, {}], ("satisfied", False)),
        ("always (proposal.guessed < 0.5)", [{}, {}], ("satisfied", True)),
        ("always (proposal.guessed < 0.5)", [{}, {"guess": 1}], ("violated", False)),
        ("always (proposal.obeyed < 0.5)", [{"guess": 0}], ("satisfied", True)),
        ("always (proposal.obeyed < 0.5)", [{"guess": 1}], ("satisfied", True)),
        (
            "always (proposal.obeyed < 0.5) and always (proposal.guessed < 0.5)",
            [{"guess": 0}],
            ("satisfied", True),
        ),
        ("always (temperature < 99)", [{}], ("satisfied", False)),
    ],
)
def test_a_pass_is_vacuous_where_nothing_could_have_shown(check, guesses, expected):
    assert verdict(check, *guesses) == expected
