"""A Dask cluster: reaching its scheduler, comparing its workers, and what may be wrong with it."""

from __future__ import annotations

import asyncio
import json
import socket
import time
import uuid
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any, cast

from pytest_dura.campaign.episodes.address import machine
from pytest_dura.campaign.execution.dask_logs import quiet
from pytest_dura.campaign.execution.dask_worker import look_here
from pytest_dura.campaign.execution.replies import result_of
from pytest_dura.campaign.execution.simulating import refuse
from pytest_dura.core.errors import ConfigurationError, describe_error

KEY = "--dura-executor"
SECONDS_TO_CONNECT = 5.0
SECONDS_TO_FIRST_WORKER = 30.0
_SECONDS_TO_COMPARE = 300.0
_SECONDS_TO_FETCH = 30.0
_PAUSE, _SOON = 0.2, 0.05


def connected(address: str) -> tuple[Any, Callable[[], None]]:
    """A client of the scheduler at this address, and what lets Dask log again when it is done.

    Raises:
        ConfigurationError: If Dask is not installed, or no scheduler answers.
    """
    knock(address)
    import distributed

    loud = quiet()
    client: Any = distributed.Client
    try:
        with no_warnings():
            made = client(
                address, timeout=SECONDS_TO_CONNECT, set_as_default=False, name="pytest-dura"
            )
    except BaseException as error:  # also on ctrl-C; it is raised again
        loud()
        if isinstance(error, (OSError, ValueError, TypeError)):
            raise no_scheduler(address, error) from None
        raise
    return made, loud


def knock(address: str) -> None:
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
            if left <= _PAUSE:
                raise no_scheduler(address, error) from None
            time.sleep(_PAUSE)  # it may be starting
        else:
            return


def compared(client: Any, address: str, told: Mapping[str, Any]) -> int:
    """Compare the scheduler and every worker with this process; how many threads workers have.

    Args:
        client: Of the scheduler.
        address: Of the same.
        told: See :func:`pytest_dura.campaign.execution.dask_worker.look_here`.

    Raises:
        ConfigurationError: If one differs, or there is no worker.
    """
    from distributed.versions import get_versions

    # Not Client.get_versions, which also waits for the answer of every worker.
    there = client.sync(client.scheduler.versions)
    refuse("the Dask scheduler", _dask_of(get_versions()), _dask_of(there))
    end = time.monotonic() + _SECONDS_TO_COMPARE
    while True:
        try:
            client.wait_for_workers(1, timeout=SECONDS_TO_FIRST_WORKER)
        except (TimeoutError, asyncio.TimeoutError):  # two classes on Python 3.10
            raise no_workers(address, SECONDS_TO_FIRST_WORKER) from None
        threads: dict[str, int] = client.nthreads()
        asked = {
            one: client.submit(
                look_here, told, workers=[one], key=f"dura-look-{uuid.uuid4().hex}", pure=False
            )
            for one in threads
        }
        equal = [one for one, task in asked.items() if _is_equal(client, address, one, task, end)]
        if equal:
            return sum(threads[one] for one in equal)


def _is_equal(client: Any, address: str, worker: str, task: Any, end: float) -> bool:
    """Whether a worker is as this process; not if it is gone, and nothing is simulated there.

    Raises:
        ConfigurationError: If it differs, or says nothing in time.
    """
    where = f"the Dask worker {worker}"
    try:
        found = json.loads(result_of(_answer(client, worker, task, end)))
    except Exception as error:  # whatever goes wrong there
        if client.status == "running" and worker not in client.nthreads():
            return False
        raise ConfigurationError(
            f"{where} cannot simulate: {describe_error(error)}",
            key=KEY,
            found=address,
            remedy="start workers in an environment with the same pytest-dura",
        ) from None
    refuse(where, machine(), found)
    return True


def _answer(client: Any, worker: str, task: Any, end: float) -> bytes:
    """What a task comes to that only this worker may carry out, as long as it is there.

    Raises:
        TimeoutError: If the worker is gone, or the time is over.
    """
    # Dask would keep the task for a worker of this name, which never comes back.
    while not task.done() and time.monotonic() < end and worker in client.nthreads():
        time.sleep(_SOON)
    if not task.done():
        raise TimeoutError("it is gone, or does not answer")
    # What is done is still to be fetched, from a machine that may do much else.
    return cast("bytes", task.result(timeout=_SECONDS_TO_FETCH))


def _dask_of(told: Mapping[str, Any]) -> dict[str, str]:
    """What a client and a scheduler have to have in common to understand each other."""
    packages = told["packages"]
    found = {name: str(packages[name]) for name in ("dask", "distributed")}
    return {"Python": ".".join(str(packages["python"]).split(".")[:2]), **found}


def no_scheduler(address: str, error: Exception) -> ConfigurationError:
    """Nobody answers, or it is no scheduler."""
    return ConfigurationError(
        "there is no Dask scheduler at this address, or it does not answer",
        key=KEY,
        found=f"{address} ({type(error).__name__})",
        expected="the address that `dask scheduler` prints, as dask://HOST:PORT",
        remedy="start one: dask scheduler --host localhost --port 8786",
    )


def no_workers(address: str, seconds: float) -> ConfigurationError:
    """There has been no worker for so long."""
    return ConfigurationError(
        f"the Dask scheduler has had no worker for {seconds:g} s",
        key=KEY,
        found=address,
        expected="at least one worker",
        remedy=f"start some: dask worker {address} --nthreads 1",
    )


def lost(address: str) -> ConfigurationError:
    """The scheduler is gone."""
    return ConfigurationError(
        "the connection to the Dask scheduler is lost",
        key=KEY,
        found=address,
        remedy="start the scheduler again, and go on with --dura-resume",
    )


@contextmanager
def no_warnings() -> Iterator[None]:
    """Dask warns of versions that differ, which are compared anyway, and of loops at its end."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
