"""What is called wherever episodes are simulated: plain data in, plain data out."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.execution.address import VARIABLE_PREFIX, Address, Addresses, describe_machine
from pytest_dura.execution.codec import pack
from pytest_dura.execution.task import EpisodeTask

_THIS_SESSION = "another process of this session"
_LLM = "pytest_dura.llm.session"
_SHORT = 60


@dataclass(frozen=True)
class Conditions:
    """What has to be equal where an episode is simulated, or it would be another one.

    Args:
        name: Of the :class:`Address`.
        parts: Of the same.
        where: Who is asked, in words.
    """

    name: str
    parts: Mapping[str, str]
    where: str = _THIS_SESSION

    @classmethod
    def of(cls, address: Address) -> Conditions:
        """Those of an episode."""
        return cls(address.name, dict(address.parts))

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def simulate(
    task: str,
    conditions: Mapping[str, Any] | None = None,
    *,
    seconds: float | None = None,  # noqa: ARG001 - who calls it in another process looks at it
) -> bytes:
    """An episode, wherever this is called.

    Args:
        task: JSON of :meth:`EpisodeTask.to_json`.
        conditions: Of :meth:`Conditions.to_json`; what differs from them is refused.
        seconds: The limit of the call, which its process is held to.

    Returns:
        The episode, packed.

    Raises:
        ConfigurationError: If a part cannot be built here, or is not the same here.
    """
    found = EpisodeTask.from_json(json.loads(task))
    if conditions is not None:
        told = Conditions(**conditions)
        here, wanted = _addresses().of(found), Address(told.name, told.parts)
        if told.where != _THIS_SESSION:
            here, wanted = here and here.of_any_machine, wanted.of_any_machine
        if here is None or here.name != wanted.name:
            refuse_differences(told.where, wanted.parts, {} if here is None else here.parts)
    asked = _model_call_count()
    episode = found.run()
    if _model_call_count() != asked:
        raise ConfigurationError(
            "a component asks a language model, and its parameters do not say which",
            key="--dura-executor",
            found=found.spec.component,
            expected="parameters `model` and `fingerprint`, which `Role.resolve_parameters` states",
            remedy="derive it from pytest_dura.llm.LlmGenerator, or use --dura-executor=in-process",
        )
    try:
        return pack(episode)
    except TypeError as error:
        raise ConfigurationError(
            f"an episode cannot be sent from the process that simulated it: {error}",
            key="--dura-executor",
            found=found.spec.id,
            remedy="let events hold plain data alone, or use --dura-executor=in-process",
        ) from None


def machine_json() -> bytes:
    """JSON of what every episode that is simulated here depends on."""
    return json.dumps(describe_machine()).encode()


def refuse_differences(where: str, expected: Mapping[str, str], found: Mapping[str, str]) -> None:
    """Refuse to simulate where something differs.

    Raises:
        ConfigurationError: If there is anything that differs.
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
    return value if len(value) <= _SHORT else f"{value[:16]}…"


def _model_call_count() -> int:
    """How often language models were asked in this process."""
    module = sys.modules.get(_LLM)
    session = None if module is None else module.in_use()
    return 0 if session is None else sum(session.counts.values())


@cache
def _addresses() -> Addresses:
    return Addresses()
