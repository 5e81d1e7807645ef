"""Client libraries of simulators, which are extras: imported when they are first used."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from pytest_dura.core.errors import ConfigurationError


def client_library(
    load: Callable[[], Any], package: str, simulator: str, extra: str, *, versions: str = ""
) -> Any:
    """Return the client library of a simulator.

    Args:
        load: Imports it, by name in the adapter's own module: the record has the versions of what
            this module imports.
        package: Its name.
        simulator: What it is of, for the message.
        extra: The extra that has it.
        versions: The versions of Python that it is for, if not all.

    Raises:
        ConfigurationError: If it is not installed.
    """
    path = list(sys.path)
    try:
        return load()
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
