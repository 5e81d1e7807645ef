"""DaskExecutor: an executor on a Dask cluster, whose workers must equal this process."""

from __future__ import annotations

import asyncio
import json
import logging
import socket
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, InvalidStateError
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.execution.address import describe_machine
from pytest_dura.execution.processes import ProcessEnvironment, ProcessPool
from pytest_dura.execution.simulation import machine_json, refuse_differences, simulate
from pytest_dura.execution.worker import CallFailedError, ProcessLostError, reply_of, result_of
from pytest_dura.provenance import is_installed

_NAMES = ("distributed", "tornado", "asyncio")


def silence_logs() -> Callable[[], None]:
    """Let Dask log nothing in this process, until the returned function is called.

    What matters to a session is raised; what a worker logs stands in its own log.
    """
    silenced = [
        logging.getLogger(name)
        for name in sorted(logging.root.manager.loggerDict)
        if name.partition(".")[0] in _NAMES
    ]
    before = [item.disabled for item in silenced]
    for entry in silenced:
        entry.disabled = True

    def loud() -> None:
        for item, was in zip(silenced, before, strict=True):
            item.disabled = was

    return loud


_POOLS: dict[str, ProcessPool] = {}
_LOCK = threading.Lock()


def _reply_with_machine(client: Mapping[str, Any]) -> bytes:
    """The reply to the question what every episode that is simulated here depends on.

    Args:
        client: Who asks: ``token``, and the ``path`` and ``folder`` where it finds components.
    """
    return reply_of(lambda: _pool(client).submit(machine_json).result())


def _reply_with_episode(
    client: Mapping[str, Any], task: str, conditions: Mapping[str, Any] | None, seconds: float
) -> bytes:
    """The reply to a call of :func:`pytest_dura.execution.simulation.simulate`.

    Args:
        client: Who asks, see :func:`look_here`.
        task: What is simulated.
        conditions: What has to be equal here.
        seconds: What it may take.
    """
    from distributed import get_worker

    told = conditions and {**conditions, "where": f"the Dask worker {get_worker().address}"}
    return reply_of(lambda: _pool(client).submit(simulate, task, told, seconds=seconds).result())


def _end_session(token: str) -> None:
    """End the processes of a session; a second call does nothing."""
    with _LOCK:
        pool = _POOLS.pop(token, None)
    if pool is not None:
        pool.shutdown(wait=False, cancel_futures=True)


def _pool(client: Mapping[str, Any]) -> ProcessPool:
    """The processes of a session; they end by themselves when it asks for nothing any more."""
    from distributed import get_worker

    token = client["token"]
    with _LOCK:
        if token not in _POOLS:
            _POOLS[token] = ProcessPool(get_worker().state.nthreads, _process_environment(client))
        return _POOLS[token]


def _process_environment(client: Mapping[str, Any]) -> ProcessEnvironment:
    """What the worker finds, after those folders of the client's project that are here as well."""
    own = ProcessEnvironment.here()
    shared = [item for item in client["path"] if Path(item).exists()]
    folder = client["folder"] if Path(client["folder"]).is_dir() else own.folder
    return ProcessEnvironment(list(dict.fromkeys([*shared, *own.path])), folder)


KEY = "--dura-executor"
SECONDS_TO_CONNECT = 5.0
SECONDS_TO_FIRST_WORKER = 30.0
_SECONDS_TO_COMPARE = 300.0
_SECONDS_TO_FETCH = 30.0
_RETRY_SECONDS, _SHORT_POLL_SECONDS = 0.2, 0.05


def _open_client(address: str) -> tuple[Any, Callable[[], None]]:
    """A client of the scheduler at this address, and what lets Dask log again when it is done.

    Raises:
        ConfigurationError: If Dask is not installed, or no scheduler answers.
    """
    connect(address)
    import distributed

    loud = silence_logs()
    client: Any = distributed.Client
    try:
        with _ignore_dask_warnings():
            made = client(
                address, timeout=SECONDS_TO_CONNECT, set_as_default=False, name="pytest-dura"
            )
    except BaseException as error:  # also on ctrl-C; it is raised again
        loud()
        if isinstance(error, (OSError, ValueError, TypeError)):
            raise _no_scheduler_error(address, error) from None
        raise
    return made, loud


