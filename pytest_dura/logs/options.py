"""Options of recorded logs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pytest_dura.options import (
    Option,
    OptionTable,
    Setting,
    as_given,
    existing_paths,
    texts,
    unusable,
)


def _beside_logs(read: Callable[[Setting], Any]) -> Callable[[Setting], Any]:
    """Make the reader of an option that does nothing without ``--dura-log``.

    Args:
        read: Reads its value.
    """

    def read_beside_logs(setting: Setting) -> Any:
        if setting.given and not setting.other("--dura-log"):
            raise unusable(
                f"{setting.key} is about recorded logs, and there are none without --dura-log",
                key=setting.key,
                found=setting.given,
                remedy="add --dura-log; files for scenarios go by --dura-path",
            )
        return read(setting)

    return read_beside_logs


class LogOptions(OptionTable):
    """Options of recorded logs."""

    title = "recorded logs as episodes that are not run"

    globs: Option[tuple[str, ...]] = Option(
        "--dura-log",
        "judge recorded logs, a path or a glob in quotes: each is an episode that is not run",
        texts,
        metavar="GLOB",
        repeatable=True,
        example="drives/*.mcap",
        details="See [recorded logs](logs.md).",
        activates=True,
        brings_cases=True,
        repeated_in=("rerun", "replay"),
        same_in_shards=False,
    )
    mapping: Option[str | None] = Option(
        "--dura-log-mapping",
        "mapping file of --dura-log: which topic and field is which signal",
        _beside_logs(as_given),
        metavar="FILE",
        example="mapping.yaml",
        repeated_in=("rerun", "replay"),
    )
    judging: Option[tuple[Path, ...]] = Option(
        "--dura-requirements",
        "requirement file whose requirements judge the logs of --dura-log",
        _beside_logs(existing_paths),
        metavar="FILE",
        repeatable=True,
        example="requirements.yaml",
        activates=True,
        repeated_in=("rerun", "replay"),
        same_in_shards=False,
    )
