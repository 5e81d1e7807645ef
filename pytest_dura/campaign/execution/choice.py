"""Which executor a user chose, and the execution that it comes to."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pytest_dura.core.errors import ConfigurationError

if TYPE_CHECKING:
    from pytest_dura.campaign.execution.executors import Execution

KEY = "--dura-executor"
MOST_SECONDS = 3600.0
"""What an episode may take in another process, beside the time that its component is given."""
Kind = Literal["in-process", "processes", "dask"]
_LAST_PORT = 65535


@dataclass(frozen=True)
class Choice:
    """Who is to simulate.

    Args:
        kind: In which way.
        count: How many processes; by default one for each core that may be used.
        address: Of Dask's scheduler.
        seconds: What an episode may take in another process, beside its component's time budgets.
    """

    kind: Kind = "in-process"
    count: int | None = None
    address: str | None = None
    seconds: float = MOST_SECONDS

    @classmethod
    def parse(cls, text: str | None) -> Choice:
        """From ``in-process``, ``processes``, ``processes:N`` or ``dask://HOST:PORT``.

        Raises:
            ConfigurationError: For anything else.
        """
        if text in (None, "in-process"):
            return cls()
        processes = re.fullmatch(r"processes(?::([1-9][0-9]{0,3}))?", text or "")
        if processes:
            return cls("processes", int(processes[1]) if processes[1] else None)
        dask = re.fullmatch(r"dask://(\[[0-9A-Fa-f:.]+\]|[^/:@?#\s]+):([0-9]{1,5})/?", text or "")
        if dask and 0 < int(dask[2]) <= _LAST_PORT:
            return cls("dask", address=f"tcp://{dask[1]}:{dask[2]}")
        raise ConfigurationError(
            "there is no such executor",
            key=KEY,
            found=text,
            expected="in-process, processes, processes:N with N of 1 to 9999, or dask://HOST:PORT",
            remedy=f"for example {KEY}=processes:4",
        )

    @property
    def processes(self) -> int | None:
        """How many processes of this machine simulate, if any do."""
        if self.kind != "processes":
            return None
        from pytest_dura.campaign.execution.processes import usable_cores

        return self.count or usable_cores()

    def knock(self) -> None:
        """Find out whether a cluster is there, without using it.

        Raises:
            ConfigurationError: If Dask is not installed, or nobody listens at the address.
        """
        if self.address is not None:
            from pytest_dura.campaign.execution.dask_cluster import knock

            knock(self.address)

    def execution(self) -> Execution:
        """What simulates; a cluster is connected to, and compared with this process.

        Raises:
            ConfigurationError: If the cluster cannot be used.
        """
        from pytest_dura.campaign.execution.executors import Execution

        if self.processes is not None:
            from pytest_dura.campaign.execution.processes import ProcessPool

            return Execution("processes", ProcessPool(self.processes), self.seconds)
        if self.address is not None:
            from pytest_dura.campaign.execution.dask import DaskExecutor

            return Execution("dask", DaskExecutor(self.address), self.seconds)
        return Execution()


def execution_of(text: str | None) -> Execution:
    """The execution that an option names; see :class:`Choice`.

    Raises:
        ConfigurationError: If there is no such executor, or it cannot be used.
    """
    return Choice.parse(text).execution()
