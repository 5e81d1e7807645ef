"""Client libraries of simulators, which are extras: imported when they are first used."""

from __future__ import annotations

import sys
from functools import cache
from importlib import import_module
from typing import Any

from pytest_dura.core.errors import ConfigurationError


@cache
def client_library(package: str, simulator: str, extra: str, *, versions: str = "") -> Any:
    """Return the client library of a simulator.

    Args:
        package: What is imported.
        simulator: What it is of, for the message.
        extra: The extra that has it.
        versions: The versions of Python that it is for, if not all.

    Raises:
        ConfigurationError: If it is not installed.
    """
    path = list(sys.path)
    try:
        return import_module(package)
    except ImportError as error:
        raise ConfigurationError(
            f"{simulator} cannot be used here: {error}",
            key="simulator",
            found=f"no {package}",
            expected=f"the package {package}{versions}",
            remedy=f"pip install 'pytest-dura[{extra}]'",
        ) from None
    finally:
        # AirSim's adds the working directory, from which files would be imported then.
        sys.path[:] = path
