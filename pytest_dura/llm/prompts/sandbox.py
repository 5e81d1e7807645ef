"""Where templates are rendered: they see what they are given, and cannot run away."""

from __future__ import annotations

import traceback
from collections.abc import Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError, describe_error

if TYPE_CHECKING:
    from jinja2 import Environment

LONGEST = 32_768
"""Characters that one template may make."""

FILTERS = (
    "abs", "count", "default", "first", "float", "int", "items", "join", "last", "length", "list",
    "lower", "map", "max", "min", "reject", "rejectattr", "round", "select", "selectattr", "sort",
    "string", "sum", "trim", "unique", "upper",
)  # fmt: skip
"""None of them makes much of little."""


@cache
def _environment_class() -> type[Environment]:
    from jinja2.exceptions import SecurityError
    from jinja2.runtime import Macro
    from jinja2.sandbox import SandboxedEnvironment

    class Bounded(SandboxedEnvironment):
        """No calls but of macros, no products but of numbers: loops end with the data."""

        intercepted_binops = frozenset(("*", "**", "%"))

        def is_safe_callable(self, obj: Any) -> bool:
            return isinstance(obj, Macro)

        def call_binop(self, context: Any, operator: str, left: Any, right: Any) -> Any:
            numbers = isinstance(left, (int, float)) and isinstance(right, (int, float))
            if operator == "**" or not numbers:
                raise SecurityError(f"{operator!r} is for two numbers only, and '**' not at all")
            return super().call_binop(context, operator, left, right)

    return Bounded


class Renderer:
    """Templates by name, compiled.

    Args:
        sources: Text of each template, by name.
        files: Where each one stands, for messages.

    Raises:
        ConfigurationError: For one that is no template, with its file and line.
    """

    def __init__(self, sources: Mapping[str, str], files: Mapping[str, str]) -> None:
        from jinja2 import FunctionLoader, StrictUndefined

        def loaded(name: str) -> tuple[str, str, None] | None:
            return (sources[name], files[name], None) if name in sources else None

        self._files = files
        self._environment = _environment_class()(
            autoescape=False,  # a model reads it, no browser; PerceivedText guards what it holds
            undefined=StrictUndefined,
            loader=FunctionLoader(loaded),
            finalize=lambda value: "no data" if value is None else value,
            trim_blocks=True,
            lstrip_blocks=True,
            auto_reload=False,
        )
        known = self._environment.filters
        self._environment.filters = {name: known[name] for name in FILTERS}
        self._environment.globals.clear()
        for name in sources:
            self._compile(name)

    def _compile(self, name: str) -> None:
        from jinja2 import TemplateSyntaxError

        try:
            self._environment.get_template(name)
        except TemplateSyntaxError as error:
            raise ConfigurationError(
                f"no template: {error.message}",
                file=error.filename or self._files[name],
                line=error.lineno,
                expected="a jinja2 template",
                remedy="correct it, or remove it for the built-in one",
            ) from None

    def render(self, name: str, facts: Mapping[str, Any]) -> str:
        """A template in words, without white space around it.

        Raises:
            ConfigurationError: If it cannot be rendered, with its file and line.
        """
        try:
            parts = self._environment.get_template(name).generate(dict(facts))
            return _joined(parts).strip()
        except Exception as error:
            file, line = self._place(error, name)
            raise ConfigurationError(
                f"the template cannot be rendered: {describe_error(error)}",
                file=file,
                line=line,
                expected="only " + ", ".join(sorted(facts)),
                remedy="correct it, or remove it for the built-in one",
            ) from None

    def _place(self, error: Exception, name: str) -> tuple[str, int | None]:
        known = set(self._files.values())
        for frame in reversed(traceback.extract_tb(error.__traceback__)):
            if frame.filename in known:
                return frame.filename, frame.lineno
        return self._files[name], None


def _joined(parts: Iterator[str]) -> str:
    made, length = [], 0
    for part in parts:
        made.append(part)
        length += len(part)
        if length > LONGEST:
            raise OverflowError(f"it makes more than {LONGEST} characters")
    return "".join(made)
