"""What several attempts at an episode, and several looks at it, come to."""

from __future__ import annotations

from typing import Any

from pytest_dura.requirements.verdicts.episodes import EpisodeVerdict

Data = dict[str, Any]


def test_of(item: str) -> str:
    """The test function of a node id, without its parameters."""
    return item.partition("[")[0]


def final_outcomes(told: list[Data]) -> list[Data]:
    """Of several attempts of an item a violation counts before anything else, then the last."""
    final: dict[str, Data] = {}
    for one in told:
        before = final.get(one["item"])
        if before is None or before["verdict"] != "violated":
            final[one["item"]] = one
    return list(final.values())


WORST_FIRST = ("violated", "missing", "invalid", "satisfied")


def worst_by_episode(final: list[Data]) -> list[EpisodeVerdict]:
    """One verdict for each episode, at which other parameters of a test may look again."""
    names = EpisodeVerdict.__dataclass_fields__
    worst: dict[str, Data] = {}
    for one in sorted(final, key=lambda one: WORST_FIRST.index(one["verdict"])):
        worst.setdefault(one["episode"], one)
    found = sorted(worst.values(), key=lambda one: _run_number(one["episode"]))
    return [EpisodeVerdict.from_json({name: one[name] for name in names}) for one in found]


def _run_number(episode: str) -> tuple[str, int]:
    case, _, run = episode.rpartition("#")
    return case, int(run)
