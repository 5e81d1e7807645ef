"""Cells of tables that reports and terminal share: failure modes, and outcomes of searches.

No search supports a requirement: of a search without a violation its effort is reported.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pytest_dura.evidence.gate import OBJECTIONABLE_OUTCOMES, VIOLATED_OUTCOMES, outcome_status
from pytest_dura.evidence.metrics import share
from pytest_dura.evidence.text import name, one_line

Data = Mapping[str, Any]

_SUMMED_COUNTS = ("hits", "of", "null_hits", "null_of", "episodes", "of_episodes")
FAILURE_MODE_HEADINGS = {
    "failure": "failure modes",
    "control": "negative control",
    "comparison": "no failure by itself",
}
"""Headings of tables above the measures of a kind."""
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
    """Failure modes of each component over all cases, those that could show, by kind.

    Without a bound: cases are no sample of one kind of episode.
    """
    components: dict[str, dict[str, dict[str, Any]]] = {}
    for case in cases_with_accounts(cases):
        modes = components.setdefault(case["component"], {})
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
        for component, modes in components.items()
    }


def measured_failure_modes(modes: Sequence[Data]) -> list[Data]:
    """Failure modes that could show, failures first, then the controls to be read with them.

    Those that could have shown of the null component alone are included: a reader is to see that a
    component gave nothing to measure, as where it failed on each variant of its prompt.
    """
    measured = [mode for mode in modes if mode["of"] or mode["null_of"]]
    return [mode for kind in FAILURE_MODE_HEADINGS for mode in measured if mode["kind"] == kind]


def failure_mode_text(name: str) -> str:
    """A failure mode's name with spaces: ``misses threat``."""
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
    """Each component whose decisions took time, and a text on how much and how often too much."""
    late = _timeouts(cases)
    for component, spreads in _metric_spreads(cases, "answer_times").items():
        decisions = sum(spread["decisions"] for spread in spreads)
        text = f"{decisions} decisions, {_percentiles(spreads, 'longest', '.2f')}"
        hits, of = late.get(component, (0, 0))
        if of:
            text += f"; {hits} of {of} ({percent_text(hits / of)} %) past the time budget"
        yield component, text


def decision_age_lines(cases: Sequence[Data]) -> Iterator[tuple[str, str]]:
    """Each component whose decisions came into force late, and a text on how old they were.

    Where the simulation waits for each decision, none is older than its percept: no line.
    """
    for component, spreads in _metric_spreads(cases, "answer_ages").items():
        if any(spread["max"] > 0.0 for spread in spreads):
            yield component, _percentiles(spreads, "oldest", ".4g")


def _timeouts(cases: Sequence[Data]) -> dict[str, tuple[int, int]]:
    """Decisions of each component without an answer in time, and all whose outcome is known."""
    timeouts: dict[str, tuple[int, int]] = {}
    for case in cases_with_accounts(cases):
        for failure_mode in case["metrics"]["failure_modes"]:
            if failure_mode["name"] == _TIMEOUT:
                hits, of = timeouts.get(case["component"], (0, 0))
                timeouts[case["component"]] = hits + failure_mode["hits"], of + failure_mode["of"]
    return timeouts


def _metric_spreads(cases: Sequence[Data], key: str) -> dict[str, list[Data]]:
    """Values of this key of the metrics for each component, of each case that has it."""
    spreads: dict[str, list[Data]] = {}
    for case in cases_with_accounts(cases):
        if case["metrics"][key] is not None:
            spreads.setdefault(case["component"], []).append(case["metrics"][key])
    return spreads


def _percentiles(spreads: Sequence[Data], greatest: str, format_spec: str) -> str:
    """Median, 95th percentile and greatest, in s."""
    median, high = (
        _percentile_range(label, key, spreads, format_spec)
        for label, key in (("median", "p50"), ("95th percentile", "p95"))
    )
    return (
        f"{median}, {high}, {greatest} {max(spread['max'] for spread in spreads):{format_spec}} s"
    )


def _percentile_range(label: str, key: str, spreads: Sequence[Data], format_spec: str) -> str:
    """Percentiles of several cases do not add up: the text has the least and the greatest."""
    least, greatest = (
        f"{limit(spread[key] for spread in spreads):{format_spec}}" for limit in (min, max)
    )
    if least == greatest:
        return f"{label} {least} s"
    return f"{label} {least} to {greatest} s by case"


