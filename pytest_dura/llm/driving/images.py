"""The block CAMERA, and the pictures that it tells of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura.llm.driving import readings
from pytest_dura.llm.port import Image

LARGEST = 1024
"""Pixels of a side."""

VIEWS: Mapping[str, str] = {
    "camera_front": "what is ahead, seen through your windscreen",
    "camera_third_person": "your own car, turquoise, and what is ahead, seen from behind and above",
}


def seen(
    percept: Mapping[str, Any], names: Sequence[str]
) -> tuple[tuple[Image, ...], dict[str, Any]]:
    """The pictures of some channels, and facts of the block CAMERA.

    A channel that is not there, or that holds no picture, is told as missing.

    Args:
        percept: Sensor channels by name.
        names: Camera channels, in the order in which their pictures are shown.
    """
    images, told = [], []
    for name in names:
        pixels = readings.picture(readings.channel(percept, name), LARGEST)
        if pixels is not None:
            images.append(Image(name, pixels))
        place = len(images) if pixels is not None else 0
        told.append({"name": name, "shown": place, "view": VIEWS.get(name, "")})
    return tuple(images), {"pictures": tuple(told)}
