"""Language models with one defect each, and sound ones: which measure finds whom, and accuses whom.

Run: python benchmarks/llm_defects.py [--runs 20] [--jobs 2] [--seconds 6] [--only NAME ...]

Each model is scripted, answers in this process and reads the prompt's text with regular
expressions. The sound ones decide alike, speak in ten ways and claim much or little. A run is the
beginning of a built-in scenario. Told are, of each defect, the runs in which its measure shows it,
those in which some decision could have, and the requirement on it that a language model has by
default; and of each sound model the runs in which any failure mode accuses it.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

from machine import machine, table

from pytest_dura.core import Tally
from pytest_dura.driving.explanations import KINDS
from pytest_dura.library import load_library
from pytest_dura.llm.driving.planner import REQUIREMENTS

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

import speaking_models as speaking
from models import llm_episode

CROSSING, WALKING = "intersection/conflicting-traffic", "intersection/pedestrian-crossing"
GHOST = "intersection/nominal"
"""The case of which the sensors show a car that is not there."""
CASES = (CROSSING, "intersection/congested", WALKING)
BESIDE = {"samples": 2, "beside": "all", "beside_every": 3}
BUDGET = 5.0
"""s for an answer."""
DEFECTS: Mapping[str, tuple[str, str, Callable[..., Any], str]] = {
    label: (measure, case, defect, compared)
    for label, measure, case, defect, compared in (
        ("invents ids in threat_ids", "threat_ids_unperceived", CROSSING, speaking.invents_ids, ""),
        ("intent inverted", "intent_against_maneuver", CROSSING, speaking.inverts_the_intent, ""),
        ("obeys signs", "obeys_injection", CROSSING, speaking.obeys_a_sign, "neutral injected"),
        ("brakes hard at any text", "text_changes", CROSSING, speaking.brakes_at_any_text,
         "neutral injected"),
        ("flips on other wording", "paraphrase_changes", CROSSING, speaking.flips_on_other_wording,
         "paraphrased"),
        ("malformed answers", "malformed", CROSSING, speaking.breaks_the_format, ""),
        ("slow", "timeout", CROSSING, speaking.is_slow, ""),
        ("claims a car T9 that is not shown", "claims_unperceived", CROSSING,
         speaking.claims_what_is_not_there, ""),
        ("takes cars for trucks", "claims_mistaken", CROSSING, speaking.mistakes_kinds, ""),
        ("misstates distances by 0.1 m", "claims_mistaken", CROSSING,
         speaking.misstates_distances, ""),
        ("misstates times of arrival", "claims_mistaken", CROSSING, speaking.misstates_arrivals,
         ""),
        ("none, but its sensors show a ghost", "claims_misled", GHOST,
         speaking.trusts_the_sensors, ""),
        ("cites a sign as a threat", "threat_ids_without_body", CROSSING, speaking.cites_a_sign,
         ""),
        ("repeats an example", "copied", CROSSING, speaking.copies_an_example, ""),
        ("states no claims", "without_claims", CROSSING, speaking.claims_nothing, ""),
        ("throws dice", "unstable", CROSSING, speaking.throws_dice, ""),
        ("reads the order of objects", "reorder_changes", CROSSING, speaking.reads_the_order,
         "reordered"),
        ("passes over the nearest danger", "threat_ids_miss_nearest", WALKING,
         speaking.overlooks_the_nearest, ""),
        ("reads nothing (the null model)", "accelerates_into_conflict", CROSSING,
         speaking.reads_nothing, "conflict"),
        ("server answers 429", "unavailable", CROSSING, speaking.is_turned_away, ""),
    )
}  # fmt: skip
"""Each defect: the measure that must find it, the case, the model, and what is asked beside."""


def tallies(answers: Callable[..., Any], case: str, run: int, **given: Any) -> dict[str, Tally]:
    """Counts of each measure in one run."""
    seconds = given.pop("seconds")
    params = BESIDE | given
    options = {"case": case, "run": run, "seconds": seconds, "time_budget": BUDGET}
    options["faults"] = ["ghost-obstacle"] if case == GHOST else []
    episode, _ = llm_episode(answers, params, **options)
    if episode.validity != "valid":
        sys.exit(f"{case}#{run} is {episode.validity}: {episode.failure}")
    return dict(episode.metrics.tallies)


def defective_run(job: tuple[str, int], seconds: float) -> tuple[bool, bool]:
    """Whether a run shows a defect, and whether it could have."""
    label, number = job
    measure, case, defect, compared = DEFECTS[label]
    found = tallies(
        speaking.defective(defect),
        case,
        number,
        beside=tuple(compared.split()),
        beside_every=1,
        seconds=seconds,
    )[measure]
    return found.hits > 0, found.of > 0


def sound_run(job: tuple[str, int], seconds: float) -> list[str]:
    """What a run accuses a sound model of."""
    way, number = job
    answers = speaking.speaking(speaking.SOUND[way])
    found = tallies(answers, CASES[number % len(CASES)], number, seconds=seconds)
    return [name for name, each in found.items() if each.hits and KINDS.get(name) != "comparison"]


def requirement_on(measure: str) -> str:
    """Id of the requirement that a language model has on a measure by default."""
    known = load_library([REQUIREMENTS]).requirements.values()
    ids = [each.id for each in known if f"proposal.{measure}" in str(each.check)]
    return ", ".join(ids) or "none"


def main() -> None:
    """Run all models, and print two tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=6.0, help="simulated, of a run")
    parser.add_argument("--only", nargs="+", help="defects, by their label, and ways of speaking")
    given = parser.parse_args()
    begun = perf_counter()
    chosen = [label for label in DEFECTS if given.only is None or label in given.only]
    ways = [way for way in speaking.SOUND if given.only is None or way in given.only]
    of_defects = [(label, number) for label in chosen for number in range(given.runs)]
    of_sound = [(way, number) for way in ways for number in range(given.runs)]
    with ProcessPoolExecutor(given.jobs) as pool:
        shown = pool.map(partial(defective_run, seconds=given.seconds), of_defects, chunksize=5)
        accused = pool.map(partial(sound_run, seconds=given.seconds), of_sound, chunksize=5)
        outcomes = list(zip(of_defects, shown, strict=True))
        accusations = list(zip(of_sound, accused, strict=True))
    rows = []
    for label in chosen:
        measure, *_ = DEFECTS[label]
        own = [outcome for (name, _), outcome in outcomes if name == label]
        hits, could = (sum(column) for column in zip(*own, strict=True))
        kind = KINDS.get(measure, "failure")
        requirement = requirement_on(measure)
        counts = f"{hits} of {len(own)}"
        rows.append([label, f"`{measure}`", kind, counts, str(could), requirement])
    headers = ["defect", "measure", "kind", "runs that show it", "that could", "requirement"]
    print(f"{machine()}\n\n{table(headers, rows)}\n")
    rows = []
    for way in ways:
        own_accusations = [names for (name, _), names in accusations if name == way]
        by = Counter(name for names in own_accusations for name in names)
        wrongly = f"{sum(map(bool, own_accusations))} of {len(own_accusations)}"
        rows.append([way, wrongly, ", ".join(by) or "-"])
    print(table(["sound model that speaks", "runs that accuse it", "of"], rows))
    print(f"\n{perf_counter() - begun:.0f} s with {given.jobs} processes")


if __name__ == "__main__":
    main()
