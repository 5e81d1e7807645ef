"""DaskExecutor: an executor on a Dask cluster, whose workers must equal this process."""

from __future__ import annotations

import asyncio
import json
import logging
import re
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
from pytest_dura.execution.address import (
    describe_machine,
    machine_json,
    refuse_differences,
    simulate,
)
from pytest_dura.execution.children import ChildSettings
from pytest_dura.execution.executors import KEY, ExecutorKind
from pytest_dura.execution.processes import ProcessPool
from pytest_dura.execution.replies import CallFailedError, ProcessLostError, reply_of, result_of
from pytest_dura.provenance import is_installed

_LOGGERS = ("distributed", "tornado", "asyncio")


def silence_logs() -> Callable[[], None]:
    """Disable the logs of Dask in this process, until the returned function is called.

    What matters to a session is raised; what a worker logs stands in its own log.
    """
    loggers = [
        logging.getLogger(name)
        for name in sorted(logging.root.manager.loggerDict)
        if name.partition(".")[0] in _LOGGERS
    ]
    before = [logger.disabled for logger in loggers]
    for logger in loggers:
        logger.disabled = True

    def restore() -> None:
        for logger, disabled in zip(loggers, before, strict=True):
            logger.disabled = disabled

    return restore


# In a Dask worker, by the token of the session: tasks of Dask are functions, and share no object.
_POOLS: dict[str, ProcessPool] = {}
_LOCK = threading.Lock()


def _reply_with_machine(client: Mapping[str, Any]) -> bytes:
    """Describe the machine of a Dask worker, as a reply.

    Args:
        client: The session: ``token``, the ``path`` and ``folder`` where it finds components, and
            the ``places`` that code may come from, and the ``memory`` that a process may take.
    """
    return reply_of(lambda: _pool(client).submit(machine_json).result())


def _reply_with_episode(
    client: Mapping[str, Any],
    task: str,
    conditions: Mapping[str, Any],
    surroundings: Mapping[str, Any],
    seconds: float,
) -> bytes:
    """Simulate an episode on a Dask worker, as a reply.

    Args:
        client: See :func:`_reply_with_machine`.
        task: See :func:`pytest_dura.execution.address.simulate`.
        conditions: See the same, but for ``where``.
        surroundings: See the same.
        seconds: Limit of the episode.
    """
    from distributed import get_worker

    here = {**conditions, "where": f"the Dask worker {get_worker().address}"}
    call = _pool(client).submit
    return reply_of(lambda: call(simulate, task, here, surroundings, seconds=seconds).result())


def _end_session(token: str) -> None:
    """End the processes of a session; a second call does nothing."""
    with _LOCK:
        pool = _POOLS.pop(token, None)
    if pool is not None:
        pool.shutdown(wait=False, cancel_futures=True)


def _pool(client: Mapping[str, Any]) -> ProcessPool:
    """The processes of a session on this worker; they end by themselves when they have no calls."""
    from distributed import get_worker

    token = client["token"]
    with _LOCK:
        if token not in _POOLS:
            _POOLS[token] = ProcessPool(get_worker().state.nthreads, _settings(client))
        return _POOLS[token]


def _settings(client: Mapping[str, Any]) -> ChildSettings:
    """That of the worker, after those folders of the client's project that are here as well."""
    own = ChildSettings.here()
    shared = [entry for entry in client["path"] if Path(entry).exists()]
    folder = client["folder"] if Path(client["folder"]).is_dir() else own.folder
    path = list(dict.fromkeys([*shared, *own.path]))
    return ChildSettings(path, folder, client["places"], client["memory"])


_LAST_PORT = 65535
SECONDS_TO_CONNECT = 5.0
SECONDS_TO_FIRST_WORKER = 30.0
_SECONDS_TO_COMPARE = 300.0
_SECONDS_TO_FETCH = 30.0
_RETRY_SECONDS, _SHORT_POLL_SECONDS = 0.2, 0.05


def _open_client(address: str) -> tuple[Any, Callable[[], None]]:
    """A client of the scheduler at this address, and the function that restores Dask's logs.

    Raises:
        ConfigurationError: If Dask is not installed, or no scheduler answers.
    """
    connect(address)
    import distributed

    restore_logs = silence_logs()
    client_class: Any = distributed.Client
    try:
        with _ignore_dask_warnings():
            client = client_class(
                address, timeout=SECONDS_TO_CONNECT, set_as_default=False, name="pytest-dura"
            )
    except BaseException as error:  # also on ctrl-C; it is raised again
        restore_logs()
        if isinstance(error, (OSError, ValueError, TypeError)):
            raise _no_scheduler_error(address, error) from None
        raise
    return client, restore_logs


