"""Where evidence is, where things go that are made from it, and where code may come from."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from pytest_dura.plugin.declared_options import DEFAULT_EVIDENCE

if TYPE_CHECKING:
    import pytest


def beside(evidence: Path, what: str) -> Path:
    """A directory of its own beside the evidence, whose manifest lists all that is in it.

    Args:
        evidence: The evidence directory.
        what: Follows its name, as in ``dura-evidence-replay``.
    """
    place = evidence.resolve()
    return place.with_name(f"{place.name}-{what}")


def from_here(file: Path, here: Path) -> str:
    """The path of a file as the user would type it.

    Args:
        file: The file, or folder.
        here: The directory in which pytest was started.
    """
    try:
        return os.path.relpath(file, here)
    except ValueError:  # it is on another drive of Windows
        return str(file)


def use_code_places(config: pytest.Config) -> None:
    """Let files and records name code of the project, and none that lies beside a stranger's files.

    Strange are a bundle that is replayed or reduced, and files outside of pytest's root directory
    that the command line names. What was in force before comes back when the session ends.

    Args:
        config: Of the session.
    """
    from pytest_dura.core.trust import Places, use_places

    get, here = config.getoption, config.invocation_params.dir
    files = [here / path for path in get("dura_path")]
    files += [here / one for one in get("dura_faults") if one.endswith((".yaml", ".yml"))]
    foreign = [path if path.is_dir() else path.parent for path in files]
    foreign = [
        one for one in foreign if not one.resolve().is_relative_to(config.rootpath.resolve())
    ]
    if get("dura_replay") is not None or get("dura_reduce") is not None:
        given = get("dura_evidence")
        foreign.append(here / given if given else config.rootpath / DEFAULT_EVIDENCE)
    places = Places.of([config.rootpath], [] if get("dura_trust_code") else foreign)
    before = use_places(places)

    def restore() -> None:
        use_places(before)

    config.add_cleanup(restore)
