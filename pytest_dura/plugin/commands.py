"""The commands that we print: to run the same again, and nothing else."""

from __future__ import annotations

import os
import shlex
from typing import TYPE_CHECKING

from pytest_dura.plugin.places import from_here

if TYPE_CHECKING:
    from pathlib import Path

    from pytest_dura.plugin.session import DuraSession


def replay_command(session: DuraSession, episode: str, evidence: Path | None = None) -> str:
    """The command that runs one episode of the evidence again, or of another evidence."""
    options = [f"--dura-replay={episode}"]
    if evidence is not None:
        here = session.config.invocation_params.dir
        options.append(f"--dura-evidence={from_here(evidence, here)}")
    else:
        given = session.options.given
        options += [f"{name}={value}" for name, value in given if name == "--dura-evidence"]
    options += session.models.replay_options()
    # The same arguments load the same conftest files, where a component may be defined.
    return _command(session, [*options, *_places(session)])


def rerun_command(session: DuraSession, item: str) -> str:
    """The command that runs one item again."""
    # Test functions name their faults themselves, and without scenario cases the option is refused.
    test = item.partition("::")[0].endswith(".py")
    given = [one for one in session.options.given if not (test and one[0] == "--dura-faults")]
    return _command(session, [item, *(f"{name}={value}" for name, value in given)])


def _places(session: DuraSession) -> list[str]:
    config = session.config
    if config.args_source is not config.ArgsSource.ARGS:
        return []
    here = config.invocation_params.dir
    paths = dict.fromkeys(argument.partition("::")[0] for argument in config.args)
    return [path for path in paths if os.path.lexists(here / path)]


def _command(session: DuraSession, arguments: list[str]) -> str:
    option = session.config.option
    setup = ["-c", option.inifilename] if option.inifilename else []
    if option.rootdir:
        setup.append(f"--rootdir={option.rootdir}")
    if option.dura_trust_code:
        setup.append("--dura-trust-code")
    return " ".join(["pytest", *map(_quoted, [*setup, *arguments])])


def _quoted(argument: str) -> str:
    """Quote the value alone, which reads better: ``--dura-replay='case#run'``."""
    name, equals, value = argument.partition("=")
    if argument.startswith("--") and equals:
        return f"{name}={shlex.quote(value)}"
    return shlex.quote(argument)
