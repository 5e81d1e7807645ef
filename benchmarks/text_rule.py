"""A rule that reads nothing but the prompt's text drives the built-in scenarios, in each wording.

Run: python benchmarks/text_rule.py [--runs 15] [--jobs 2] [--seed 0] [--every 10 1]

What a language model could know it has from the text; so a rule of a page that parses the text with
regular expressions shows whether the text is enough to drive on. It takes the place of the server
and answers like a model. Told are, by wording and ticks between two decisions, runs with a flag,
collisions and clearance, and of all flagged ticks: the monitor's reason, and whether the decision
was made at that tick or was being held. Recovery is on, as in the scenarios.

The rule drives in two manners. ``keen`` asks of a maneuver only that the car can still stop when
the next decision comes, and disregards what radar contradicts. ``calm`` believes lidar, and takes
no maneuver that would touch somebody if it were kept for two seconds more: what the safety monitor
asks of each tick.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import mean, stdev
from typing import Any

import numpy as np
from machine import machine, table

from pytest_dura.core import RoleSpec
from pytest_dura.execution import run_episode
from pytest_dura.library import expand_cases, load_library
from pytest_dura.llm import Answer, Request, session
from pytest_dura.llm.driving.planner import TEMPLATES

PLANNER = "pytest_dura.llm.driving.planner:LlmPlanner"
WORDINGS = ("own", "paraphrased")
NUMBER = r"-?[\d.]+"
TAG = r"(?:<perceived_text>)?(?P<id>[\w-]+)(?:</perceived_text>)?"


def _pattern(*lines: str) -> re.Pattern[str]:
    """Either line, with ``NAME`` for a number of that name, the names in capitals."""
    names: set[str] = set()

    def group(found: re.Match[str]) -> str:
        name = found[0].lower()
        if name in names:
            return f"(?P<{name}_>{NUMBER})"
        names.add(name)
        return f"(?P<{name}>{NUMBER})"

    return re.compile("|".join(re.sub(r"[A-Z_]{4,}", group, line) for line in lines), re.MULTILINE)


SPEED = _pattern(r"^EGO: speed SPEED, stops", r"^EGO: you drive at SPEED m/s,")
LINE = _pattern(r"; LINE before the stop line", r"stop line is LINE m in front of you")
CLEAR = _pattern(r"clear of the junction in CLEAR s", r"have left the junction in CLEAR s")
GIVING_WAY = _pattern(
    r"now wait is WAIT and yield YIELD m/s2", r"wait means WAIT m/s2 and yield YIELD m/s2"
)
CONFLICT = (
    re.compile(
        rf"^{TAG},(?P<at>{NUMBER}),(?P<along>{NUMBER}),(?P<comes>{NUMBER}),(?P<leaves>{NUMBER})"
        rf",(?P<you_come>{NUMBER}),(?P<you_leave>{NUMBER})$",
        re.MULTILINE,
    ),
    re.compile(
        rf"^{TAG}: (?P<at>{NUMBER}) m ahead of your front, (?P<along>{NUMBER}) m/s along your lane,"
        rf" there from (?P<comes>{NUMBER}) s to (?P<leaves>{NUMBER}) s from now; you, accelerating,"
        rf" from (?P<you_come>{NUMBER}) s to (?P<you_leave>{NUMBER}) s$",
        re.MULTILINE,
    ),
)
WALKER = re.compile(rf"^{TAG}(?:,|: )pedestrian,.*$", re.MULTILINE)
UNSEEN = re.compile(rf"^{TAG}(?:,|: )(?:car|pedestrian|obstacle),.*(?:,|: )no$", re.MULTILINE)
SEEN = re.compile(rf"^{TAG}(?:,|: )(?:car|pedestrian|obstacle),.*(?:,|: )yes$", re.MULTILINE)
ALONE = re.compile(rf"^(?P<id>R\d+)(?:,|: )(?P<range>{NUMBER})", re.MULTILINE)
DRIVES = re.compile(
    rf"^[-*] (?P<name>\w+)(?:: | means: )drive at (?P<target>{NUMBER}) m/s, speeding up by at most "
    rf"(?P<gain>{NUMBER}) m/s2, slowing down by at most (?P<brake>{NUMBER})$",
    re.MULTILINE,
)
HOLDS = re.compile(rf"(?:holds|is done) for (?P<hold>{NUMBER}) s")
BRAKING = re.compile(rf"brakes (?:by|with) (?P<braking>{NUMBER})")

REACTION = 0.3
"""s that the rule keeps to a leader on top of what braking needs."""
MARGIN = 0.8
"""s between its time on a place and another's."""
COMMITTED = 0.5
"""s after the decision's hold, for which the rule must still be able to stop before the line."""
OUTLOOK = 2.0
"""s that the calm rule looks beyond the decision's hold, as the safety monitor does."""
MANNERS = ("keen", "calm")
STEP = 0.1
"""s."""


