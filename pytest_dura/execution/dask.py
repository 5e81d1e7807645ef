"""DaskExecutor: an executor on a Dask cluster, whose workers simulate in children of their own."""

from __future__ import annotations

import asyncio
import json
import logging
import platform
import re
import threading
import uuid
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, InvalidStateError
from concurrent.futures import wait as wait_for
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pytest_dura.core.errors import ConfigurationError, DuraError, describe_error
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
from pytest_dura.execution.surroundings import Captured, surroundings
from pytest_dura.provenance import is_installed

# In a Dask worker, by the token of the session: tasks of Dask are functions, and share no object.
_POOLS: dict[str, ProcessPool] = {}
_LOCK = threading.Lock()


async def _describe(session: Mapping[str, Any], dask_worker: Any) -> bytes:
    """Describe the machine of a Dask worker, as a reply."""
    future = _pool(session, dask_worker).submit(machine_json)
    return await asyncio.to_thread(reply_of, future.result)


def _simulate(
    session: Mapping[str, Any], task: str, conditions: Any, given: Any, seconds: float
) -> tuple[dict[str, Any], bytes]:
    """Simulate an episode on a Dask worker; returns what was captured, and the reply.

    Args:
        session: Its ``token``, what its children begin with, and the ``place`` of its folder.
        task: See :func:`pytest_dura.execution.address.simulate`, as the next ones.
        conditions: See there, but for ``where``.
        given: The surroundings, see there.
        seconds: Limit of the episode.
    """
    from distributed import get_worker

    worker, folder = get_worker(), session["settings"]["folder"]
    here = {**conditions, "where": f"the Dask worker {worker.address}"}
    if _place(folder) != session["place"]:  # coverage counts by the paths of files
        given = {**given, "coverage": None}
    future = _pool(session, worker).submit(simulate, task, here, given, seconds=seconds)
    reply = reply_of(future.result)
    return asdict(vars(future).get("captured", Captured("", "", {}))), reply


def _end_session(token: str) -> None:
    """End the processes of a session."""
    with _LOCK:
        pool = _POOLS.pop(token, None)
    if pool is not None:
        pool.shutdown(wait=False, cancel_futures=True)


def _pool(session: Mapping[str, Any], worker: Any) -> ProcessPool:
    """The processes of a session on this worker, which import from its folders that are here."""
    with _LOCK:
        if session["token"] not in _POOLS:
            given, own = ChildSettings(**session["settings"]), ChildSettings.here()
            shared = [entry for entry in given.path if Path(entry).exists()]
            folder = given.folder if Path(given.folder).is_dir() else own.folder
            settings = replace(given, path=[*dict.fromkeys([*shared, *own.path])], folder=folder)
            _POOLS[session["token"]] = ProcessPool(worker.state.nthreads, settings)
        return _POOLS[session["token"]]


def _place(folder: str) -> list[Any]:
    """Machine and numbers of a folder, which differ where the same path leads elsewhere."""
    return [platform.node(), *Path(folder).stat()[1:3]] if Path(folder).is_dir() else []


SECONDS_TO_CONNECT = 5.0
SECONDS_TO_FIRST_WORKER = 30.0
_SECONDS_TO_COMPARE = 300.0
SECONDS_WITHOUT_WORKERS = 300.0
"""How long a session waits for workers when the last one is gone."""
SECONDS_WITHOUT_ANSWER = 60.0
"""How long the scheduler may take for an answer that it usually gives at once."""
_SECONDS_TO_END = 5.0
_POLL_SECONDS = 1.0
_LOGGERS = ("distributed", "tornado", "asyncio")
_refused = partial(ConfigurationError, key=KEY)


def _no_workers(address: str, seconds: float) -> ConfigurationError:
    problem = f"the Dask scheduler has had no worker for {seconds:g} s"
    remedy = f"start some: dask worker {address} --nthreads 1"
    return _refused(problem, found=address, expected="at least one worker", remedy=remedy)