def connect(address: str) -> None:
    """Find out whether anybody listens, without Dask, which tries for long and logs a lot.

    Raises:
        ConfigurationError: If Dask is not installed, or nobody does.
    """
    if find_spec("distributed") is None:
        raise ConfigurationError(
            "Dask is not installed",
            key=KEY,
            found=address,
            remedy="pip install 'pytest-dura[dask]'",
        )
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    end = time.monotonic() + SECONDS_TO_CONNECT
    while True:
        left = max(end - time.monotonic(), 0.1)
        try:
            socket.create_connection((host.strip("[]"), int(port)), left).close()
        except OSError as error:
            if left <= _RETRY_SECONDS:
                raise _no_scheduler_error(address, error) from None
            time.sleep(_RETRY_SECONDS)  # it may be starting
        else:
            return


def _compare_workers(client: Any, address: str, told: Mapping[str, Any]) -> int:
    """Compare the scheduler and every worker with this process; how many threads workers have.

    Args:
        client: Of the scheduler.
        address: Of the same.
        told: See :func:`pytest_dura.execution.dask.reply_with_machine`.

    Raises:
        ConfigurationError: If one differs, or there is no worker.
    """
    from distributed.versions import get_versions

    # Not Client.get_versions, which also waits for the answer of every worker.
    there = client.sync(client.scheduler.versions)
    refuse_differences("the Dask scheduler", _dask_versions(get_versions()), _dask_versions(there))
    end = time.monotonic() + _SECONDS_TO_COMPARE
    while True:
        try:
            client.wait_for_workers(1, timeout=SECONDS_TO_FIRST_WORKER)
        except (TimeoutError, asyncio.TimeoutError):  # two classes on Python 3.10
            raise _no_workers_error(address, SECONDS_TO_FIRST_WORKER) from None
        threads: dict[str, int] = client.nthreads()
        asked = {
            thread: client.submit(
                _reply_with_machine,
                told,
                workers=[thread],
                key=f"dura-look-{uuid.uuid4().hex}",
                pure=False,
            )
            for thread in threads
        }
        equal = [
            item for item, task in asked.items() if _is_equal(client, address, item, task, end)
        ]
        if equal:
            return sum(threads[item] for item in equal)


def _is_equal(client: Any, address: str, worker: str, task: Any, end: float) -> bool:
    """Whether a worker is as this process; not if it is gone, and nothing is simulated there.

    Raises:
        ConfigurationError: If it differs, or says nothing in time.
    """
    where = f"the Dask worker {worker}"
    try:
        data = json.loads(result_of(_answer(client, worker, task, end)))
    except Exception as error:  # whatever goes wrong there
        if client.status == "running" and worker not in client.nthreads():
            return False
        raise ConfigurationError(
            f"{where} cannot simulate: {describe_error(error)}",
            key=KEY,
            found=address,
            remedy="start workers in an environment with the same pytest-dura",
        ) from None
    refuse_differences(where, describe_machine(), data)
    return True


def _answer(client: Any, worker: str, task: Any, end: float) -> bytes:
    """What a task comes to that only this worker may carry out, as long as it is there.

    Raises:
        TimeoutError: If the worker is gone, or the time is over.
    """
    # Dask would keep the task for a worker of this name, which never comes back.
    while not task.done() and time.monotonic() < end and worker in client.nthreads():
        time.sleep(_SHORT_POLL_SECONDS)
    if not task.done():
        raise TimeoutError("it is gone, or does not answer")
    # What is done is still to be fetched, from a machine that may do much else.
    return cast("bytes", task.result(timeout=_SECONDS_TO_FETCH))


def _dask_versions(told: Mapping[str, Any]) -> dict[str, str]:
    """What a client and a scheduler have to have in common to understand each other."""
    packages = told["packages"]
    found = {name: str(packages[name]) for name in ("dask", "distributed")}
    return {"Python": ".".join(str(packages["python"]).split(".")[:2]), **found}


