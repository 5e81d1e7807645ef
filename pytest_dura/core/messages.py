"""Messages: what a component sends beside its commands, on which faults may act.

The name of a message is that of a channel of every domain. A package registers what it is of, such
as what is put before a model, in the group of entry points :data:`MESSAGES`.
"""

from __future__ import annotations

from pytest_dura.core.registry import Registry

MESSAGES: Registry[str] = Registry(
    "pytest_dura.messages",
    "message",
    lambda value: isinstance(value, str),
    "a text that says what it is",
    # What types of faults act on in any domain, and what channels hold.
    reserved=frozenset({
        "any", "array", "command", "image", "message", "number", "numbers", "objects", "other",
        "pose", "signs",
    }),
)  # fmt: skip