def _scheduler_lost(address: str) -> ConfigurationError:
    remedy = "start the scheduler again, and go on with --dura-resume"
    return _refused("the connection to the Dask scheduler is lost", found=address, remedy=remedy)


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """Context with a client of a scheduler, in which Dask's logs are disabled in this process.

    What matters to a session is raised; what a worker logs stands in its own log.
    """
    if find_spec("distributed") is None:
        remedy = "pip install 'pytest-dura[dask]'"
        raise _refused("Dask is not installed", found=address, remedy=remedy)
    import distributed

    names = [each for each in logging.root.manager.loggerDict if each.split(".")[0] in _LOGGERS]
    connect: Any = distributed.Client
    with ExitStack() as stack:
        for logger in map(logging.getLogger, names):
            stack.callback(setattr, logger, "disabled", logger.disabled)
            logger.disabled = True
        try:
            client = connect(
                address, timeout=SECONDS_TO_CONNECT, set_as_default=False, name="pytest-dura"
            )
        except (OSError, ValueError, TypeError, Warning) as error:
            raise _refused(
                "there is no Dask scheduler at this address, or it does not answer",
                found=f"{address} ({type(error).__name__})",
                expected="the address that `dask scheduler` prints, as dask://HOST:PORT",
                remedy="start one: dask scheduler --host localhost --port 8786",
            ) from None
        try:
            yield client
        finally:
            with warnings.catch_warnings(), suppress(Exception):
                warnings.simplefilter("ignore")  # of an event loop that ends
                client.close(timeout=_SECONDS_TO_END)


def _compare_workers(client: Any, address: str, session: Mapping[str, Any]) -> int:
    """Compare each worker with this process; returns how many threads they have."""
    while True:
        try:
            client.wait_for_workers(1, timeout=SECONDS_TO_FIRST_WORKER)
        except asyncio.TimeoutError:
            raise _no_workers(address, SECONDS_TO_FIRST_WORKER) from None
        remedy = "start workers in an environment with the same pytest-dura"
        ask = {"on_error": "return", "callback_timeout": _SECONDS_TO_COMPARE}
        try:
            replies = client.sync(client.run, _describe, session, **ask)
        except asyncio.TimeoutError:
            problem = f"a Dask worker has not answered for {_SECONDS_TO_COMPARE:g} s"
            raise _refused(problem, found=address, remedy=remedy) from None
        # An error of the connection to a worker: it is gone.
        there = {each: reply for each, reply in replies.items() if not isinstance(reply, OSError)}
        for worker, reply in there.items():
            where = f"the Dask worker {worker}"
            try:
                if isinstance(reply, Exception):
                    raise reply  # noqa: TRY301 - as what the reply says
                machine = json.loads(result_of(reply))
            except Exception as error:  # whatever goes wrong there
                problem = f"{where} cannot simulate: {describe_error(error)}"
                raise _refused(problem, found=address, remedy=remedy) from None
            refuse_differences(where, describe_machine(), machine)
        if there:
            return max(1, sum(int(n) for each, n in client.nthreads().items() if each in there))