def _no_scheduler_error(address: str, error: Exception) -> ConfigurationError:
    """Nobody answers, or it is no scheduler."""
    return ConfigurationError(
        "there is no Dask scheduler at this address, or it does not answer",
        key=KEY,
        found=f"{address} ({type(error).__name__})",
        expected="the address that `dask scheduler` prints, as dask://HOST:PORT",
        remedy="start one: dask scheduler --host localhost --port 8786",
    )


def _no_workers_error(address: str, seconds: float) -> ConfigurationError:
    """There has been no worker for so long."""
    return ConfigurationError(
        f"the Dask scheduler has had no worker for {seconds:g} s",
        key=KEY,
        found=address,
        expected="at least one worker",
        remedy=f"start some: dask worker {address} --nthreads 1",
    )


def _scheduler_lost_error(address: str) -> ConfigurationError:
    """The scheduler is gone."""
    return ConfigurationError(
        "the connection to the Dask scheduler is lost",
        key=KEY,
        found=address,
        remedy="start the scheduler again, and go on with --dura-resume",
    )


@contextmanager
def _ignore_dask_warnings() -> Iterator[None]:
    """Dask warns of versions that differ, which are compared anyway, and of loops at its end."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


T = TypeVar("T")
P = ParamSpec("P")

SECONDS_WITHOUT_WORKERS = 300.0
"""How long a session waits for workers, when the last one is gone."""
SECONDS_WITHOUT_ANSWER = 60.0
"""How long the scheduler may leave a question open that it answers at once otherwise."""
_SECONDS_TO_END = 5.0
_POLL_SECONDS = 1.0


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
        here = ProcessEnvironment.here()
        shared = [item for item in here.path if not is_installed(Path(item))]
        self._told = {"token": uuid.uuid4().hex, "path": shared, "folder": here.folder}
        self._asked: dict[Future[Any], Any] = {}
        self._lock, self._landing = threading.Lock(), threading.Lock()
        self._closed = threading.Event()
        self._lost: ConfigurationError | None = None
        self.is_lost = False
        """Whether nothing can be simulated there, for all that is known now."""
        self._client, self._loud = _open_client(address)
        try:
            self.width = _compare_workers(self._client, address, self._told)
        except BaseException:  # also on ctrl-C; it is raised again
            self._close()
            raise
        self._watch = threading.Thread(target=self._keep_watch, name="dura-dask", daemon=True)
        self._watch.start()

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The future of an episode.

        Args:
            fn: :func:`pytest_dura.execution.simulation.simulate`; there is nothing else
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
            _reply_with_episode,
            self._told,
            *args,
            **kwargs,
            key=f"dura-{uuid.uuid4().hex}",
            pure=False,
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
                self._client.run(_end_session, self._told["token"], on_error="ignore")

        last = threading.Thread(target=leave, daemon=True)
        if self._client.status == "running":
            last.start()
            last.join(_SECONDS_TO_END)
        with _ignore_dask_warnings(), suppress(Exception):
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
            return _no_workers_error(
                self.address, getattr(error, "timeout", SECONDS_WITHOUT_WORKERS)
            )
        if kind in ("CancelledError", "FutureCancelledError", "CommClosedError"):
            self.is_lost = True  # the watch finds out later
            return _scheduler_lost_error(self.address)
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
        while not self._closed.wait(_POLL_SECONDS):
            try:
                # As `Client.nthreads`, which would wait for a scheduler that is stopped for ever.
                sync = self._client.sync(
                    self._client.scheduler.ncores, callback_timeout=SECONDS_WITHOUT_ANSWER
                )
                self.width = max(1, sum(sync.values()))
            except Exception:  # whatever Dask raises then: the scheduler does not answer
                if not self._closed.is_set():
                    self._lost, self.is_lost = _scheduler_lost_error(self.address), True
                    self._give_up(self._lost)
                return
            without = 0.0 if sync else without + _POLL_SECONDS
            self.is_lost = without >= SECONDS_WITHOUT_WORKERS
            if self.is_lost:
                # Whoever asks from now on until there is one does not wait as long once more.
                self._give_up(_no_workers_error(self.address, without))

    def _give_up(self, error: ConfigurationError) -> None:
        with self._lock:
            asked = list(self._asked)
        for future in asked:
            self._settle(future, error)
