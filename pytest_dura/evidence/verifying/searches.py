"""Whether searches claim no more than they saw, and whether nothing else rests on them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

from pytest_dura.core.episode import canonical
from pytest_dura.evidence.record.searches import CLAIMED, NOTHING
from pytest_dura.evidence.record.session_record import SessionRecord, components_under_test

Data = Mapping[str, Any]
MARK = "@"
"""Stands in the id of a case that a search chose, and in no name of a scenario."""
SILENT_SHARE = 0.2
"""Of simulations that say nothing; with more of them a search is undecided."""


def search_problems(record: SessionRecord) -> Iterator[str]:
    """Everything in which searches contradict themselves or the record, and what rests on them."""
    yield from _in_rates(record)
    listed = {one["id"]: one for one in record["requirements"]}
    described = {one["name"] for one in components_under_test(record)}
    told: Counter[bytes] = Counter()
    for one in record["searches"]:
        place = f"search by {one['item']} on {one['case']}"
        told[canonical({key: value for key, value in one.items() if key != "waiver"})] += 1
        if one["component"] not in described:
            yield f"{place}: {one['component']} is not described"
        for problem in (*_counts(one), *_outcomes(one, listed)):
            yield f"{place}: {problem}"
    if any(count > 1 for count in told.values()):
        yield "searches: one of them is listed twice"


def _in_rates(record: SessionRecord) -> Iterator[str]:
    """Whether episodes that a search chose stand where a rate is made of them."""
    for episode in record.episodes():
        if episode["planned"] and (MARK in episode["case"] or MARK in episode["id"]):
            yield f"episode {episode['id']}: a search chose it, and it counts as planned"
    for case in record["cases"]:
        if MARK in case["id"] and (case["planned"] or case["metrics"]["run"]):
            yield f"case {case['id']}: a search chose it, and there are metrics of it"
    for one in record["verdicts"]:
        name = f"verdict {one['requirement']} on {one['case']}"
        if MARK in one["case"]:
            yield f"{name}: a search chose the case, and no rate can be made of it"
        for found in one["counterexamples"]:
            if MARK in found["episode"]:
                yield f"{name}: a search chose its counterexample {found['episode']}"


def _counts(one: Data) -> Iterator[str]:
    """Whether its sums are those of its searchers."""
    total = one["simulations"]
    if not 0 < total <= one["budget"]:
        yield f"{total} simulations, and its budget is {one['budget']}"
    if one["unknown"] > total:
        yield f"{one['unknown']} of {total} simulations said nothing"
    if one["idle"] > total:
        yield f"an added fault never came to act in {one['idle']} of {total} simulations"
    done = sum(searcher["simulations"] for searcher in one["searchers"])
    if done != total:
        yield f"{total} simulations, and its searchers did {done}"
    names = [outcome["requirement"] for outcome in one["outcomes"]]
    if not names or len(set(names)) < len(names):
        yield f"it is for the requirements {', '.join(names) or 'of nobody'}"
    yield from _searchers(one, names)


def _searchers(one: Data, names: Sequence[str]) -> Iterator[str]:
    for kind in ("searchers", "baselines"):
        if len({searcher["name"] for searcher in one[kind]}) < len(one[kind]):
            yield f"one of its {kind} is listed twice"
        for searcher in one[kind]:
            yield from (f"{searcher['name']}: {each}" for each in _searcher(searcher, names))
    for baseline in one["baselines"]:
        if not baseline["trivial"]:
            yield f"{baseline['name']} learns, and is no baseline"
        if baseline["simulations"] > one["simulations"]:
            yield f"{baseline['name']}: a baseline of {baseline['simulations']} simulations"


def _searcher(one: Data, names: Sequence[str]) -> Iterator[str]:
    if set(one["best"]) != set(names) or set(one["first"]) != set(names):
        yield "its figures are of other requirements"
    for name, first in one["first"].items():
        if first is not None and first > one["simulations"]:
            yield f"violated {name} at {first} of its {one['simulations']} simulations"


def _outcomes(one: Data, listed: Mapping[str, Data]) -> Iterator[str]:
    for outcome in one["outcomes"]:
        name = outcome["requirement"]
        problems = [*_word(one, outcome), *_first(one, outcome)]
        if outcome["counterexample"] is not None:
            problems += _counterexample(one, outcome["counterexample"])
        if name not in listed:
            problems.append("the requirement is not listed")
        elif listed[name]["check"] not in ("", outcome["check"]):
            problems.append(f"searched {outcome['check']!r}, which is not its check")
        yield from (f"{name}: {problem}" for problem in problems)


def _word(one: Data, outcome: Data) -> Iterator[str]:
    """Whether what was found allows the word."""
    word, found = outcome["word"], outcome["counterexample"]
    if (found is not None) != (word in CLAIMED):
        yield f"{word}, and {'a' if found is not None else 'no'} counterexample"
    elif found is not None:
        repeats = found["repeats"]
        if not max(repeats["violated"], repeats["equal"]) <= repeats["runs"]:
            yield f"more repeats than {repeats['runs']}"
        confirmed = 0 < repeats["runs"] == repeats["violated"] == repeats["equal"]
        if confirmed != (word == "falsified"):
            told = f"{repeats['violated']} violated and {repeats['equal']} equal"
            yield f"{word}, and of {repeats['runs']} replays {told}"
        if not one["baselines"]:
            yield f"{word}, and no baseline stands beside it"
    else:
        silent = one["unknown"] > SILENT_SHARE * one["simulations"]
        if silent and word == NOTHING:
            told = f"{one['unknown']} of {one['simulations']}"
            yield f"{word}, though {told} simulations said nothing of a requirement"
        if not silent and word == "undecided":
            yield f"{word}, and only {one['unknown']} simulations said nothing of a requirement"


def _first(one: Data, outcome: Data) -> Iterator[str]:
    """Whether its first violation and its least robustness are those of its searchers."""
    name, total = outcome["requirement"], one["simulations"]
    hits, met = (_hits(one[kind], name) for kind in ("searchers", "baselines"))
    if outcome["counterexample"] is None:
        if outcome["simulations"] != total or outcome["searcher"] is not None:
            yield f"nothing violated it, in {outcome['simulations']} of {total} simulations"
        for who, first in hits.items():
            yield f"{who} violated it at its simulation {first}, and there is no counterexample"
    elif not hits and outcome["searcher"] in met:
        if outcome["simulations"] != met[outcome["searcher"]]:
            yield f"violated at simulation {outcome['simulations']} of a baseline"
    elif outcome["searcher"] not in hits:
        yield f"{outcome['searcher']} found it, and violated nothing"
    elif not hits[outcome["searcher"]] <= outcome["simulations"] <= total:
        yield f"violated at simulation {outcome['simulations']} of {total}"
    known = [each["best"].get(name) for each in one["searchers"]]
    least = min((best for best in known if best is not None), default=None)
    if outcome["best"] != least:
        yield f"its least robustness is {outcome['best']}, and its searchers say {least}"


def _hits(searchers: Sequence[Data], requirement: str) -> dict[str, int]:
    """Who violated a requirement, and at which of its own simulations first."""
    firsts = {each["name"]: each["first"].get(requirement) for each in searchers}
    return {who: first for who, first in firsts.items() if first is not None}


def _counterexample(one: Data, found: Data) -> Iterator[str]:
    if not found["case"].startswith(f"{one['scenario']}{MARK}"):
        yield f"its counterexample {found['case']} is of another scenario than {one['scenario']}"
    told = found["scenario"].get("name"), found["scenario"].get("seed")
    if told != (one["scenario"], found["seed"]):
        yield f"its counterexample is {one['scenario']} with seed {found['seed']}, and says {told}"
    paths = [change["path"] for change in found["changes"]]
    if len(set(paths)) < len(paths):
        yield "a parameter of its counterexample changed twice"
    shrinking = found["shrinking"]
    if shrinking is not None:
        if shrinking["simulations"] > shrinking["budget"]:
            spent = shrinking["simulations"]
            yield f"{spent} simulations to make it simpler, and {shrinking['budget']} were allowed"
        if shrinking["after"] > shrinking["before"]:
            yield f"made simpler from {shrinking['before']} to {shrinking['after']} parameters"
    file = found["file"]
    if (file is None) != (found["name"] is None):
        yield f"its counterexample is kept in {file} as {found['name']}"
    if file is not None and (
        PurePosixPath(file).is_absolute() or PureWindowsPath(file).is_absolute()
    ):
        yield f"it is kept in {file}, which is a path of one machine"
    if file is not None and found["repeats"]["equal"] != found["repeats"]["runs"]:
        yield f"it is kept in {file}, and was never confirmed"
