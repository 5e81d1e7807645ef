"""Address of an episode: what it was simulated from and by, so that equal ones are shared.

With it :func:`simulate`, which every process calls that simulates for another one, and which
refuses an episode whose address would be another one there.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import platform
import sys
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any

from pytest_dura.core.codec import encode
from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.execution.codec import pack
from pytest_dura.execution.task import EpisodeTask
from pytest_dura.execution.warning_filters import filtered
from pytest_dura.execution.worker import begin
from pytest_dura.library.roles import LocalRole
from pytest_dura.provenance import (
    describe_arithmetic,
    describe_packages,
    describe_variable,
    tool_code,
    user_code,
)

PACKAGE = "pytest_dura"
VARIABLE_PREFIX = "environment variable "
"""How the parts begin that hold the value of an environment variable."""
_MODELS = "pytest_dura.llm.session"
_THIS_SESSION = "another process of this session"
_LONGEST_VALUE = 60
_File = tuple[Path, str]
"""A file, and the dotted name of its module."""


@dataclass(frozen=True)
class Address:
    """Content address of an episode: equal addresses mean equal episodes.

    Args:
        name: SHA-256 of the parts.
        parts: What the episode depends on, in words, and the digest or version of each: the
            inputs, the code of each role, the versions of packages.
        root: The root of the project whose code it names; ``None`` if that is not known.
    """

    name: str
    parts: Mapping[str, str]
    root: str | None = None

    @classmethod
    def of(cls, parts: Mapping[str, str], root: str | None = None) -> Address:
        """The address that has these parts."""
        return cls(hashlib.sha256(canonical(parts)).hexdigest(), parts, root)

    def changed(self, parts: Mapping[str, str]) -> list[str]:
        """Names of the parts that another episode does not share, sorted."""
        names = sorted(self.parts.keys() | parts.keys())
        return [name for name in names if self.parts.get(name) != parts.get(name)]

    @property
    def of_any_machine(self) -> Address:
        """Without environment variables, which say where workers find their devices and folders."""
        return Address.of({
            name: part for name, part in self.parts.items() if not name.startswith(VARIABLE_PREFIX)
        })  # fmt: skip


@dataclass(frozen=True)
class _Code:
    """A digest of code, and the environment variables that it reads."""

    digest: str
    variables: frozenset[str] = frozenset()

    @classmethod
    def joined(cls, codes: Sequence[_Code | None]) -> _Code | None:
        """That of several files; ``None`` if one of them is not known, or there is none."""
        known = [code for code in codes if code is not None]
        if not known or len(known) < len(codes):
            return None
        variables = frozenset().union(*(code.variables for code in known))
        return cls(" ".join(code.digest for code in known), variables)


class Addresses:
    """Makes addresses; each piece of code is read once, as it is when it is first needed.

    Args:
        root: The project's root, see :func:`pytest_dura.provenance.user_code`.
    """

    def __init__(self, root: str | None = None) -> None:
        self._root = root
        self._by_file: dict[_File, _Code | None] = {}
        self._by_target: dict[Hashable, _Code | None] = {}

    def of(self, task: EpisodeTask) -> Address | None:
        """The address of an episode.

        ``None`` for one that means something in this process only, or whose code is in no file
        that can be read: such an episode cannot be compared with any other.

        Raises:
            ConfigurationError: If a part cannot be imported.
        """
        if task.local:
            return None
        parts = {**describe_machine(), **_inputs(task)}
        codes = {f"{name} {part.path}": self._of_part(part) for name, part in task.parts.items()}
        for name, metric in sorted(task.metrics.items()):
            codes[f"metric {name}"] = self._of_files(metric, partial(_file_of, metric))
        for name, code in codes.items():
            if code is None:
                return None
            parts[f"code of the {name}"] = code.digest
            parts |= {
                VARIABLE_PREFIX + variable: describe_variable(variable)
                for variable in code.variables
            }
        answers = model_answers(task)
        if answers is not None:
            parts["answers of language models"] = answers
        return Address.of(parts, self._root)

    def _of_part(self, part: RoleSpec) -> _Code | None:
        key = part.target if isinstance(part, LocalRole) else part.path
        return self._of_files(key, partial(_files_of, part))

    def _of_files(self, target: Hashable, files: Callable[[], Iterable[_File]]) -> _Code | None:
        if target not in self._by_target:
            self._by_target[target] = _Code.joined([self._code(*file) for file in files()])
        return self._by_target[target]

    def _code(self, file: Path, module: str) -> _Code | None:
        """The code that a file rests on, ours apart, which is a part of its own."""
        if module.partition(".")[0] == PACKAGE:
            return _Code(PACKAGE)
        if (file, module) not in self._by_file:
            code = user_code(file, module, None if self._root is None else Path(self._root))
            known = None if code is None else _Code(code.digest, code.variables)
            self._by_file[file, module] = known
        return self._by_file[file, module]


def _files_of(part: RoleSpec) -> dict[_File, None]:
    """Where a part is defined: its class or function, and what its path names, if it differs."""
    files = _file_of(part.resolve())
    if not isinstance(part, LocalRole):
        files |= _file_of_module(part.path.partition(":")[0])
    return files


def _file_of(target: Callable[..., Any]) -> dict[_File, None]:
    """File and module of a class or function; nothing for what is built in."""
    target = inspect.unwrap(target)
    module = getattr(target, "__module__", None) or ""
    try:
        file = inspect.getsourcefile(target)
    except TypeError:  # no class or function, or one of a module without Python code
        return _file_of_module(module)
    if file is None or not Path(file).is_file():
        return _file_of_module(module)
    return {(Path(file).absolute(), module): None}


def _file_of_module(name: str) -> dict[_File, None]:
    file = getattr(sys.modules.get(name), "__file__", None)
    return {(Path(file).absolute(), name): None} if file and Path(file).is_file() else {}


def model_answers(task: EpisodeTask) -> str | None:
    """What answers the language models that the roles of a task call; ``None`` if they call none.

    A cassette that is replayed is as much an input as a scenario. Of a server the resolved
    parameters of the role say all that is known.
    """
    calls_models = any(
        isinstance(role.params.get("model"), str) for role in task.spec.roles.values()
    )
    module = sys.modules.get(_MODELS)
    if module is None or not calls_models:
        return None
    session = module.in_use()
    if session is None or session.cassette is None or session.mode != "replay":
        return "live" if session is None else str(session.mode)
    file = session.cassette.file
    stat = file.stat()
    return f"replay {_file_digest(file, stat.st_size, stat.st_mtime_ns)}"


# Each episode has an address, and a cassette may have many megabytes.
@lru_cache(maxsize=4)
def _file_digest(file: Path, _size: int, _changed: int) -> str:
    """SHA-256 of a file, read once as long as it stays as it is."""
    state = hashlib.sha256()
    with file.open("rb") as opened:
        while chunk := opened.read(1 << 20):
            state.update(chunk)
    return state.hexdigest()


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
    if spec.timeouts is not None:
        groups["recorded timeouts"] = list(spec.timeouts)
    return {
        "case": spec.case,
        "run": str(spec.run),
        "seed": str(spec.seed),
        "kept for viewers": str(task.recorded),
        "repetition": str(task.again),
        **{name: hashlib.sha256(canonical(group)).hexdigest() for name, group in groups.items()},
    }


@cache
def describe_machine() -> dict[str, str]:
    """What every episode of this process depends on: our code, Python, packages, arithmetic."""
    return {
        "code of pytest-dura": tool_code(),
        "arithmetic": hashlib.sha256(canonical(describe_arithmetic())).hexdigest(),
        "platform": f"{platform.system()} {platform.machine()}",
        "Python": sys.version.split()[0],
        **describe_packages(),
    }


def machine_json() -> bytes:
    """JSON of :func:`describe_machine`, as another process calls for it."""
    return json.dumps(describe_machine()).encode()


def preload(paths: Sequence[str]) -> bytes:
    """Import what episodes will need in the process in which this is called.

    Args:
        paths: Import paths of simulators and roles; what cannot be imported is passed over, since
            the first episode that needs it says so.
    """
    describe_machine()
    _import(paths)
    return b""


def _import(paths: Iterable[str]) -> None:
    for path in paths:
        with suppress(Exception):  # importing runs the code of users
            RoleSpec(path).resolve()


@cache
def _addresses_here(root: str | None) -> Addresses:
    """Those of a process that simulates for others.

    As long as the process lives, as the modules do that it has imported: calls from other
    processes reach it by the names of functions, and share no object.
    """
    return Addresses(root)


def simulate(
    task: str,
    conditions: Mapping[str, Any] | None = None,
    filters: Sequence[Sequence[Any]] | None = None,
    *,
    seconds: float | None = None,  # noqa: ARG001 - the parent process reads it
) -> bytes:
    """Simulate an episode in the process in which this is called.

    Args:
        task: JSON of :meth:`EpisodeTask.to_json`.
        conditions: ``name``, ``parts`` and ``root`` of the :class:`Address` that the episode must
            have here, and ``where`` this is in words, if it is no process of the same session.
        filters: The warning filters that apply while it runs, see
            :func:`pytest_dura.execution.warning_filters.warning_filters`.
        seconds: The limit that the process is held to, once all has been imported.

    Returns:
        The episode, packed.

    Raises:
        ConfigurationError: If a part cannot be built here, or is not the same here.
    """
    here = EpisodeTask.from_json(json.loads(task))
    if conditions is not None:
        _check_address(here, **conditions)
    _import(part.path for part in here.parts.values())
    begin()
    calls = _model_call_count()
    with filtered(filters):
        episode = here.run()
    if _model_call_count() != calls:
        raise ConfigurationError(
            "a component asks a language model, and its parameters do not say which",
            key="--dura-executor",
            found=here.spec.component,
            expected="parameters `model` and `fingerprint`, which `Role.resolve_parameters` states",
            remedy="derive it from pytest_dura.llm.planner.LlmGenerator, or use"
            " --dura-executor=in-process",
        )
    try:
        return pack(episode)
    except TypeError as error:
        raise ConfigurationError(
            f"an episode cannot be sent from the process that simulated it: {error}",
            key="--dura-executor",
            found=here.spec.id,
            remedy="let events hold plain data alone, or use --dura-executor=in-process",
        ) from None


def _check_address(
    task: EpisodeTask,
    name: str,
    parts: Mapping[str, str],
    root: str | None = None,
    where: str = _THIS_SESSION,
) -> None:
    """Refuse a task whose address in this process is another one than that given."""
    expected, here = Address(name, parts), _addresses_here(root).of(task)
    if where != _THIS_SESSION:
        expected, here = expected.of_any_machine, here and here.of_any_machine
    if here is None or here.name != expected.name:
        refuse_differences(where, expected.parts, {} if here is None else here.parts)


def refuse_differences(where: str, expected: Mapping[str, str], found: Mapping[str, str]) -> None:
    """Refuse to simulate where a part of an address differs.

    Args:
        where: The place, in words.
        expected: Parts of this session.
        found: Parts at the place.

    Raises:
        ConfigurationError: If any part differs; the first one is shown.
    """
    changed = Address("", expected).changed(found)
    if not changed:
        return
    first = changed[0]
    raise ConfigurationError(
        f"{where} would simulate other episodes than this session: it differs in "
        + ", ".join(changed),
        key="--dura-executor",
        found=f"{first}: {_shown(found.get(first))}",
        expected=f"{first}: {_shown(expected.get(first))}",
        remedy=_difference_remedy(first, where),
    )


def _difference_remedy(part: str, where: str) -> str:
    if part.startswith(VARIABLE_PREFIX):
        return "set it before the session begins: processes that simulate are started once"
    if where == _THIS_SESSION:
        return "files changed while the session ran: start it again"
    if part.startswith("code "):
        return "install or mount the same files there, and start the worker again"
    if part == "arithmetic":
        return "use machines with the same kind of processor and the same build of NumPy"
    return "install the same there; `python -m pip freeze` on both tells what differs"


def _shown(value: str | None) -> str:
    if value is None:
        return "nothing"
    return value if len(value) <= _LONGEST_VALUE else f"{value[:16]}…"


def _model_call_count() -> int:
    """How often language models were called in this process."""
    module = sys.modules.get(_MODELS)
    session = None if module is None else module.in_use()
    return 0 if session is None else sum(session.counts.values())
