"""Falsifications made by hand: of each word one, as a search would tell them."""

from __future__ import annotations

from dataclasses import replace

from pytest_dura.core.codec import encode
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.requirements.searches import (
    Falsification,
    FoundCounterexample,
    ParameterChange,
    ReplayCount,
    SearcherReport,
    SearchOutcome,
    SearchParameter,
    Shrinking,
    SpaceCoverage,
)

ITEM = "test_search.py::test_it[a/clear]"
SCENARIO = {"name": "a/clear", "seed": 7, "world": {"wall": 2.0, "ego": {"speed": 9.0}}}


def counterexample(**changes):
    told = {
        "case": "a/clear@0123456789",
        "scenario": SCENARIO,
        "seed": 7,
        "digest": "a" * 64,
        "margin": -0.25,
        "time": 3.4,
        "detail": "gap is -0.25 at 3.4 s",
        "repeats": ReplayCount(1, 1, 1),
        "changes": (
            ParameterChange("world.ego.speed", 9.0, 8.0, "m/s"),
            ParameterChange("world.wall", 2.0, 4.0),
            ParameterChange("faults.delay", "delay", None),
            ParameterChange("faults.delay.activation.at", 2.0, 0.0, "s"),
        ),
        "shrinking": Shrinking(11, 4, 41, 200, finished=True),
        "file": "scenarios/found/a-clear-saf-1.yaml",
        "name": "found/a-clear-saf-1",
    }
    return FoundCounterexample(**{**told, **changes})


def outcome(word, requirement="SAF-1", *, kept=None, **changes):
    """What a search of 37 simulations came to; what was confirmed is shrunk and kept."""
    violated, confirmed = word in ("falsified", "not repeatable"), word == "falsified"
    found = counterexample(repeats=ReplayCount(1, 1, 1) if confirmed else ReplayCount(10, 3, 2))
    if not (confirmed if kept is None else kept):
        found = replace(found, shrinking=None, file=None, name=None)
    told = {
        "requirement": requirement,
        "check": "always (gap > 0)" if requirement == "SAF-1" else "gap > 0",
        "status": word,
        "simulations": 21 if violated else 37,
        "searcher": "cma-es" if violated else None,
        "best": -0.25 if violated else 0.125,
        "counterexample": found if violated else None,
    }
    return SearchOutcome(**{**told, **changes})


def searcher(name, simulations, best, first=None, *, trivial=True):
    """One with these figures, requirement by requirement."""
    return SearcherReport(name, trivial, simulations, best, first or dict.fromkeys(best))


def falsification(*words, kept=None, **changes):
    """A search for these words, of the requirements SAF-1 and PERF-1.

    Its budget is used up, unless all of the words are violations.
    """
    outcomes = [outcome(word, name, kept=kept) for word, name in zip(words, NAMES, strict=False)]
    names = [one.requirement for one in outcomes]
    hit = {one.requirement: 9 if one.counterexample else None for one in outcomes}
    best = {one.requirement: one.best for one in outcomes}
    mild = dict.fromkeys(names, 0.5)
    told = {
        "case": "a/clear",
        "component": "C",
        "seed": 3,
        "budget": 100,
        "simulations": 37,
        "refused": 2,
        "unknown": 9 if "undecided" in words else 1,
        "not_manifested": 2,
        "rule": "corners first, then an equal share to each",
        "parameters": (
            SearchParameter("world.wall", 2.0, 6.0),
            SearchParameter("world.ego.speed", choice=[8.0, 9.0]),
            SearchParameter(
                "faults.search-1", faults={"delay": (SearchParameter("activation.at", 0.0, 5.0),)}
            ),
        ),
        "searchers": (
            searcher("corners", 12, mild),
            searcher("cma-es", 25, best, hit, trivial=False),
        ),
        "baselines": (
            searcher("random seeds", 37, mild),
            searcher("bang-bang", 37, best, {name: hit[name] and 30 for name in names}),
        ),
        "coverage": SpaceCoverage({"world.wall": 0.7, "world.ego.speed": 1.0}, 0.48),
        "outcomes": tuple(outcomes),
    }
    return Falsification(**{**told, **changes})


NAMES = ("SAF-1", "PERF-1")


def told(found):
    """A falsification as an item's report has it."""
    about = {
        "scenario": "a/clear",
        "simulator": "rooms:Room",
        "roles": {"generator": "m:G", "safety_monitor": "m:Monitor"},
    }
    return encode(RecordedSearch(**vars(found), **about))


def entry(*words, item=ITEM, waiver=None, **changes):
    """A falsification as the record has it."""
    return {**told(falsification(*words, **changes)), "item": item, "waiver": waiver}
