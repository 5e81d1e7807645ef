"""Whether a recorded episode agrees with itself: inputs, faults, events and figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pytest_dura.core.metrics import FaultRecord
from pytest_dura.core.propagation import outcome_of
from pytest_dura.core.seeding import derive_seed

Data = Mapping[str, Any]


def episode_problems(episode: Data, case: Data, base_seed: int) -> Iterator[str]:
    """Everything in which an episode contradicts itself.

    Args:
        episode: Of the record.
        case: Its case.
        base_seed: From which the seeds of planned runs follow.
    """
    own = (*_inputs(episode, case, base_seed), *_metrics(episode), *_chains(episode))
    for problem in own:
        yield f"episode {episode['id']}: {problem}"


def _inputs(episode: Data, case: Data, base_seed: int) -> Iterator[str]:
    name, spec = episode["id"], episode["spec"]
    seed = derive_seed(base_seed, spec["scenario"]["name"], spec["run"])
    if episode["planned"] and episode["seed"] != seed:
        yield f"planned, and its seed is {episode['seed']}, not {seed} as that of its run"
    if name != f"{spec['case']}#{spec['run']}" or episode["case"] != spec["case"]:
        yield f"its spec is that of {spec['case']}#{spec['run']}"
    faults = [
        [(one["id"], one.get("type"), one.get("target")) for one in of["faults"]]
        for of in (case, spec)
    ]
    if spec["scenario"]["name"] != case["scenario"] or faults[0] != faults[1]:
        yield f"its spec has {spec['scenario']['name']} with {faults[1]}, and its case {faults[0]}"
    if episode["seed"] != spec["seed"]:
        yield f"seed {episode['seed']}, and {spec['seed']} in its spec"
    if (episode["validity"] == "missing") != (episode["failure"] is not None):
        yield f"{episode['validity']}, and its failure is {episode['failure']!r}"
    if (episode["validity"] == "invalid") != (
        episode["failure"] is None and episode["invalid_reason"] is not None
    ):
        yield f"{episode['validity']}, because {episode['invalid_reason']!r}"
    missing = {one["id"] for one in spec["faults"]} - {one["id"] for one in episode["faults"]}
    if missing:
        yield f"nothing is said of its faults {', '.join(sorted(missing))}"


def _metrics(episode: Data) -> Iterator[str]:
    """Whether what an episode measures agrees with its outcome, its faults and its events."""
    metrics, faults = episode["metrics"], episode["faults"]
    counts = {
        "planned": len(faults),
        "succeeded": sum(one["manifested_at"] is not None for one in faults),
        "detected": sum(one["detected_at"] is not None for one in faults),
        "recovered": sum(one["recovered_at"] is not None for one in faults),
        "impact_ticks": sum(one["flagged_ticks"] for one in faults),
    }
    if metrics["faults"] != counts:
        yield f"its faults are {metrics['faults']}, and they come to {counts}"
    for key in ("recoveries", "alerts"):
        if metrics[key] != episode["outcome"][key]:
            yield f"{metrics[key]} {key}, and {episode['outcome'][key]} in its outcome"
    if metrics["valid_proposals"] > metrics["proposals"]:
        yield "more valid proposals than there were"
    yield from _tallies(metrics, episode["outcome"]["switching"]["decisions"])
    oldest, lasted = (
        max(metrics["answer_ages"], default=0.0),
        episode["timings"]["simulated_seconds"],
    )
    if oldest > round(lasted, 9):  # as ages are
        yield f"a decision came into force {oldest} s after its percept, within {lasted} s"
    first: dict[str, float] = {}
    for event in episode["events"]:
        if event["kind"] == "fault_manifested":
            first.setdefault(event["subject"], event["time"])
    for one in faults:
        if one["manifested_at"] != first.get(one["id"]):
            yield (
                f"{one['id']} manifested at {one['manifested_at']} s, and its events "
                f"say {first.get(one['id'])}"
            )


def _chains(episode: Data) -> Iterator[str]:
    """Whether latencies and outcome of each fault follow from the rest of its chain."""
    alerts = {event["time"] for event in episode["events"] if event["kind"] == "alert"}
    for told in episode["faults"]:
        name = told["id"]
        fault = FaultRecord(**{key: told[key] for key in FaultRecord.__dataclass_fields__})
        for latency, seconds in fault.latencies().items():
            if told[latency] != seconds:
                yield f"{name}: {latency} is {told[latency]} s, and its times give {seconds}"
        detected, began = fault.detected_at, fault.began_at
        if detected is not None and (not fault.success or began is None or detected < began):
            yield f"{name}: detected at {detected} s, and no alert of then can answer it"
        elif detected is not None and detected not in alerts:
            yield f"{name}: detected at {detected} s, and its events say of no alert then"
        also = told["violated_without"]
        if extra := sorted({*(also or ())} - {*told["violated"]}):
            yield f"{name}: {extra[0]} is violated without it, and not with it"
        outcome = told["outcome"]
        missing = episode["failure"] is not None
        again = outcome_of(fault, told["propagation"], told["violated"], also, missing=missing)
        if outcome is None and told["violated"]:
            yield f"{name}: violated, and it has no outcome"
        if outcome not in (None, again):
            yield f"{name}: its outcome is {outcome!r}, and its chain gives {again!r}"


def _tallies(metrics: Data, decisions: int) -> Iterator[str]:
    """Whether no more was told than there were decisions to tell of."""
    for name, one in metrics["tallies"].items():
        for part, whole in (("hits", "of"), ("null_hits", "null_of")):
            if not one[part] <= one[whole] <= decisions:
                yield f"{one[part]} of {one[whole]} for {name} ({part}), in {decisions} decisions"
    for key, word in (("answer_seconds", "times"), ("answer_ages", "ages")):
        if len(metrics[key]) > decisions:
            yield f"the {word} of {len(metrics[key])} answers, in {decisions} decisions"
