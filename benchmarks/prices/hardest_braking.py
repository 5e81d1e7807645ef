"""Hardest braking: how hard the ego braked at worst."""

from __future__ import annotations

from pytest_dura.core.measures import Measure
from pytest_dura.driving.measures import peak_deceleration

HARDEST_BRAKING = Measure(
    "hardest_braking",
    heading="braking",
    meaning="greatest deceleration of the ego, over all runs",
    function=peak_deceleration,
    shown="mean",
    unit="m/s2",
    signals=("acceleration",),
)
