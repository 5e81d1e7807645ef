"""Classes: what is one, on each version of Python."""

from __future__ import annotations

from typing import TypeGuard, TypeVar

T = TypeVar("T")


def is_subclass(value: object, base: type[T]) -> TypeGuard[type[T]]:
    """Whether a value is a class of this kind.

    An alias says that it is a type without being one, and ``issubclass`` refuses it; on Python 3.10
    ``list[int]`` is such an alias.

    Args:
        value: Any object, such as an attribute of a module or an annotation.
        base: The class, which may be abstract.
    """
    return issubclass(type(value), type) and issubclass(value, base)  # type: ignore[arg-type]
