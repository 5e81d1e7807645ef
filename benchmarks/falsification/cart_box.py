"""A cart with a motor and drag as a black box of 1,000 samples, alone and in batches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from falsification.systems import Floats
from pytest_dura import BlackBox, Input, InputCurve


def carts(time: Floats, inputs: Sequence[Mapping[str, InputCurve]]) -> list[dict[str, Floats]]:
    """Positions and speeds of many carts, by explicit Euler steps."""
    force = np.array([each["force"](time) for each in inputs])
    x, v = np.zeros(len(inputs)), np.zeros(len(inputs))
    seen = []
    for step, push in zip(np.diff(time, prepend=0.0), force.T, strict=True):
        x, v = x + step * v, v + step * (push - 0.2 * v)
        seen.append((x, v))
    places, speeds = np.array(seen).transpose(1, 2, 0)
    return [{"x": place, "v": speed} for place, speed in zip(places, speeds, strict=True)]


def cart(time: Floats, inputs: Mapping[str, InputCurve]) -> dict[str, Floats]:
    """Position and speed of one."""
    return carts(time, [inputs])[0]


INPUTS = [Input("force", -1.0, 1.0, pieces=20)]
CART = BlackBox(cart, INPUTS, ["x", "v"])
CARTS = BlackBox(cart, INPUTS, ["x", "v"], simulate_many=carts)
