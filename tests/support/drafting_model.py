"""A scripted model that drafts requirements: what it answers in each round, over a real wire.

As a script it shows what becomes of its drafts on two scenarios, for docs/how-to/draft.md; with
``--role safety_monitor -o draft_role.py`` of its drafts of a monitor.
"""

from __future__ import annotations

import json
import sys

from scripted_server import ScriptedServer, answers_by

HEADWAY = "always (speed > 5 and time_headway < 10 implies time_headway >= 2)"


def draft(check, *bounds, name="HEADWAY-1", **changed):
    """A draft as a model answers it; bounds are ``(signal, value, unit)``."""
    return {
        "reason": "Two seconds cover the time to respond and to brake on a dry road.",
        "id": name,
        "text": "The ego keeps 2 s to its leader.",
        "kind": "safety",
        "bounds": [dict(zip(("signal", "value", "unit"), each, strict=True)) for each in bounds],
        "check": check,
        **changed,
    }


def drafting(*rounds, **options):
    """A server whose model answers these lists of drafts one after the other, then the last.

    A text is answered as it is, and a mapping, such as a draft of a role, as an object.
    """
    left = list(rounds)

    def answer(request):
        if "for tests of a cyber-physical system" not in request.prompt:  # a probe
            return "{}"
        drafts = left.pop(0) if len(left) > 1 else left[0]
        if isinstance(drafts, str):
            return drafts
        return json.dumps(drafts if isinstance(drafts, dict) else {"requirements": drafts})

    return ScriptedServer(otherwise=answers_by(answer), **options)


def role(code, reason="As the sentence asks."):
    """A draft of a role as a model answers it."""
    return {"reason": reason, "lines": code.splitlines()}


TIME_GAP = '''\
import math

from pytest_dura import Assessed, Assessment, RoleView, SafetyMonitor


class TimeGap(SafetyMonitor):
    """Refuses to go on while what is ahead would be reached within some seconds."""

    def __init__(self, seconds: float = 2.0):
        self.seconds = seconds

    def run(self, view: RoleView) -> Assessment:
        me = view.percept["localisation"]
        speed = max(view.percept["odometry"].speed, 0.1)
        nearest = math.inf
        for body in view.percept["objects"]:
            along = (body.x - me.x) * math.cos(me.heading) + (body.y - me.y) * math.sin(me.heading)
            aside = (body.y - me.y) * math.cos(me.heading) - (body.x - me.x) * math.sin(me.heading)
            if along > 0 and abs(aside) < 2.0:
                nearest = min(nearest, along - 5.0)
        margin = min(nearest / speed, 10.0) - self.seconds
        if margin < 0:
            return Assessment(Assessed.UNSAFE, margin, (f"{-margin:.1f} s are missing",))
        return Assessment(Assessed.SAFE, margin)
'''

FIRST = (
    draft(HEADWAY, ("time_headway", 2, "s"), ("time_headway", 10, "s"), ("speed", 5, "m/s")),
    draft("always (headway >= 2)", ("headway", 2, "s"), name="HEADWAY-2"),
    draft("always (time_headway >= 2)", ("time_headway", 2, "m"), name="HEADWAY-3"),
    draft(
        "always (speed > 40 implies time_headway >= 2)",
        ("speed", 40, "m/s"), ("time_headway", 2, "s"), name="HEADWAY-4",
    ),
    draft("always (leader_gap > -1)", ("leader_gap", -1, "m"), name="GAP-1"),
)  # fmt: skip
SECOND = (
    draft(
        "always (time_headway < 2 implies eventually[0, 4] (time_headway >= 2))",
        ("time_headway", 2, "s"), name="HEADWAY-5",
        text="The ego restores 2 s to its leader within 4 s.",
    ),
)  # fmt: skip


def show(*arguments):
    """Let the command draft, a monitor with `--role`, and return its exit code."""
    from pytest_dura.__main__ import main

    roles = role(TIME_GAP.replace("].speed", "].velocity")), role(TIME_GAP)
    rounds = roles if any(each.startswith("--role") for each in arguments) else (FIRST, SECOND)
    with drafting(*rounds, at_most=600) as server:
        return main([
            "draft", "--domain=driving", "The ego keeps 2 s to the leader on dry roads",
            f"--llm={server.base_url}/{server.model}", "--rounds=2",
            "--scenario=intersection/sudden/leader-brakes", "--scenario=intersection/congested",
            *arguments,
        ])  # fmt: skip


if __name__ == "__main__":
    sys.exit(show(*sys.argv[1:]))