_LEARNS = "learns"
_OUTCOME_RANK = {status: rank for rank, status in enumerate(OBJECTIONABLE_OUTCOMES)}
NOTHING_SUPPORTED = (
    "A search that finds nothing supports no requirement: no rate follows from where it looked."
)


def outcome_rank(search: Data, outcome: Data) -> int:
    """Place of an outcome in a list that begins with the worst."""
    return _OUTCOME_RANK.get(outcome_status(search, outcome), len(_OUTCOME_RANK))


def simulations_text(search: Data) -> str:
    """Simulations that were run, of the budget: ``37 of 100 simulations``."""
    text = f"{search['simulations']} of {counted(search['budget'], 'simulation')}"
    if search["unknown"]:
        text += f", {search['unknown']} without an answer"
    if search["idle"]:
        text += f", {search['idle']} with an added fault that never came to act"
    if search["refused"]:
        text += f"; {counted(search['refused'], 'point')} refused"
    return text


def outcome_headline(search: Data, outcome: Data) -> str:
    """The outcome, the requirement, and what the outcome rests on."""
    status, requirement = outcome["word"], name(outcome["requirement"])
    counterexample = outcome["counterexample"]
    if counterexample is not None:
        repeats = counterexample["repeats"]
        by = f"at simulation {outcome['simulations']}, by {one_line(outcome['searcher'])}"
        if status == "falsified":
            again = f"confirmed by {counted(repeats['runs'], 'equal replay')}"
        else:
            runs = counted(repeats["runs"], "replay")
            again = f"and in {repeats['violated']} of {runs}, {repeats['equal']} of them equal"
        return f"{status}: {requirement} violated {by}; {again}"
    least = "none measured" if outcome["best"] is None else f"{outcome['best']:.4g}"
    start = f"{requirement}: " if status == "nothing found" else f"{status}: {requirement}: "
    return (
        f"{start}nothing found in {counted(search['simulations'], 'simulation')}: "
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
    """Whether a search or a baseline violated it, so that its searchers are listed."""
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
    for searcher in search[kind]:
        first, best = searcher["first"].get(requirement), searcher["best"].get(requirement)
        shown = name(searcher["name"])
        if kind == "searchers" and not searcher["trivial"]:
            shown = f"{shown} ({_LEARNS})"
        cells = [str(searcher["simulations"]), "none" if first is None else str(first)]
        yield shown, [*cells, "-" if best is None else f"{best:.4g}"]


def counterexample_text(counterexample: Data, check: str) -> str:
    """Margin, time and reason of a counterexample; a reason that repeats the check is left out."""
    parts = [] if counterexample["margin"] is None else [f"margin {counterexample['margin']:.4g}"]
    if counterexample["time"] is not None:
        parts.append(f"at {counterexample['time']:.2f} s")
    detail = "" if counterexample["detail"] == check else one_line(counterexample["detail"], 300)
    return f"{' '.join(parts)}: {detail}" if parts and detail else " ".join(parts) or detail


def shrinking_text(counterexample: Data) -> str:
    """Result of shrinking; empty where none was requested."""
    shrinking = counterexample["shrinking"]
    if shrinking is None:
        return ""
    spent = counted(shrinking["simulations"], "simulation")
    limit = "" if shrinking["finished"] else f", all of {shrinking['budget']} that it was allowed"
    before, after = shrinking["before"], shrinking["after"]
    return f"from {before} to {after} parameters that differ ({spent}{limit})"


def parameter_changes(counterexample: Data, most: int) -> Sequence[tuple[str, str]]:
    """Path and change of each parameter: ``world.wall``, ``2 instead of 4``."""
    return [
        (name(change["path"]), _parameter_change(change))
        for change in counterexample["changes"][:most]
    ]


def _parameter_change(change: Data) -> str:
    if change["value"] is None:
        return "left out"
    if change["nominal"] is None:
        return f"{_value_text(change['value'])}, added"
    return f"{_value_text(change['value'])} instead of {_value_text(change['nominal'])}"


def _value_text(value: Any) -> str:
    """A value on one line, such as ``{type: delay, target: lidar}``."""
    if value is None:
        return "nothing"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Mapping):
        return (
            "{"
            + ", ".join(
                f"{name(str(key))}: {_value_text(element)}" for key, element in value.items()
            )
            + "}"
        )
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_value_text, value)) + "]"
    return one_line(str(value), 120)


def counted(number: int, noun: str) -> str:
    """``1 run``, ``2 runs``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