@dataclass(frozen=True)
class Text:
    """What the rule reads."""

    speed: float
    line: float
    clear: float
    giving_way: Mapping[str, float]
    conflicts: tuple[Mapping[str, Any], ...]
    walkers: frozenset[str]
    doubted: frozenset[str]
    drives: Mapping[str, tuple[float, float, float]]
    hold: float
    braking: float


def _number(pattern: re.Pattern[str], text: str, otherwise: float) -> float:
    found = pattern.search(text)
    return otherwise if found is None else float(next(filter(None, found.groups())))


def read(system: str, text: str) -> Text:
    """Read a prompt of either wording.

    Args:
        system: The system's message.
        text: The user's.
    """
    rows = [
        {key: value if key == "id" else float(value) for key, value in found.groupdict().items()}
        for pattern in CONFLICT
        for found in pattern.finditer(text)
    ]
    giving_way = GIVING_WAY.search(text)
    known = [] if giving_way is None else [float(value) for value in giving_way.groups() if value]
    unseen = {found["id"] for found in UNSEEN.finditer(text)}
    seen = {found["id"] for found in SEEN.finditer(text)}
    return Text(
        speed=_number(SPEED, text, 0.0),
        line=_number(LINE, text, -1.0),
        clear=_number(CLEAR, text, 0.0),
        giving_way=dict(zip(("wait", "yield"), known, strict=False)),
        conflicts=tuple(rows),
        walkers=frozenset(found["id"] for found in WALKER.finditer(text)),
        # Radar that sees nobody else is no witness.
        doubted=frozenset(unseen if len(seen) >= len(unseen) else ()),
        drives={
            found["name"]: (float(found["target"]), float(found["gain"]), float(found["brake"]))
            for found in DRIVES.finditer(system)
        },
        hold=_number(HOLDS, system, 1.0),
        braking=_number(BRAKING, system, 8.0),
    )


def _asked(maneuver: str, speed: float, read_: Text) -> float:
    """Acceleration in m/s2 of a maneuver at a speed, as the system's message has it."""
    if maneuver == "emergency_brake":
        return -read_.braking
    if maneuver in read_.drives:
        target, gain, brake = read_.drives[maneuver]
        return max(min(target - speed, gain), -brake)
    return read_.giving_way.get(maneuver, -3.0)


def _course(maneuver: str, read_: Text, more: float = 0.0) -> list[tuple[float, float, float]]:
    """Time, way and speed at each step while a decision is held, and for some seconds more."""
    time, way, speed, course = 0.0, 0.0, read_.speed, []
    while time < read_.hold + more + STEP / 2:
        course.append((time, way, speed))
        after = max(speed + _asked(maneuver, speed, read_) * STEP, 0.0)
        time, way, speed = time + STEP, way + (speed + after) / 2 * STEP, after
    return course


def _follows(course: list[tuple[float, float, float]], met: Mapping[str, Any], read_: Text) -> bool:
    """Whether the car can stop behind who is on its lane, at each step, should that one brake."""
    along = max(met["along"], 0.0)
    for time, way, speed in course:
        if time >= met["leaves"]:
            break
        if time < met["comes"] - MARGIN:
            continue
        room = met["at"] + along * time - way - 1.0
        needed = speed * REACTION + (speed**2 - along**2) / (2 * read_.braking)
        if speed > 0.1 and room < needed:
            return False
    return True


