"""A real Dask scheduler and real worker processes, on loopback, ended by their numbers."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import psutil
from distributed import Client
from free_ports import free_port


class Cluster:
    """A scheduler, and workers as they are started.

    Args:
        folder: Where their logs go, and where they work.
        settings: Of the scheduler, as environment variables.
    """

    def __init__(self, folder: Path, settings: Mapping[str, str] | None = None) -> None:
        self._folder = folder
        self._started: list[subprocess.Popen[bytes]] = []
        self._workers: list[subprocess.Popen[bytes]] = []
        self.port = free_port()
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.scheduler = self._start(
            "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(self.port),
            environment=settings,
        )  # fmt: skip

        self._listens()

    def _listens(self) -> None:
        """Wait for the scheduler, which is slow to start on a machine that does much else."""
        end = time.monotonic() + 60.0
        while self.scheduler.poll() is None and time.monotonic() < end:
            with socket.socket() as tried:
                if tried.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            time.sleep(0.05)
        self.close()
        raise RuntimeError("the scheduler did not start")

    def worker(self, environment: Mapping[str, str] | None = None) -> subprocess.Popen[bytes]:
        """One more worker process, without a nanny that would start it again."""
        worker = self._start(
            "distributed.cli.dask_worker",
            *(self.address, "--host", "127.0.0.1", "--nthreads", "1", "--no-nanny"),
            *("--memory-limit", "0", "--local-directory", str(self._folder)),
            environment=environment or {},
        )
        self._workers.append(worker)
        return worker

    def keep(self, count: int) -> list[subprocess.Popen[bytes]]:
        """Start or kill workers until this many are alive and the scheduler knows no other."""
        self._workers = [worker for worker in self._workers if worker.poll() is None]
        while len(self._workers) > count:
            self.kill(self._workers.pop())
        while len(self._workers) < count:
            self.worker()
        end = time.monotonic() + 60.0
        with Client(self.address, set_as_default=False) as client:
            while len(client.nthreads()) != count:
                assert time.monotonic() < end, f"the cluster has {client.nthreads()}"
                time.sleep(0.02)
        return list(self._workers)

    def _start(
        self, module: str, *options: str, environment: Mapping[str, str] | None = None
    ) -> subprocess.Popen[bytes]:
        log = self._folder / f"{module}.{len(self._started)}.log"
        kept = {name: one for name, one in os.environ.items() if not name.startswith("PYTEST")}
        with log.open("wb") as opened:
            process = subprocess.Popen(
                [sys.executable, "-m", module, *options, "--no-dashboard"],
                cwd=self._folder,
                env={**kept, **(environment or {})},
                stdout=opened,
                stderr=opened,
            )
        self._started.append(process)
        return process

    def kill(self, process: subprocess.Popen[bytes]) -> None:
        """End a process as the kernel does when there is no memory left."""
        process.send_signal(signal.SIGKILL)
        process.wait()

    def close(self) -> None:
        """End all of them."""
        for process in self._started:
            process.kill()
            process.wait()


def children_of(process: subprocess.Popen[bytes]) -> list[int]:
    """The numbers of the processes that a process has started, as far as they are alive."""
    found = psutil.Process(process.pid).children()
    return [one.pid for one in found if one.status() != psutil.STATUS_ZOMBIE]
