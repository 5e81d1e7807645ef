"""Address of an episode: what it is run from, so that equal ones are shared within a session.

With it :func:`simulate`, which every process calls that simulates for another one, and which
refuses to where the machine or the code would be another one.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import logging
import platform
import sys
from bdb import BdbQuit
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import import_module
from types import ModuleType
from typing import Any

from pytest_dura import guests
from pytest_dura.core.boundary import SessionWanted
from pytest_dura.core.calls import current_calls
from pytest_dura.core.codec import encode
from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.execution.codec import pack
from pytest_dura.execution.replies import attach, begin, give_way
from pytest_dura.execution.sources import LoadedModules, differences, module_file
from pytest_dura.execution.surroundings import StateOfProcess, applied
from pytest_dura.execution.task import EpisodeTask, is_named
from pytest_dura.library.roles import LocalRole
from pytest_dura.provenance import describe_arithmetic, describe_packages, tool_code

_THIS_SESSION = "another process of this session"
_LONGEST_VALUE = 60
_MODULE = "module "
"""How the parts begin that hold the content of a module."""


@dataclass(frozen=True)
class Address:
    """Address of an episode within a session: equal addresses mean equal episodes.

    Args:
        name: SHA-256 of the parts.
        parts: What the episode is run from, in words, and a digest of each.
    """

    name: str
    parts: Mapping[str, str]

    def changed(self, parts: Mapping[str, str]) -> list[str]:
        """Names of the parts that another episode does not share, sorted."""
        return differences(self.parts, parts)


def address_of(task: EpisodeTask) -> Address | None:
    """Make the address of an episode; ``None`` for one that means something here only."""
    if reason_unaddressed(task):
        return None
    parts = _inputs(task)
    return Address(hashlib.sha256(canonical(parts)).hexdigest(), parts)


def reason_unaddressed(task: EpisodeTask) -> str:
    """Why an episode can be compared with none of another process or session; empty if it can."""
    for name, metric in task.metrics.items():
        if not is_named(metric):
            return f"the metric {name} is a lambda, or stands within a function or class"
    for name, part in task.parts.items():
        if part.opaque:
            return f"its {name} is a bare instance"
        if isinstance(part, LocalRole) and not is_named(part.target):
            return f"the class of its {name} stands within a function or class"
        if not _has_file(part):
            return f"the class of its {name} is in no file"
    return ""


def _has_file(part: RoleSpec) -> bool:
    """Whether a part comes from a file, so that another session sees whether it has changed."""
    if isinstance(part, LocalRole):
        return module_file(part.target.__module__) is not None
    name = part.path.partition(":")[0]
    if name not in sys.modules:
        part.resolve()
    return _module_has_file(part.path, sys.modules.get(name))


@lru_cache(maxsize=512)  # each episode has an address
def _module_has_file(path: str, module: ModuleType | None) -> bool:
    target = inspect.unwrap(RoleSpec(path).resolve())
    names = (getattr(module, "__name__", ""), getattr(target, "__module__", None) or "")
    return any(module_file(name) is not None for name in names)


def _inputs(task: EpisodeTask) -> dict[str, str]:
    """Digests of what the task says, by what a user changes together."""
    spec = task.spec
    data = spec.to_json()
    groups = {
        "scenario": data["scenario"],
        "faults": data["faults"],
        "roles and their parameters": [data["simulator"], data["roles"]],
        "policy, end, time step and budget": [
            data[name] for name in ("policy", "termination", "time_step", "time_budget")
        ],
    }
    if task.judging:
        # All that ends an episode; another rate or wording makes no other one of it.
        judging = [[each.check, encode(each.paired)] for each in task.judging]
        groups["requirements that end it"] = judging
    if task.metrics:
        groups["metrics"] = {
            name: f"{metric.__module__}:{metric.__qualname__}"
            for name, metric in task.metrics.items()
        }
    if "clock" in data:
        groups["clock and latency"] = data["clock"]
    if spec.timeouts is not None:
        groups["recorded timeouts"] = list(spec.timeouts)
    return {
        "case": spec.case,
        "run": str(spec.run),
        "seed": str(spec.seed),
        "kept for viewers": str(task.recorded),
        "repetition": str(task.again),
        **{name: hashlib.sha256(canonical(group)).hexdigest() for name, group in groups.items()},
        **dict(guests.inputs_of(spec.roles.values())),
    }


@cache
def describe_machine() -> dict[str, str]:
    """What every episode of this process depends on: our code, Python, packages, arithmetic."""
    return {**describe_interpreter(), **describe_packages()}


def describe_interpreter() -> dict[str, str]:
    """The same without packages."""
    return {
        "code of pytest-dura": tool_code(),
        "arithmetic": hashlib.sha256(canonical(describe_arithmetic())).hexdigest(),
        "platform": f"{platform.system()} {platform.machine()}",
        "Python": sys.version.split()[0],
    }


def machine_json() -> bytes:
    """JSON of :func:`describe_machine`, as another process calls for it."""
    return json.dumps(describe_machine()).encode()


def preload(paths: Sequence[str]) -> None:
    """Import what episodes will need in the process in which this is called.

    Args:
        paths: Import paths of simulators and roles; what cannot be imported is passed over, since
            the first episode that needs it says so.
    """
    describe_machine()
    _import(zip(paths, paths, strict=True))
    _LOADED.digests()


def _import(paths: Iterable[tuple[str, str]]) -> None:
    """Import parts, each a call of whom it is of."""
    for name, path in paths:
        with suppress(Exception), current_calls().calling(name):  # it runs the code of users
            for module in getattr(RoleSpec(path).resolve(), "imports", ()):
                import_module(module)


_SIMULATED: set[str] = set()
"""Components of episodes that this process has simulated for another one."""
_LOADED = LoadedModules()
"""Modules of a process that simulates for others. As long as it lives, as the modules do that it
has imported: calls from other processes reach it by the names of functions, and share no object."""


def conditions_of(modules: LoadedModules) -> dict[str, Any]:
    """What must be equal in another process that simulates for this one.

    Args:
        modules: Those of this process.
    """
    return {"machine": describe_machine(), "modules": modules.digests()}


def simulate(
    task: str,
    conditions: Mapping[str, Any] | None = None,
    surroundings: Mapping[str, Any] | None = None,
    *,
    seconds: float | None = None,  # noqa: ARG001 - the parent process reads it
) -> bytes:
    """Simulate an episode in the process in which this is called.

    Args:
        task: JSON of :meth:`EpisodeTask.to_json`.
        conditions: Of :func:`conditions_of`, and ``where`` this is in words, if it is not a
            process of the same session.
        surroundings: What applies while it runs, see
            :func:`pytest_dura.execution.surroundings.surroundings`.
        seconds: The limit that the process is held to, once all has been imported.

    Returns:
        The episode, packed.

    Raises:
        ConfigurationError: If a part cannot be built here, or is not the same here.
        SessionWanted: If the episode needs what only the session's process has.
    """
    here = EpisodeTask.from_json(json.loads(task))
    _import((name, part.path) for name, part in here.parts.items())
    if conditions is not None:
        _check_conditions(**conditions)
    return _simulated(here, surroundings)


def simulate_copied(task: EpisodeTask, surroundings: Mapping[str, Any]) -> bytes:
    """Simulate an episode in a copy of the session's process; see :func:`simulate`.

    Args:
        task: Its task.
        surroundings: See there.
    """
    return _simulated(task, surroundings)


def _simulated(task: EpisodeTask, surroundings: Mapping[str, Any] | None) -> bytes:
    begin()
    uses = guests.uses()
    before = StateOfProcess()
    with applied(surroundings) as seen:
        attach(seen)
        try:
            if task.again and task.spec.component not in _SIMULATED:
                task.run()  # for what it leaves behind: its episode is to be the same all the same
            _SIMULATED.add(task.spec.component)
            episode = task.run()
        except BdbQuit:  # of a debugger that nothing can answer here
            raise SessionWanted("it opens a debugger") from None
        left_behind = before.restore()
        if left_behind:
            give_way(left_behind)
            logging.getLogger("pytest_dura").warning(
                "%s left behind in its process %s; the next episode gets another process",
                task.spec.component, ", ".join(left_behind),
            )  # fmt: skip
    for use, count in guests.uses().items():
        if count != uses.get(use):
            raise SessionWanted(f"it {use}, which its parameters do not state")
    try:
        return pack(episode)
    except TypeError as error:
        raise ConfigurationError(
            f"an episode cannot be sent from the process that simulated it: {error}",
            key="--dura-executor",
            found=task.spec.id,
            remedy="let events hold plain data alone, or use --dura-executor=in-process",
        ) from None


def _check_conditions(
    machine: Mapping[str, str], modules: Mapping[str, str], where: str = _THIS_SESSION
) -> None:
    """Refuse to simulate where the machine, or a module that was imported here, is another one."""
    here = {name: _LOADED.digest_of(name) for name in modules}
    refuse_differences(
        where,
        {**machine, **{_MODULE + name: modules[name] for name in modules if here[name]}},
        {**describe_machine(), **{_MODULE + name: sha for name, sha in here.items() if sha}},
    )


def refuse_differences(where: str, expected: Mapping[str, str], found: Mapping[str, str]) -> None:
    """Refuse to simulate where something differs that episodes rest on.

    Args:
        where: The place, in words.
        expected: What this session rests on, by name.
        found: The same at the place.

    Raises:
        ConfigurationError: If anything differs; the first is shown.
    """
    changed = differences(expected, found)
    if not changed:
        return
    first = changed[0]
    if where == _THIS_SESSION:
        remedy = "files changed while the session ran: start it again"
    elif first.startswith(("code ", _MODULE)):
        remedy = "install or mount the same files there, and start the worker again"
    elif first == "arithmetic":
        remedy = "use machines with the same kind of processor and the same build of NumPy"
    else:
        remedy = "install the same there; `python -m pip freeze` on both tells what differs"
    raise ConfigurationError(
        f"{where} would simulate other episodes than this session: it differs in "
        + ", ".join(changed),
        key="--dura-executor",
        found=f"{first}: {_shown(found.get(first))}",
        expected=f"{first}: {_shown(expected.get(first))}",
        remedy=remedy,
    )


def _shown(value: str | None) -> str:
    if value is None:
        return "nothing"
    return value if len(value) <= _LONGEST_VALUE else f"{value[:16]}…"
