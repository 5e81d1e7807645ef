"""DaskExecutor: an executor on a Dask cluster, whose workers must be as this process is."""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable
from concurrent.futures import Executor, Future, InvalidStateError
from contextlib import suppress
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

from pytest_dura.campaign.execution.child import Surroundings
from pytest_dura.campaign.execution.dask_cluster import (
    compared,
    connected,
    lost,
    no_warnings,
    no_workers,
)
from pytest_dura.campaign.execution.dask_worker import end_session, simulate_here
from pytest_dura.campaign.execution.replies import CallFailedError, ProcessLostError, result_of
from pytest_dura.campaign.execution.simulating import simulate
from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.provenance.places import is_installed

T = TypeVar("T")
P = ParamSpec("P")

SECONDS_WITHOUT_WORKERS = 300.0
"""How long a session waits for workers, when the last one is gone."""
SECONDS_WITHOUT_ANSWER = 60.0
"""How long the scheduler may leave a question open that it answers at once otherwise."""
_SECONDS_TO_END = 5.0
_EVERY = 1.0


class DaskExecutor(Executor):
    """Simulates on the workers of a Dask cluster.

    Specs and episodes travel as plain data. Each worker is compared with this process at the
    beginning, and again, with the code of the components, before each episode. Dask gives what a
    lost worker had to another one; its own limit says how many workers one episode may take along.

    Args:
        address: Of the scheduler, such as ``tcp://localhost:8786``.

    Raises:
        ConfigurationError: If there is no scheduler or no worker, or one that differs from this
            process.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        here = Surroundings.here()
        shared = [one for one in here.path if not is_installed(Path(one))]
        self._told = {"token": uuid.uuid4().hex, "path": shared, "folder": here.folder}
        self._asked: dict[Future[Any], Any] = {}
        self._lock, self._landing = threading.Lock(), threading.Lock()
        self._closed = threading.Event()
        self._lost: ConfigurationError | None = None
        self.is_lost = False
        """Whether nothing can be simulated there, for all that is known now."""
        self._client, self._loud = connected(address)
        try:
            self.width = compared(self._client, address, self._told)
        except BaseException:  # also on ctrl-C; it is raised again
            self._close()
            raise
        self._watch = threading.Thread(target=self._keep_watch, name="dura-dask", daemon=True)
        self._watch.start()

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The future of an episode.

        Args:
            fn: :func:`pytest_dura.campaign.execution.simulating.simulate`; there is nothing else
                that a cluster is asked for.
            args: Of the same.
            kwargs: Of the same.
        """
        if fn is not simulate:
            raise TypeError("a cluster simulates episodes, and nothing else")
        if self._closed.is_set():
            raise RuntimeError("the connection to the cluster is closed")
        future: Future[Any] = Future()
        if self._lost is not None:
            future.set_exception(self._lost)
            return future
        task = self._client.submit(
            simulate_here, self._told, *args, **kwargs, key=f"dura-{uuid.uuid4().hex}", pure=False
        )
        with self._lock:
            self._asked[future] = task
        future.add_done_callback(self._forget)
        task.add_done_callback(lambda _: self._land(future, task))
        return cast("Future[T]", future)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster, which stays as it is.

        Args:
            wait: Whether what was asked for is waited for.
            cancel_futures: Whether it is given up before that.
        """
        with self._lock:
            asked = list(self._asked)
        for future in asked:
            if cancel_futures or not wait:
                future.cancel()
            else:
                with suppress(Exception):  # told where the result is asked for
                    future.exception()
        if not self._closed.is_set():
            self._closed.set()
            self._watch.join(_SECONDS_TO_END)
            self._close()
            # Whoever waited for an episode has done by then what it does with it.
            if self._landing.acquire(timeout=_SECONDS_TO_END):
                self._landing.release()

    def _close(self) -> None:
        """End our processes on all workers, and the connection; without a scheduler, in vain."""

        def leave() -> None:
            with suppress(Exception):
                self._client.run(end_session, self._told["token"], on_error="ignore")

        last = threading.Thread(target=leave, daemon=True)
        if self._client.status == "running":
            last.start()
            last.join(_SECONDS_TO_END)
        with no_warnings(), suppress(Exception):
            self._client.close(timeout=_SECONDS_TO_END)
        self._loud()

    def _forget(self, future: Future[Any]) -> None:
        """Nobody waits for it any more; what is queued, or has no worker, is cancelled."""
        with self._lock:
            task = self._asked.pop(future, None)
        if task is not None and not task.done():
            with suppress(Exception):  # the connection may be lost
                task.cancel()

    def _land(self, future: Future[Any], task: Any) -> None:
        """Tell what came of a task, unless nobody wants to know."""
        if future.done():
            return
        with self._landing:
            try:
                result = result_of(task.result())  # raises what befell it
            except BaseException as error:  # told where the result is asked for
                self._settle(future, self._told_as(error))
            else:
                self._settle(future, None, result)

    def _told_as(self, error: BaseException) -> BaseException:
        """What an error of Dask's means for an episode."""
        kind = type(error).__name__
        if kind == "KilledWorker":
            return ProcessLostError(f"it ended {getattr(error, 'allowed_failures', 0) + 1} workers")
        if kind in ("NoWorkerError", "NoValidWorkerError"):
            return no_workers(self.address, getattr(error, "timeout", SECONDS_WITHOUT_WORKERS))
        if kind in ("CancelledError", "FutureCancelledError", "CommClosedError"):
            self.is_lost = True  # the watch finds out later
            return lost(self.address)
        if isinstance(error, (ConfigurationError, ProcessLostError, CallFailedError)):
            return error
        return CallFailedError(f"a Dask worker failed: {describe_error(error)}")

    def _settle(
        self, future: Future[Any], error: BaseException | None, result: bytes = b""
    ) -> None:
        with suppress(InvalidStateError):  # it was cancelled in the meantime
            if error is None:
                future.set_result(result)
            else:
                future.set_exception(error)

    def _keep_watch(self) -> None:
        """Follow how many workers there are; nobody waits for ever where there is none."""
        without = 0.0
        while not self._closed.wait(_EVERY):
            try:
                # As `Client.nthreads`, which would wait for a scheduler that is stopped for ever.
                found = self._client.sync(
                    self._client.scheduler.ncores, callback_timeout=SECONDS_WITHOUT_ANSWER
                )
                self.width = max(1, sum(found.values()))
            except Exception:  # whatever Dask raises then: the scheduler does not answer
                if not self._closed.is_set():
                    self._lost, self.is_lost = lost(self.address), True
                    self._give_up(self._lost)
                return
            without = 0.0 if found else without + _EVERY
            self.is_lost = without >= SECONDS_WITHOUT_WORKERS
            if self.is_lost:
                # Whoever asks from now on until there is one does not wait as long once more.
                self._give_up(no_workers(self.address, without))

    def _give_up(self, error: ConfigurationError) -> None:
        with self._lock:
            asked = list(self._asked)
        for future in asked:
            self._settle(future, error)