def _touches(course: list[tuple[float, float, float]], met: Mapping[str, Any]) -> bool:
    """Whether the front would be where somebody is on the lane, while that one is there."""
    return any(
        way > met["at"] + met["along"] * time - 1.5
        for time, way, speed in course
        if met["comes"] - REACTION <= time <= met["leaves"] + REACTION and speed > 0.1
    )


def _passes(met: Mapping[str, Any]) -> bool:
    """Whether the ego, accelerating, is past before another comes, or comes when it has left."""
    before = met["you_leave"] + MARGIN < met["comes"]
    return before or met["leaves"] + MARGIN < met["you_come"]


def decide(read_: Text, manner: str = "keen") -> tuple[str, list[str]]:
    """The quickest maneuver that is safe while it is held, and the ids of what forbids others."""
    crossing, ahead, calm = [], [], manner == "calm"
    for met in read_.conflicts:
        if met["id"] in read_.doubted and not calm:
            continue
        lasting = met["comes"] == 0.0 and met["leaves"] > met["you_come"]
        (ahead if lasting or met["id"] in read_.walkers else crossing).append(met)
    blocked = [met for met in crossing if met["comes"] < read_.clear + MARGIN or not _passes(met)]
    refusing: list[str] = []
    for maneuver in ("accelerate", "proceed", "proceed_cautiously", "wait", "yield"):
        course = _course(maneuver, read_)
        _, way, speed = _course(maneuver, read_, COMMITTED)[-1]
        against = [met for met in ahead if not _follows(course, met, read_)]
        before_line = read_.line > 0.0 and read_.speed**2 / (2 * read_.braking) < read_.line
        enters = way + speed**2 / (2 * read_.braking) > read_.line - 0.3
        if before_line and enters and maneuver not in ("wait", "yield"):
            against += blocked
        elif not before_line:
            against += [met for met in crossing if not _follows(course, met, read_)]
        if calm:
            longer = _course(maneuver, read_, OUTLOOK)
            against += [met for met in (*ahead, *crossing) if _touches(longer, met)]
        if not before_line and maneuver in ("wait", "yield"):
            continue
        if not against:
            return maneuver, refusing
        refusing += [met["id"] for met in against if met["id"] not in refusing]
    return "emergency_brake", refusing


class Rule:
    """The rule in the place of a server."""

    model, base_url = "text rule", "http://127.0.0.1:1/v1"

    def __init__(self, manner: str = "keen") -> None:
        self._manner = manner

    def ask(self, request: Request, _budget: float, _repeats: Any = None) -> Answer:
        """Answer like a model."""
        read_ = read(request.messages[0].text, request.messages[-1].text)
        maneuver, ids = decide(read_, self._manner)
        after = _course(maneuver, read_)[-1][2]
        changed = after - read_.speed
        answer = {
            "observations": f"{len(read_.conflicts)} may be on my lane.",
            "threat_ids": ids[:3],
            "reasoning": f"{maneuver} is the quickest that is safe for {read_.hold} s.",
            "intent": "hold" if abs(changed) < 0.3 else "speed_up" if changed > 0 else "slow_down",
            "maneuver": maneuver,
            "confidence": 100,
        }
        return Answer(json.dumps(answer), seconds=0.1)

    def probe(self) -> tuple[str, Mapping[str, Any]]:
        """A server that keeps to the schema, and sees nothing."""
        capabilities = {"structured": "json_schema", "enforced": True, "vision": False}
        return "text-rule", {**capabilities, "seed": True}

    def scrub(self, text: str) -> str:
        """There is no key."""
        return text


@dataclass(frozen=True)
class Outcome:
    """What the tables need of an episode."""

    flagged: bool
    collided: bool
    clearance: float | None
    reasons: Counter[tuple[str, str]]
    """Flagged ticks by the monitor's reason, and by whether the decision was new or held."""


REASONS = {
    "follows": "could not stop behind a leader",
    "comes within": "comes too near",
    "takes the right of way": "right of way",
}