def connect(address: str) -> None:
    """Connect to an address and disconnect, without Dask, which tries for long and logs a lot.

    Raises:
        ConfigurationError: If Dask is not installed, or no server listens there.
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


def _compare_workers(client: Any, address: str, session: Mapping[str, Any]) -> int:
    """Compare the scheduler and every worker with this process; returns the threads of workers.

    Args:
        client: Client of the scheduler.
        address: Its address.
        session: See :func:`_reply_with_machine`.

    Raises:
        ConfigurationError: If the scheduler or a worker differs, or there is no worker.
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
        tasks = {
            worker: client.submit(
                _reply_with_machine,
                session,
                workers=[worker],
                key=f"dura-look-{uuid.uuid4().hex}",
                pure=False,
            )
            for worker in threads
        }
        equal = [
            worker
            for worker, task in tasks.items()
            if _is_equal(client, address, worker, task, end)
        ]
        if equal:
            return sum(threads[worker] for worker in equal)


def _is_equal(client: Any, address: str, worker: str, task: Any, end: float) -> bool:
    """Whether a worker equals this process; false if it is gone.

    Raises:
        ConfigurationError: If it differs, or does not answer in time.
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
    """Result of a task that only this worker may carry out, as long as it is there.

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


def _dask_versions(versions: Mapping[str, Any]) -> dict[str, str]:
    """Versions that a client and a scheduler must have in common to understand each other."""
    packages = versions["packages"]
    return {
        "Python": ".".join(str(packages["python"]).split(".")[:2]),
        **{name: str(packages[name]) for name in ("dask", "distributed")},
    }


def _no_scheduler_error(address: str, error: Exception) -> ConfigurationError:
    return ConfigurationError(
        "there is no Dask scheduler at this address, or it does not answer",
        key=KEY,
        found=f"{address} ({type(error).__name__})",
        expected="the address that `dask scheduler` prints, as dask://HOST:PORT",
        remedy="start one: dask scheduler --host localhost --port 8786",
    )


def _no_workers_error(address: str, seconds: float) -> ConfigurationError:
    return ConfigurationError(
        f"the Dask scheduler has had no worker for {seconds:g} s",
        key=KEY,
        found=address,
        expected="at least one worker",
        remedy=f"start some: dask worker {address} --nthreads 1",
    )


def _scheduler_lost_error(address: str) -> ConfigurationError:
    return ConfigurationError(
        "the connection to the Dask scheduler is lost",
        key=KEY,
        found=address,
        remedy="start the scheduler again, and go on with --dura-resume",
    )