class DaskExecutor(Executor):
    """Executor that simulates on the workers of a Dask cluster.

    Specs and episodes travel as plain data. Each worker is compared with this process at the
    beginning, and again, with the modules of the user's own, before each episode. Dask gives what a
    lost worker had to another one; its own limit says how many workers one episode may take along.
    Futures have the attribute ``captured``, as those of a :class:`ProcessPool`.

    Args:
        address: Address of the scheduler, such as ``tcp://localhost:8786``.
        memory: Bytes that a process that simulates may take beside what it begins with.

    Raises:
        ConfigurationError: If there is no scheduler or worker, or one differs from this process.
    """

    def __init__(self, address: str, memory: int | None = None) -> None:
        self.address = address
        here = ChildSettings.here(memory)
        settings = replace(here, path=[one for one in here.path if not is_installed(Path(one))])
        place = _place(here.folder)
        self._session = {"token": uuid.uuid4().hex, "settings": asdict(settings), "place": place}
        self._tasks: dict[Future[Any], Any] = {}
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._lost: ConfigurationError | None = None
        self.is_lost = False
        """Whether nothing can be simulated there, for all that is known now."""
        with ExitStack() as stack:
            self._client = stack.enter_context(_connected(address))
            stack.callback(self._leave)
            self.width = _compare_workers(self._client, address, self._session)
            self._connection = stack.pop_all()
        self._monitor = threading.Thread(target=self._watch, name="dura-dask", daemon=True)
        self._monitor.start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Begin an episode: a call of :func:`~pytest_dura.execution.address.simulate`."""
        if fn is not simulate:
            raise TypeError("a cluster simulates episodes, and nothing else")
        if self._closed.is_set():
            raise RuntimeError("the connection to the cluster is closed")
        future: Future[Any] = Future()
        if self._lost is not None:
            future.set_exception(self._lost)
            return future
        task = self._client.submit(_simulate, self._session, *args, **kwargs, pure=False)
        with self._lock:
            self._tasks[future] = task
        future.add_done_callback(self._cancel_task)
        task.add_done_callback(lambda _: self._resolve(future, task))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster, which stays as it is.

        Args:
            wait: Whether to wait for the episodes that were begun.
            cancel_futures: Whether to give them up before that.
        """
        with self._lock:
            futures = list(self._tasks)
        if wait and not cancel_futures:
            wait_for(futures)
        for future in futures:
            future.cancel()
        self._closed.set()
        self._monitor.join(_SECONDS_TO_END)
        self._connection.close()

    def _leave(self) -> None:
        """End the processes of this session on all workers, as far as the scheduler answers."""
        end = {"on_error": "ignore", "callback_timeout": _SECONDS_TO_END}
        if self._client.status == "running":
            with suppress(Exception):
                self._client.sync(self._client.run, _end_session, self._session["token"], **end)

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
        try:
            captured, reply = task.result()
            vars(future)["captured"] = Captured(**captured)
            result, error = result_of(reply), None
        except BaseException as raised:  # again where the result is taken
            result, error = b"", self._episode_error(raised)
        with suppress(InvalidStateError):  # it was cancelled in the meantime
            if error is None:
                future.set_result(result)
            else:
                future.set_exception(error)

    def _episode_error(self, error: BaseException) -> BaseException:
        """The error of an episode for an error of Dask's."""
        kind = type(error).__name__
        if kind == "KilledWorker":
            return ProcessLostError(f"it ended {getattr(error, 'allowed_failures', 0) + 1} workers")
        if kind in ("NoWorkerError", "NoValidWorkerError"):
            return _no_workers(self.address, getattr(error, "timeout", SECONDS_WITHOUT_WORKERS))
        if kind in ("CancelledError", "FutureCancelledError", "CommClosedError"):
            self.is_lost = True  # before the monitor sees it
            return _scheduler_lost(self.address)
        if isinstance(error, DuraError):
            return error
        return CallFailedError(f"a Dask worker failed: {describe_error(error)}")

    def _watch(self) -> None:
        """Count the workers, and give up what waits where there has been none for long."""
        without = 0.0
        while not self._closed.wait(_POLL_SECONDS):
            try:
                # As `Client.nthreads`, which would wait for a scheduler that is stopped for ever.
                cores = self._client.sync(
                    self._client.scheduler.ncores, callback_timeout=SECONDS_WITHOUT_ANSWER
                )
            except Exception:  # whatever Dask raises then: the scheduler does not answer
                if not self._closed.is_set():
                    self._lost, self.is_lost = _scheduler_lost(self.address), True
                    self._give_up(self._lost)
                return
            self.width = max(1, sum(cores.values()))
            without = 0.0 if cores else without + _POLL_SECONDS
            self.is_lost = without >= SECONDS_WITHOUT_WORKERS
            if self.is_lost:  # what is submitted before there is a worker does not wait as long
                self._give_up(_no_workers(self.address, without))

    def _give_up(self, error: ConfigurationError) -> None:
        with self._lock:
            futures = list(self._tasks)
        for future in futures:
            with suppress(InvalidStateError):  # it was cancelled in the meantime
                future.set_exception(error)


class DaskCluster(ExecutorKind):
    """The workers of a Dask cluster, by the address of its scheduler."""

    form = "dask://HOST:PORT"

    def __init__(self, argument: str) -> None:
        given = re.fullmatch(r"//(\[[0-9A-Fa-f:.]+\]|[^/:@?#\s]+):([0-9]{1,5})/?", argument)
        if given is None or int(given[2]) not in range(1, 2**16):
            raise ValueError(argument)
        self.address = f"tcp://{given[1]}:{given[2]}"
        self.where = f"by Dask, scheduler at {self.address}"
        if surroundings()["coverage"] is not None:
            self.where += "; coverage counts its workers on this machine only"

    def connect(self) -> None:
        """Connect to the scheduler, and disconnect again."""
        with _connected(self.address):
            pass

    def start(self) -> DaskExecutor:
        """Connect to the cluster, and compare its workers with this process."""
        return DaskExecutor(self.address, self.memory)
