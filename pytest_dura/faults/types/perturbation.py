"""Perturbation of a picture by any function, such as a gradient-based attack."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, field_validator

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.faults.model import FaultEffect, Kind, Moment
from pytest_dura.faults.parts import FaultPart
from pytest_dura.faults.types.image import Picture, as_picture, picture_description


class PerturbationParameters(FaultPart):
    """Function that perturbs the picture, and its arguments."""

    function: str = Field(
        description="`package.module:name` of a function of a picture, a numpy Generator and the"
        " `params`, which returns the new picture."
    )
    params: dict[str, Any] = Field(
        {}, description="Its further arguments by name, in the units that it says."
    )

    @field_validator("function")
    @classmethod
    def _importable(cls, path: str) -> str:
        try:
            RoleSpec(path).function()
        except ConfigurationError as error:
            raise ValueError(error.problem) from error
        return path


class Perturbation(FaultEffect):
    """Any perturbation as ``function(image, rng, **params)``, such as a gradient-based attack.

    It gets a copy of the picture, ``uint8`` of shape (height, width, 3), that it may write on, and
    all its random numbers from ``rng``. It returns a picture of the same shape and dtype;
    anything else is an error that names it. It is called at every tick, read or not, so that its
    failures are not laid at the door of the component that reads the picture.
    """

    parameters: PerturbationParameters

    acts_on: ClassVar[Kind] = "image"
    typical: ClassVar[Mapping[str, Any]] = {
        "function": f"{__name__}:gaussian_noise",
        "params": {"sigma": 25.0},
    }

    def apply(self, memory: Any, value: Any, moment: Moment) -> Picture:  # noqa: ARG002 - as FaultEffect has it
        """Return the perturbed picture.

        Raises:
            ConfigurationError: If that is no picture of the same shape.
        """
        image, path = as_picture(value), self.parameters.function
        new: Any = RoleSpec(path).function()(image.copy(), moment.rng, **self.parameters.params)
        same_kind = isinstance(new, np.ndarray) and new.dtype == image.dtype
        if not same_kind or new.shape != image.shape:
            raise ConfigurationError(
                f"the perturbation {path} returned no picture like the one it got",
                key="parameters.function",
                found=picture_description(new),
                expected=picture_description(image),
                remedy="return an array of the same shape and dtype",
            )
        if np.array_equal(new, image):
            return value  # type: ignore[no-any-return]  # lazy or not, nothing was changed
        new = new.copy()
        new.flags.writeable = False
        return new  # type: ignore[no-any-return]


def gaussian_noise(image: Picture, rng: np.random.Generator, sigma: float) -> Picture:
    """Gaussian noise on each channel of each pixel, ``sigma`` in levels of 256; clipped."""
    noisy = image + rng.normal(0.0, sigma, image.shape)
    return np.clip(np.rint(noisy), 0.0, 255.0).astype(np.uint8)
