"""Cells of tables that reports and terminal share: failure modes, and outcomes of searches.

No search supports a requirement: of a search without a violation its effort is reported.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pytest_dura.evidence.gate import VIOLATED_OUTCOMES
from pytest_dura.evidence.metrics import share
from pytest_dura.evidence.text import name, one_line

Data = Mapping[str, Any]

_SUMMED_COUNTS = ("hits", "of", "null_hits", "null_of", "episodes", "of_episodes")
FAILURE_MODE_HEADINGS = {
    "failure": "failure modes",
    "control": "negative control",
    "comparison": "no failure by itself",
}
"""What tables write above the measures of a kind."""
_TIMEOUT = "timeout"
"""Name of the failure mode of a decision that was not there in time."""
NULL_NOTE = (
    "null: a component that ignores its input, on the same decisions: what it also reaches says "
    "nothing about the model"
)


def cases_with_accounts(cases: Sequence[Data]) -> list[Data]:
    """The cases whose component gave accounts; those without a role repeat others' decisions."""
    return [case for case in cases if case["metrics"]["failure_modes"] and not case["without"]]


def failure_modes_by_component(cases: Sequence[Data]) -> dict[str, list[dict[str, Any]]]:
    """By component, its failure modes over all cases, those that could show, by kind.

    Without a bound: cases are no sample of one kind of episode.
    """
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for case in cases_with_accounts(cases):
        modes = found.setdefault(case["component"], {})
        for failure_mode in case["metrics"]["failure_modes"]:
            empty = {
                "name": failure_mode["name"],
                "kind": failure_mode["kind"],
                **dict.fromkeys(_SUMMED_COUNTS, 0),
            }
            mode = modes.setdefault(failure_mode["name"], empty)
            for key in _SUMMED_COUNTS:
                mode[key] += failure_mode[key]
    return {
        component: [
            {
                **failure_mode,
                "share": share(failure_mode["hits"], failure_mode["of"]),
                "null_share": share(failure_mode["null_hits"], failure_mode["null_of"]),
            }
            for failure_mode in measured_failure_modes(list(modes.values()))
        ]
        for component, modes in found.items()
    }


def measured_failure_modes(modes: Sequence[Data]) -> list[Data]:
    """Those that could show, failures first, then the controls that they are to be read with.

    Also those that could only have shown of the null component: that a component gave nothing to
    measure, as where it failed on each variant of its prompt, is not to be overlooked.
    """
    could = [mode for mode in modes if mode["of"] or mode["null_of"]]
    return [item for kind in FAILURE_MODE_HEADINGS for item in could if item["kind"] == kind]


def failure_mode_text(name: str) -> str:
    """``misses threat``."""
    return name.replace("_", " ")


def percent_text(part: float | None) -> str:
    """A share in per cent, ``-`` of nothing; what is neither never nor always does not read so."""
    if part is None:
        return "-"
    text = f"{100 * part:.1f}"
    if part > 0.0 and text == "0.0":
        return "<0.1"
    return ">99.9" if part < 1.0 and text == "100.0" else text


def decision_time_lines(cases: Sequence[Data]) -> Iterator[tuple[str, str]]:
    """Each component whose decisions took time, how much, and how many took too much, in words."""
    late = _timeouts(cases)
    for component, spreads in _metric_spreads(cases, "answer_times").items():
        decisions = sum(spread["decisions"] for spread in spreads)
        text = f"{decisions} decisions, {_percentiles(spreads, 'longest', '.2f')}"
        hits, of = late.get(component, (0, 0))
        if of:
            text += f"; {hits} of {of} ({percent_text(hits / of)} %) past the time budget"
        yield component, text


def decision_age_lines(cases: Sequence[Data]) -> Iterator[tuple[str, str]]:
    """Each component whose decisions came into force late, and how old they were, in words.

    Where the simulation waits for each decision, none is older than its percept, and nothing is
    told.
    """
    for component, spreads in _metric_spreads(cases, "answer_ages").items():
        if any(spread["max"] > 0.0 for spread in spreads):
            yield component, _percentiles(spreads, "oldest", ".4g")


def _timeouts(cases: Sequence[Data]) -> dict[str, tuple[int, int]]:
    """By component: decisions to which no answer came in time, of all whose outcome is told."""
    found: dict[str, tuple[int, int]] = {}
    for case in cases_with_accounts(cases):
        for failure_mode in case["metrics"]["failure_modes"]:
            if failure_mode["name"] == _TIMEOUT:
                hits, of = found.get(case["component"], (0, 0))
                found[case["component"]] = hits + failure_mode["hits"], of + failure_mode["of"]
    return found


def _metric_spreads(cases: Sequence[Data], key: str) -> dict[str, list[Data]]:
    """By component, what this key of the metrics says, one for each case that has it."""
    found: dict[str, list[Data]] = {}
    for case in cases_with_accounts(cases):
        if case["metrics"][key] is not None:
            found.setdefault(case["component"], []).append(case["metrics"][key])
    return found


def _percentiles(spreads: Sequence[Data], last: str, shown: str) -> str:
    """Median, 95th percentile and greatest, in s."""
    median, high = (
        _percentile_range(word, key, spreads, shown)
        for word, key in (("median", "p50"), ("95th percentile", "p95"))
    )
    return f"{median}, {high}, {last} {max(spread['max'] for spread in spreads):{shown}} s"


