"""A scripted model that drafts requirements: what it answers in each round, over a real wire.

As a script it shows what becomes of its drafts on two scenarios, for docs/how-to/draft.md.
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
    """A server whose model answers these lists of drafts one after the other, then the last."""
    left = list(rounds)

    def answer(request):
        if "requirements for tests" not in request.prompt:  # a probe
            return "{}"
        drafts = left.pop(0) if len(left) > 1 else left[0]
        return drafts if isinstance(drafts, str) else json.dumps({"requirements": drafts})

    return ScriptedServer(otherwise=answers_by(answer), **options)


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
    """Let the command draft, and return its exit code."""
    from pytest_dura.__main__ import main

    with drafting(FIRST, SECOND, at_most=600) as server:
        return main([
            "draft", "--domain=driving", "The ego keeps 2 s to the leader on dry roads",
            f"--llm={server.base_url}/{server.model}", "--rounds=2",
            "--scenario=intersection/sudden/leader-brakes", "--scenario=intersection/congested",
            *arguments,
        ])  # fmt: skip


if __name__ == "__main__":
    sys.exit(show(*sys.argv[1:]))