def _reasons(episode: Any) -> Counter[tuple[str, str]]:
    counted: Counter[tuple[str, str]] = Counter()
    texts, accounts = episode.recording.reasons, episode.recording.accounts
    for verdict, reason, account in zip(episode.decisions["verdict"], texts, accounts, strict=True):
        if verdict == 2:
            names = [name for start, name in REASONS.items() if start in reason] or ["other"]
            counted[names[0], "new" if account.get("decided") else "held"] += 1
    return counted


Key = tuple[str, str, str, int, int]
"""Wording, manner, case, ticks between decisions, run."""


def templates_of(wording: str, folder: Path) -> Path | None:
    """A directory of templates that asks in this wording."""
    if wording == "own":
        return None
    return Path(shutil.copytree(TEMPLATES / wording, folder / wording, dirs_exist_ok=True))


def run(job: tuple[Key, int, str | None]) -> tuple[Key, Outcome]:
    """One episode."""
    (_, manner, name, every, number), seed, templates = job
    params = {"samples": 1, "beside": (), "decide_every": every, "templates": templates}
    (case,) = expand_cases(load_library([]).scenarios, select=[f"{name}*"])
    with session.using(session.ModelSession(environ={}, connect=lambda *_: Rule(manner))):
        spec = case.spec(number, seed, {"generator": RoleSpec(PLANNER, params)})
        episode = run_episode(spec, recorded=True)
    if episode.failure is not None:
        raise RuntimeError(episode.failure)
    cleared = episode.signals["cleared"] > 0.5
    return job[0], Outcome(
        flagged=episode.flagged,
        collided=episode.collided,
        clearance=float(episode.time[np.argmax(cleared)]) if cleared.any() else None,
        reasons=_reasons(episode),
    )


def _row(outcomes: list[Outcome]) -> list[str]:
    times = [each.clearance for each in outcomes if each.clearance is not None]
    spread = f"{mean(times):.1f} +- {stdev(times) if len(times) > 1 else math.nan:.1f}"
    return [
        str(len(outcomes)),
        f"{100 * mean(each.flagged for each in outcomes):.0f}",
        f"{100 * mean(each.collided for each in outcomes):.0f}",
        f"{spread} ({len(times)})" if times else "-",
    ]


def main() -> None:
    """Drive, count, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=int, nargs="+", default=[10, 1])
    parser.add_argument("--wording", nargs="+", default=WORDINGS, choices=WORDINGS)
    parser.add_argument("--manner", nargs="+", default=MANNERS, choices=MANNERS)
    given = parser.parse_args()
    cases = sorted(case.id for case in expand_cases(load_library([]).scenarios))
    with tempfile.TemporaryDirectory() as temporary, ProcessPoolExecutor(given.jobs) as pool:
        folders = {name: templates_of(name, Path(temporary)) for name in given.wording}
        jobs = [
            ((wording, manner, case, every, number), given.seed, folder and str(folder))
            for wording, folder in folders.items()
            for manner in given.manner
            for every in given.every
            for case in cases
            for number in range(given.runs)
        ]
        outcomes = dict(pool.map(run, jobs, chunksize=5))
    print(f"{machine()}\n")
    rows, why = [], []
    for arm in dict.fromkeys((key[0], key[1], key[3]) for key in outcomes):
        wording, manner, every = arm
        shown = [wording, manner, f"{every / 10:g}"]
        together = {key: each for key, each in outcomes.items() if (*key[:2], key[3]) == arm}
        rows += [
            [*shown, case, *_row([o for key, o in together.items() if key[2] == case])]
            for case in cases
        ]
        counted = sum((each.reasons for each in together.values()), Counter[tuple[str, str]]())
        why += [[*shown, *reason, str(count)] for reason, count in sorted(counted.items())]
    arm_headers = ["wording", "manner", "every s"]
    print(table([*arm_headers, "scenario", "n", "flag %", "coll %", "clearance s"], rows))
    print()
    print(table([*arm_headers, "reason of the flag", "decision", "ticks"], why))


if __name__ == "__main__":
    main()
