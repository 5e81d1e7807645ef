"""RecordedLogs: logs that options and markers name, as scenarios of the session.

Every pytest run loads this module. What reads logs is imported where a session has some.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from pytest_dura.guests import Guest
from pytest_dura.logs.options import LogOptions
from pytest_dura.options import unusable

if TYPE_CHECKING:
    from pytest_dura.library.scenario import Scenario


class RecordedLogs(Guest):
    """Recorded logs of a session."""

    options = LogOptions
    marker_arguments: ClassVar[Mapping[str, Any]] = MappingProxyType(
        {"logs": None, "mapping": None}
    )

    def scenarios(self) -> Iterable[Scenario]:
        """Return the sets of logs of ``--dura-log``.

        Raises:
            ConfigurationError: For no logs, and a mapping that cannot be used.
        """
        if not self.given.globs:
            return ()
        from pytest_dura.logs.simulator import log_scenario

        return [log_scenario(glob, self.given.mapping) for glob in self.given.globs]

    def judging(self) -> Iterable[Path]:
        """Return the requirement files of the logs."""
        files: tuple[Path, ...] = self.given.judging
        return files

    def marked(self, given: Mapping[str, Any]) -> Iterable[Scenario] | None:
        """Return each set of logs of a marker, a path or a glob; faults play it to roles."""
        logs = given["logs"]
        if logs is None:
            return None
        from pytest_dura.logs.simulator import log_scenario

        globs = [logs] if isinstance(logs, str) else logs
        if (
            not isinstance(globs, Sequence)
            or not globs
            or not all(isinstance(g, str) for g in globs)
        ):
            raise unusable(
                "the marker dura cannot be used: wrong `logs`",
                key="pytest.mark.dura(logs=)",
                found=logs,
                expected="a path or a glob, or a list of them",
                remedy="correct `logs`",
            )
        played = given["faults"] is not None
        return [log_scenario(glob, given["mapping"], key="logs", played=played) for glob in globs]
