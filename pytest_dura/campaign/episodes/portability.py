"""Which episodes another process can simulate, and why the others are simulated here."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from pytest_dura.campaign.components import LocalRole
from pytest_dura.core.role_spec import RoleSpec

if TYPE_CHECKING:
    from pytest_dura.campaign.episodes.task import EpisodeTask


def why_here(task: EpisodeTask) -> str | None:
    """Why an episode is simulated in the process that wants it; ``None`` for one that need not be.

    A component that asks a language model stays where its exchanges are counted and recorded.
    """
    return next(_reasons(task), None)


def _reasons(task: EpisodeTask) -> Iterator[str]:
    for name, part in task.parts.items():
        if isinstance(part, LocalRole) and is_named(part.target):
            yield f"the class of its {name} is in a conftest.py"
        elif isinstance(part, LocalRole) or part.path.partition(":")[0] in _PRIVATE:
            yield f"no import path leads to the class of its {name}"
        elif part.opaque:
            yield f"its {name} is a bare instance"
        elif stated_model(part) is not None:
            yield f"its {name} asks a language model"
        elif not _is_plain(part.params):
            yield f"the parameters of its {name} are no plain data"
    for name, metric in task.metrics.items():
        if not is_importable(metric):
            yield f"no import path leads to the metric {name}"


def stated_model(role: RoleSpec) -> tuple[str, str] | None:
    """Model and fingerprint of the server, if the settled parameters of a role state them."""
    server = role.params.get("server")
    place = server if isinstance(server, Mapping) else role.params
    model, fingerprint = role.params.get("model"), place.get("fingerprint")
    if isinstance(model, str) and isinstance(fingerprint, str):
        return model, fingerprint
    return None


def is_named(function: Callable[..., Any]) -> bool:
    """Whether its name in its file says which one it is, and nothing is bound to it."""
    name = getattr(function, "__qualname__", "<")
    is_plain = inspect.isclass(function) or inspect.isfunction(function)
    return is_plain and "<" not in name and getattr(function, "__closure__", None) is None


def is_importable(function: Callable[..., Any]) -> bool:
    """Whether an import path leads to it, in any process."""
    if not is_named(function) or function.__module__ in _PRIVATE:
        return False
    try:
        return RoleSpec.of(function).resolve() is function
    except Exception:  # importing runs the user's code: whatever it raises, it is not importable
        return False


def _is_plain(params: Mapping[str, Any]) -> bool:
    """Whether they are the same once they have been JSON: a tuple would come back as a list."""
    try:
        return bool(json.loads(json.dumps(dict(params))) == dict(params))
    except (TypeError, ValueError, RecursionError):
        return False


_PRIVATE = ("conftest", "__main__")
