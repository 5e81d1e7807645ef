"""Perturbations of pictures, good and bad, for the fault ``perturbation``."""

from __future__ import annotations

from typing import Any

import numpy as np

NO_FUNCTION = 3


def shifted(image: Any, rng: np.random.Generator, level: int) -> Any:
    """Each level plus a number, modulo 256; written into the picture that it gets."""
    image += np.uint8(level)
    return image


def random_bits(image: Any, rng: np.random.Generator) -> Any:
    """Any other picture."""
    return rng.integers(0, 256, image.shape, dtype=np.uint8)


def cropped(image: Any, rng: np.random.Generator) -> Any:
    """Another shape."""
    return image[1:]


def as_floats(image: Any, rng: np.random.Generator) -> Any:
    """Another dtype."""
    return image / 255.0


def as_text(image: Any, rng: np.random.Generator) -> Any:
    """No picture at all."""
    return "picture"
