"""Words of driving in a planner's prose: kinds of road users, units, and what it may say it does.

See :mod:`pytest_dura.llm.prose` for how they are read.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.llm.prompts import OBJECTS, Prompt
from pytest_dura.llm.prose import Unit, Vocabulary

WORDS = Vocabulary(
    kinds={
        "pedestrian": (
            "pedestrian", "person", "people", "walker", "man", "men", "woman", "women", "child",
            "children", "kid", "boy", "girl",
        ),
        "car": ("car", "sedan", "suv", "taxi"),
        "truck": ("truck", "lorry", "bus", "tram", "trailer", "train"),
        "bicycle": (
            "bicycle", "bike", "cyclist", "motorcycle", "motorbike", "motorcyclist", "scooter",
        ),
        "animal": ("animal", "dog", "cat", "deer", "horse", "cow"),
    },
    units=(
        Unit(("m", "metre", "metres", "meter", "meters"), 1.0,
             ("distance", "ahead", "left", "length", "width", "at"), within=2.0),
        Unit(("m/s", "mps", "metres per second", "meters per second"), 1.0,
             ("speed", "closing", "rate", "along"), within=1.0),
        Unit(("km/h", "kph", "kmh"), 1 / 3.6, ("speed", "closing", "rate", "along"), within=1.0),
    ),
    acts={
        "slower": (
            "brake", "slow down", "slow for", "decelerate", "reduce speed", "lower speed",
            "cut speed",
        ),
        "stop": ("stop", "halt", "wait", "yield", "give way", "hold back", "hold position"),
        "hold": ("keep speed", "hold speed", "maintain speed", "keep pace"),
        "faster": ("accelerate", "speed up", "increase speed", "go faster", "pick up speed"),
        "go": ("go", "proceed", "drive on", "continue", "cross", "enter", "move on"),
    },
    selves=("car", "vehicle"),
)  # fmt: skip
"""Nouns without a kind of their own, such as ``vehicle`` and ``obstacle``, may be said of any."""

_LONG = 6.0
"""m; cars are shorter, lorries and buses longer."""


def kinds_shown(prompt: Prompt) -> dict[str, frozenset[str] | None]:
    """Kinds that each object of a prompt may be called; ``None`` where it may be any.

    Sensors report sizes: what is as short as a pedestrian may be an animal, what is as long as a
    lorry may be one, and what is narrow may be anything. Signs are of no kind; of a bare radar
    return the kind is not known.
    """
    kinds: dict[str, frozenset[str] | None] = {}
    for block in prompt.blocks:
        for each in block.facts.get(OBJECTS, ()):
            name = str(each["id"])
            if block.name == "CONTROLS":
                kinds.setdefault(name, frozenset())
            elif "kind" in each:
                kinds[name] = _kinds_of(each)
            else:
                kinds.setdefault(name, None)
    return kinds


def _kinds_of(facts: Mapping[str, Any]) -> frozenset[str] | None:
    kind, length = facts.get("kind"), facts.get("length")
    if kind == "pedestrian":
        return frozenset({"pedestrian", "animal"})
    if kind != "car":
        return None
    is_long = isinstance(length, (int, float)) and length > _LONG
    return frozenset({"car", "truck"} if is_long else {"car"})
