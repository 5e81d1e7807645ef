"""Pictures, ``uint8`` of shape (height, width, 3), that are brighter, noisy, patched, perturbed.

Pictures are made when they are read, and so are the changed ones.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.faults.model import FaultEffect, Kind, Moment
from pytest_dura.faults.parts import FaultPart, NotNegative, Share, Span, resolved
from pytest_dura.faults.types.base import change_lazily

Picture: TypeAlias = NDArray[np.uint8]
_ROUNDING = 1e-6
"""Pixels; rounding error of a product of floats."""
Level = Annotated[int, Field(ge=0, le=255)]


def as_picture(value: Any) -> Picture:
    """Return a value that is a picture, made now if it is lazy.

    Raises:
        ConfigurationError: If it is no picture.
    """
    picture: Any = resolved(value)
    if not (
        isinstance(picture, np.ndarray)
        and picture.dtype == np.uint8
        and picture.ndim == 3
        and picture.shape[2] == 3
    ):
        raise ConfigurationError(
            "this fault acts on a picture",
            key="target",
            found=picture_description(picture),
            expected="an array of dtype uint8 and shape (height, width, 3)",
            remedy="choose a camera's channel",
        )
    return picture


def picture_description(value: Any) -> str:
    """Describe an array by dtype and shape, anything else by its type."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} of shape {value.shape}"
    return type(value).__name__


class ImageFault(FaultEffect):
    """Base of the types that change a picture."""

    acts_on: ClassVar[Kind] = "image"

    def begin(self, value: Any, moment: Moment) -> bool:  # noqa: ARG002 - as FaultEffect has it
        """Check one picture now, lest a wrong one fail in the component that reads it."""
        as_picture(value)
        return True

    def apply(self, memory: Any, value: Any, moment: Moment) -> Any:  # noqa: ARG002 - as FaultEffect has it
        """Return the changed picture, made when it is read."""
        return value if self.has_no_effect else change_lazily(value, moment.rng, self._changed)

    def _changed(self, value: Any, rng: np.random.Generator) -> Picture:
        new = self.draw_on(as_picture(value).copy(), rng)
        new.flags.writeable = False
        return new

    @property
    @abstractmethod
    def has_no_effect(self) -> bool:
        """Whether its magnitude is zero."""

    @abstractmethod
    def draw_on(self, image: Picture, rng: np.random.Generator) -> Picture:
        """Change a picture, which is a copy to draw on, and return it or a new one."""


class BrightnessParameters(FaultPart):
    """Change of the brightness."""

    levels: Annotated[float, Field(ge=-255, le=255, allow_inf_nan=False), Span(-255.0, 255.0)] = (
        Field(
            80.0,
            description="Added to each channel of each pixel, in levels of 256; 0 adds nothing.",
        )
    )
    gain: Annotated[NotNegative, Span(0.0, 4.0, neutral=1.0)] = Field(
        1.0, description="Each channel is first multiplied by this, without unit; 1 is no change."
    )


class Brightness(ImageFault):
    """Over- or underexposure: each level times ``gain`` plus ``levels``, clipped to 0 to 255."""

    parameters: BrightnessParameters = BrightnessParameters()

    @property
    def has_no_effect(self) -> bool:
        """Nothing is added, and the gain is 1."""
        return self.parameters.levels == 0.0 and self.parameters.gain == 1.0

    def draw_on(self, image: Picture, rng: np.random.Generator) -> Picture:  # noqa: ARG002 - as ImageFault has it
        """Brighter or darker."""
        levels = image * self.parameters.gain + self.parameters.levels
        clipped: Picture = np.clip(np.rint(levels), 0.0, 255.0).astype(np.uint8)
        return clipped


class SaltAndPepperParameters(FaultPart):
    """Share of dead pixels."""

    share: Annotated[Share, Span(0.0, 1.0)] = Field(
        0.05, description="Of all pixels, drawn anew for each picture; 0 is the identity."
    )


class SaltAndPepper(ImageFault):
    """Dead pixels: a ``share`` of them is white or black, each as likely."""

    parameters: SaltAndPepperParameters = SaltAndPepperParameters()

    @property
    def has_no_effect(self) -> bool:
        """No pixel is hit."""
        return self.parameters.share == 0.0

    def draw_on(self, image: Picture, rng: np.random.Generator) -> Picture:
        """Set the dead pixels."""
        height, width, _ = image.shape
        count = math.ceil(self.parameters.share * height * width - _ROUNDING)
        hit = rng.choice(height * width, count, replace=False)
        image.reshape(-1, 3)[hit] = 255 * rng.integers(0, 2, (count, 1))
        return image


class PatchParameters(FaultPart):
    """Position, size and colour of the patch."""

    x: Annotated[Share, Span(0.0, 1.0, neutral=0.5)] = Field(
        0.5, description="Its centre, as a share of the width from the left."
    )
    y: Annotated[Share, Span(0.0, 1.0, neutral=0.5)] = Field(
        0.5, description="Its centre, as a share of the height from the top."
    )
    size: Annotated[Share, Span(0.0, 1.0)] = Field(
        0.25, description="Its side, as a share of the shorter side; 0 is the identity."
    )
    colour: Annotated[tuple[Level, Level, Level], Field(strict=False)] = Field(
        (255, 0, 255), description="Red, green and blue, in levels from 0 to 255."
    )


class Patch(ImageFault):
    """A square patch of one colour, cut off at the edges: dirt on the lens, or a sticker."""

    parameters: PatchParameters = PatchParameters()

    @property
    def has_no_effect(self) -> bool:
        """It has no size."""
        return self.parameters.size == 0.0

    def draw_on(self, image: Picture, rng: np.random.Generator) -> Picture:  # noqa: ARG002 - as ImageFault has it
        """Draw the patch."""
        height, width, _ = image.shape
        side = max(round(self.parameters.size * min(height, width)), 1)
        top = math.floor(self.parameters.y * (height - 1) + 0.5 - side / 2)
        left = math.floor(self.parameters.x * (width - 1) + 0.5 - side / 2)
        rows, columns = slice(max(top, 0), top + side), slice(max(left, 0), left + side)
        image[rows, columns] = self.parameters.colour
        return image
