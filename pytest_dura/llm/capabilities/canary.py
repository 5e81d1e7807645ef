"""Canary: a code in a picture that only a model which sees the picture can tell."""

from __future__ import annotations

import numpy as np

from pytest_dura.llm.extra import imported
from pytest_dura.llm.port import Image

CODE = "K7XM4R"
"""Six letters and digits of which none looks like another."""
QUESTION = (
    "A code of six letters and digits is written in the picture. Answer with the code alone. If"
    " there is no picture or you cannot see it, answer with the word NONE."
)
_SCALE, _MARGIN, _GAP = 8, 40, 3


def canary() -> Image:
    """The code in black on white, in the built-in bitmap font, the same pixels everywhere.

    Shape about ``(170, 500, 3)``. The enlarged bitmap does not depend on a font library's version.
    """
    pictures, draw = imported("PIL.Image"), imported("PIL.ImageDraw")
    font = imported("PIL.ImageFont").load_default_imagefont()
    letters = []
    for char in CODE:
        left, _, right, bottom = font.getbbox(char)
        letter = pictures.new("L", (right - left + _GAP, bottom), 255)
        draw.Draw(letter).text((-left, 0), char, fill=0, font=font)
        letters.append(np.asarray(letter))
    small = np.hstack(letters)
    ink = np.kron(small, np.ones((_SCALE, _SCALE), dtype=np.uint8))
    page = np.pad(ink, _MARGIN, constant_values=255)
    return Image("canary", np.repeat(page[:, :, None], 3, axis=2).astype(np.uint8))


def tells(text: str) -> bool:
    """Whether an answer holds the code, however its characters are set apart."""
    return CODE in "".join(char for char in text.upper() if char.isalnum())
