"""The address of an episode: what it was simulated from and by, so that equal ones are shared."""

from __future__ import annotations

import hashlib
import inspect
import platform
import sys
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

from pytest_dura.core.episode import canonical
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.execution.task import EpisodeTask
from pytest_dura.library.roles import LocalRole
from pytest_dura.provenance import (
    describe_arithmetic,
    describe_packages,
    describe_variable,
    user_code,
)
from pytest_dura.provenance import tool_code as our_own_code

PACKAGE = "pytest_dura"
_MODELS = "pytest_dura.llm.session"
VARIABLE_PREFIX = "environment variable "
"""How the parts begin that say what a variable is set to."""
_File = tuple[Path, str]
"""A file, and the dotted name of its module."""


@dataclass(frozen=True)
class Address:
    """Where an episode is found, and what has to be equal for it to be the same.

    Args:
        name: SHA-256 of the parts.
        parts: What it depends on, in words, and the digest or version of each: the inputs, the
            code of each role, the versions of packages.
    """

    name: str
    parts: Mapping[str, str]

    def changed(self, parts: Mapping[str, str]) -> list[str]:
        """What differs from the parts of another episode, in words."""
        names = sorted(self.parts.keys() | parts.keys())
        return [name for name in names if self.parts.get(name) != parts.get(name)]

    @property
    def of_any_machine(self) -> Address:
        """Without environment variables, which say where workers find their devices and folders."""
        parts = {
            name: part for name, part in self.parts.items() if not name.startswith(VARIABLE_PREFIX)
        }
        return Address(_address_name(parts), parts)


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
        variables = frozenset().union(*(item.variables for item in known))
        return cls(" ".join(episode.digest for episode in known), variables)


class Addresses:
    """Makes addresses; each piece of code is read once, as it is when it is first needed."""

    def __init__(self) -> None:
        self._codes: dict[_File, _Code | None] = {}
        self._known: dict[Hashable, _Code | None] = {}

    def of(self, task: EpisodeTask) -> Address | None:
        """The address of an episode.

        ``None`` for one that means something in this process only, or whose code is in no file
        that can be read: whether another one is the same nobody can tell.

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
        return Address(_address_name(parts), parts)

    def _of_part(self, part: RoleSpec) -> _Code | None:
        key = part.target if isinstance(part, LocalRole) else part.path
        return self._of_files(key, lambda: _files_of(part))

    def _of_files(self, key: Hashable, files: Callable[[], Iterable[_File]]) -> _Code | None:
        """The code of the files that something is defined in, looked for once."""
        if key not in self._known:
            found = [self._code(*file) for file in files()]
            self._known[key] = _Code.joined(found)
        return self._known[key]

    def _code(self, file: Path, module: str) -> _Code | None:
        """The code that a file rests on, ours apart, which is a part of its own."""
        if module.partition(".")[0] == PACKAGE:
            return _Code(PACKAGE)
        if (file, module) not in self._codes:
            found = user_code(file, module)
            code = None if found is None else _Code(found.digest, found.variables)
            self._codes[file, module] = code
        return self._codes[file, module]


def _address_name(parts: Mapping[str, str]) -> str:
    """The name of the address that has these parts."""
    return hashlib.sha256(canonical(parts)).hexdigest()


def _files_of(part: RoleSpec) -> dict[_File, None]:
    """Where a part is defined: its class or function, and what its path names, if it differs."""
    file = _file_of(part.resolve())
    module = part.path.partition(":")[0]
    if not isinstance(part, LocalRole):
        file |= _file_of_module(module)
    return file


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
    """Who answers what the roles ask of language models; ``None`` if they ask none.

    A cassette that is replayed is as much an input as a scenario. Of a server the settled
    parameters of the role say all that is known.
    """
    module = sys.modules.get(_MODELS)
    asked = any(isinstance(role.params.get("model"), str) for role in task.spec.roles.values())
    if module is None or not asked:
        return None
    session = module.in_use()
    if session is None or session.cassette is None or session.mode != "replay":
        return "live" if session is None else str(session.mode)
    file = session.cassette.file
    stat = file.stat()
    return f"replay {_digest_of(file, stat.st_size, stat.st_mtime_ns)}"


@cache
def _digest_of(file: Path, _size: int, _changed: int) -> str:
    """SHA-256 of a file, read once as long as it stays as it is."""
    state = hashlib.sha256()
    with file.open("rb") as opened:
        while chunk := opened.read(1 << 20):
            state.update(chunk)
    return state.hexdigest()


def _inputs(task: EpisodeTask) -> dict[str, str]:
    """What the task says, by what a user changes together."""
    spec = task.spec
    told = spec.to_json()
    groups = {
        "scenario": told["scenario"],
        "faults": told["faults"],
        "roles and their parameters": [told["simulator"], told["roles"]],
        "policy, end, time step and budget": [
            told[name] for name in ("policy", "termination", "time_step", "time_budget")
        ],
    }
    if task.judging:
        # All that ends an episode; another rate or wording makes no other one of it.
        judging = [item.to_json() for item in task.judging]
        groups["requirements that end it"] = [[item["check"], item["paired"]] for item in judging]
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
        "code of pytest-dura": our_own_code(),
        "arithmetic": hashlib.sha256(canonical(describe_arithmetic())).hexdigest(),
        "platform": f"{platform.system()} {platform.machine()}",
        "Python": sys.version.split()[0],
        **describe_packages(),
    }
