"""The optional extra ``llm``: its packages are imported at first use."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from pytest_dura.core.errors import ConfigurationError


def imported(name: str) -> Any:
    """A module of a package that the extra ``llm`` installs.

    Raises:
        ConfigurationError: If it is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise ConfigurationError(
            f"a language model needs the package {name.partition('.')[0]!r}: {error}",
            remedy="pip install 'pytest-dura[llm]'",
        ) from None