def _percentile_range(word: str, key: str, spreads: Sequence[Data], shown: str) -> str:
    """Percentiles of several cases do not add up: the least and the greatest are told."""
    least, greatest = (
        f"{limit(spread[key] for spread in spreads):{shown}}" for limit in (min, max)
    )
    if least == greatest:
        return f"{word} {least} s"
    return f"{word} {least} to {greatest} s by case"


_LEARNS = "learns"
NOTHING_SUPPORTED = (
    "A search that finds nothing supports no requirement: no rate follows from where it looked."
)


def simulations_text(search: Data) -> str:
    """How much was simulated, of how much: ``37 of 100 simulations``."""
    text = f"{search['simulations']} of {_counted(search['budget'], 'simulation')}"
    if search["unknown"]:
        text += f", {search['unknown']} without an answer"
    if search["idle"]:
        text += f", {search['idle']} with an added fault that never came to act"
    if search["refused"]:
        text += f"; {_counted(search['refused'], 'point')} refused"
    return text


def outcome_headline(search: Data, outcome: Data) -> str:
    """The word, the requirement, and what it rests on."""
    word, requirement = outcome["word"], name(outcome["requirement"])
    counterexample = outcome["counterexample"]
    if counterexample is not None:
        repeats = counterexample["repeats"]
        by = f"at simulation {outcome['simulations']}, by {one_line(outcome['searcher'])}"
        if word == "falsified":
            again = f"confirmed by {_counted(repeats['runs'], 'equal replay')}"
        else:
            runs = _counted(repeats["runs"], "replay")
            again = f"and in {repeats['violated']} of {runs}, {repeats['equal']} of them equal"
        return f"{word}: {requirement} violated {by}; {again}"
    least = "none measured" if outcome["best"] is None else f"{outcome['best']:.4g}"
    start = f"{requirement}: " if word == "nothing found" else f"{word}: {requirement}: "
    return (
        f"{start}nothing found in {_counted(search['simulations'], 'simulation')}: "
        f"least robustness {least}, coverage {search_coverage_text(search)}"
    )


def search_coverage_text(search: Data) -> str:
    """The share of the ranges that was simulated, on average, and of their pairs."""
    shares, pairs = list(search["coverage"]["parameters"].values()), search["coverage"]["pairs"]
    text = f"{100 * sum(shares) / len(shares):.0f} % of each range" if shares else "unknown"
    return text if pairs is None else f"{text}, {100 * pairs:.0f} % of their pairs"


def _violating_baselines(search: Data, requirement: str) -> list[Data]:
    """The baselines that violated a requirement."""
    return [
        baseline
        for baseline in search["baselines"]
        if baseline["first"].get(requirement) is not None
    ]


def is_notable_outcome(search: Data, outcome: Data) -> bool:
    """Whether anybody violated it, and it matters who."""
    return outcome["word"] in VIOLATED_OUTCOMES or bool(
        _violating_baselines(search, outcome["requirement"])
    )


SEARCHER_COLUMNS = ("simulations", "violated at", "robustness")
SEARCHER_LEGEND = "violated at: after so many of its own simulations; robustness: its least"


def searcher_rows(search: Data, requirement: str, kind: str) -> Iterator[tuple[str, list[str]]]:
    """The name and the cells of every searcher, or of every baseline.

    Args:
        search: Of the record.
        requirement: For which of its requirements.
        kind: ``searchers`` or ``baselines``.
    """
    for item in search[kind]:
        first, best = item["first"].get(requirement), item["best"].get(requirement)
        shown = name(item["name"])
        if kind == "searchers" and not item["trivial"]:
            shown = f"{shown} ({_LEARNS})"
        cells = [str(item["simulations"]), "none" if first is None else str(first)]
        yield shown, [*cells, "-" if best is None else f"{best:.4g}"]


def counterexample_text(found: Data, check: str) -> str:
    """Margin, time and reason of a counterexample; a reason that repeats the check is left out."""
    told = [] if found["margin"] is None else [f"margin {found['margin']:.4g}"]
    if found["time"] is not None:
        told.append(f"at {found['time']:.2f} s")
    detail = "" if found["detail"] == check else one_line(found["detail"], 300)
    return f"{' '.join(told)}: {detail}" if told and detail else " ".join(told) or detail


def shrinking_text(found: Data) -> str:
    """What shrinking came to; empty where it was not asked for."""
    how = found["shrinking"]
    if how is None:
        return ""
    spent = _counted(how["simulations"], "simulation")
    left = "" if how["finished"] else f", all of {how['budget']} that it was allowed"
    return f"from {how['before']} to {how['after']} parameters that differ ({spent}{left})"


def parameter_changes(found: Data, most: int) -> Sequence[tuple[str, str]]:
    """Path and change of each parameter: ``world.wall``, ``2 instead of 4``."""
    return [(name(change["path"]), _parameter_change(change)) for change in found["changes"][:most]]


def _parameter_change(item: Data) -> str:
    if item["value"] is None:
        return "left out"
    if item["nominal"] is None:
        return f"{_value_text(item['value'])}, added"
    return f"{_value_text(item['value'])} instead of {_value_text(item['nominal'])}"


def _value_text(told: Any) -> str:
    """A value on one line, such as ``{type: delay, target: lidar}``."""
    if told is None:
        return "nothing"
    if isinstance(told, float):
        return f"{told:g}"
    if isinstance(told, Mapping):
        return (
            "{"
            + ", ".join(f"{name(str(key))}: {_value_text(item)}" for key, item in told.items())
            + "}"
        )
    if isinstance(told, (list, tuple)):
        return "[" + ", ".join(map(_value_text, told)) + "]"
    return one_line(str(told), 120)


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
