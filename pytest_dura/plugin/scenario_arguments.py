"""Arguments of pytest that name scenario items, such as ``intersection/nominal::SAF-1``."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING

from pytest_dura.core.errors import ConfigurationError

if TYPE_CHECKING:
    from pytest_dura.plugin.session import DuraSession

Chosen = tuple[str, str]
"""A case and a requirement; "" stands for all of its requirements."""


def scenario_arguments(session: DuraSession) -> dict[str, Chosen]:
    """The arguments that name no file and a case, and what they choose.

    Raises:
        ConfigurationError: For an unknown requirement of a case, and scenarios that cannot be read.
    """
    config = session.config
    if config.args_source is not config.ArgsSource.ARGS:
        return {}
    found = {}
    for argument in config.args:
        path, _, requirement = argument.partition("::")
        if path.endswith(".py") or os.path.lexists(config.invocation_params.dir / path):
            continue
        name = _case_name(session, path)
        if name is not None:
            found[argument] = (name, _requirement_name(session, name, requirement))
    return found


def _case_name(session: DuraSession, path: str) -> str | None:
    """The case that an argument names which is no file, if there is such a case."""
    try:
        library = session.library()
    except ConfigurationError as error:
        if session.options.any_given:
            raise
        # Whoever misspelt a path should hear of the path, and whoever meant a scenario of it.
        raise ConfigurationError(
            f"file or directory not found: {path}\n"
            f"and it names no scenario as long as these cannot be read:\n{error}"
        ) from None
    # Terminal lines are relative to where pytest was started.
    absolute = os.path.normpath(session.config.invocation_params.dir / path)
    relative = os.path.relpath(absolute, session.config.rootpath).replace(os.sep, "/")
    for name in (path, relative):
        if re.split(r"[+~]", name, maxsplit=1)[0] in library.scenarios:
            return session.bench.case(name).id
    return None


def _requirement_name(session: DuraSession, name: str, requirement: str) -> str:
    known = session.bench.case(name).requirements
    if requirement and requirement not in known:
        from pytest_dura.campaign.problems import did_you_mean

        raise ConfigurationError(
            f"the case {name!r} has no requirement {requirement!r}",
            found=f"{name}::{requirement}",
            expected="one of " + ", ".join(known) if known else "a case with requirements",
            remedy=did_you_mean(requirement, known),
        )
    return requirement