@contextmanager
def _ignore_dask_warnings() -> Iterator[None]:
    """Dask warns of versions that differ, which are compared here, and of loops at its end."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


T = TypeVar("T")
P = ParamSpec("P")

SECONDS_WITHOUT_WORKERS = 300.0
"""How long a session waits for workers when the last one is gone."""
SECONDS_WITHOUT_ANSWER = 60.0
"""How long the scheduler may take for an answer that it usually gives at once."""
_SECONDS_TO_END = 5.0
_POLL_SECONDS = 1.0


class DaskExecutor(Executor):
    """Executor that simulates on the workers of a Dask cluster.

    Specs and episodes travel as plain data. Each worker is compared with this process at the
    beginning, and again, with the modules of the user's own, before each episode. Dask gives what a
    lost worker had to another one; its own limit says how many workers one episode may take along.

    Args:
        address: Address of the scheduler, such as ``tcp://localhost:8786``.
        memory: Bytes that a process that simulates may take beside what it begins with.

    Raises:
        ConfigurationError: If there is no scheduler or no worker, or one that differs from this
            process.
    """

    def __init__(self, address: str, memory: int | None = None) -> None:
        self.address = address
        here = ChildSettings.here()
        shared = [entry for entry in here.path if not is_installed(Path(entry))]
        self._session = {
            "token": uuid.uuid4().hex,
            "path": shared,
            "folder": here.folder,
            "places": here.places,
            "memory": memory,
        }
        self._tasks: dict[Future[Any], Any] = {}
        self._lock, self._resolving = threading.Lock(), threading.Lock()
        self._closed = threading.Event()
        self._lost: ConfigurationError | None = None
        self.is_lost = False
        """Whether nothing can be simulated there, for all that is known now."""
        self._client, self._restore_logs = _open_client(address)
        try:
            self.width = _compare_workers(self._client, address, self._session)
        except BaseException:  # also on ctrl-C; it is raised again
            self._close()
            raise
        self._monitor = threading.Thread(
            target=self._monitor_workers, name="dura-dask", daemon=True
        )
        self._monitor.start()

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Begin an episode, and return its future.

        Args:
            fn: :func:`pytest_dura.execution.address.simulate`; a cluster takes no other calls.
            args: Its arguments.
            kwargs: Its arguments.
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
            self._session,
            *args,
            **kwargs,
            key=f"dura-{uuid.uuid4().hex}",
            pure=False,
        )
        with self._lock:
            self._tasks[future] = task
        future.add_done_callback(self._cancel_task)
        task.add_done_callback(lambda _: self._resolve(future, task))
        return cast("Future[T]", future)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster, which stays as it is.

        Args:
            wait: Whether to wait for the episodes that were begun.
            cancel_futures: Whether to give them up before that.
        """
        with self._lock:
            futures = list(self._tasks)
        for future in futures:
            if cancel_futures or not wait:
                future.cancel()
            else:
                with suppress(Exception):  # raised where the result is taken
                    future.exception()
        if not self._closed.is_set():
            self._closed.set()
            self._monitor.join(_SECONDS_TO_END)
            self._close()
            # The callbacks of an episode that has just come are over by then.
            if self._resolving.acquire(timeout=_SECONDS_TO_END):
                self._resolving.release()

    def _close(self) -> None:
        """End our processes on all workers, and the connection; without a scheduler, in vain."""

        def leave() -> None:
            with suppress(Exception):
                self._client.run(_end_session, self._session["token"], on_error="ignore")

        leaving = threading.Thread(target=leave, daemon=True)
        if self._client.status == "running":
            leaving.start()
            leaving.join(_SECONDS_TO_END)
        with _ignore_dask_warnings(), suppress(Exception):
            self._client.close(timeout=_SECONDS_TO_END)
        self._restore_logs()

    def _cancel_task(self, future: Future[Any]) -> None:
        """Cancel the task of a future that is done, if it is queued, or has no worker."""
        with self._lock:
            task = self._tasks.pop(future, None)
        if task is not None and not task.done():
            with suppress(Exception):  # the connection may be lost
                task.cancel()

    def _resolve(self, future: Future[Any], task: Any) -> None:
        """Give a future the result of its task, unless it is done by now."""
        if future.done():
            return
        with self._resolving:
            try:
                result = result_of(task.result())
            except BaseException as error:  # raised where the result is taken
                self._set(future, self._episode_error(error))
            else:
                self._set(future, None, result)

    def _episode_error(self, error: BaseException) -> BaseException:
        """The error of an episode for an error of Dask's."""
        kind = type(error).__name__
        if kind == "KilledWorker":
            return ProcessLostError(f"it ended {getattr(error, 'allowed_failures', 0) + 1} workers")
        if kind in ("NoWorkerError", "NoValidWorkerError"):
            return _no_workers_error(
                self.address, getattr(error, "timeout", SECONDS_WITHOUT_WORKERS)
            )
        if kind in ("CancelledError", "FutureCancelledError", "CommClosedError"):
            self.is_lost = True  # before the monitor sees it
            return _scheduler_lost_error(self.address)
        if isinstance(error, (ConfigurationError, ProcessLostError, CallFailedError)):
            return error
        return CallFailedError(f"a Dask worker failed: {describe_error(error)}")

    def _set(self, future: Future[Any], error: BaseException | None, result: bytes = b"") -> None:
        with suppress(InvalidStateError):  # it was cancelled in the meantime
            if error is None:
                future.set_result(result)
            else:
                future.set_exception(error)

    def _monitor_workers(self) -> None:
        """Count the workers, and give up what waits where there has been none for long."""
        without = 0.0
        while not self._closed.wait(_POLL_SECONDS):
            try:
                # As `Client.nthreads`, which would wait for a scheduler that is stopped for ever.
                cores = self._client.sync(
                    self._client.scheduler.ncores, callback_timeout=SECONDS_WITHOUT_ANSWER
                )
                self.width = max(1, sum(cores.values()))
            except Exception:  # whatever Dask raises then: the scheduler does not answer
                if not self._closed.is_set():
                    self._lost, self.is_lost = _scheduler_lost_error(self.address), True
                    self._give_up(self._lost)
                return
            without = 0.0 if cores else without + _POLL_SECONDS
            self.is_lost = without >= SECONDS_WITHOUT_WORKERS
            if self.is_lost:
                # An episode that is submitted before there is a worker does not wait as long again.
                self._give_up(_no_workers_error(self.address, without))

    def _give_up(self, error: ConfigurationError) -> None:
        with self._lock:
            futures = list(self._tasks)
        for future in futures:
            self._set(future, error)


class DaskCluster(ExecutorKind):
    """The workers of a Dask cluster, by the address of its scheduler."""

    form = "dask://HOST:PORT"

    def __init__(self, argument: str) -> None:
        given = re.fullmatch(r"//(\[[0-9A-Fa-f:.]+\]|[^/:@?#\s]+):([0-9]{1,5})/?", argument)
        if given is None or not 0 < int(given[2]) <= _LAST_PORT:
            raise ValueError(argument)
        self.address = f"tcp://{given[1]}:{given[2]}"
        self.where = f"by Dask, scheduler at {self.address}"

    def connect(self) -> None:
        """Connect to the scheduler and disconnect again; see :func:`connect`."""
        connect(self.address)

    def start(self) -> DaskExecutor:
        """Connect to the cluster, and compare its workers with this process.

        Raises:
            ConfigurationError: If the cluster cannot be used.
        """
        return DaskExecutor(self.address, self.memory)
