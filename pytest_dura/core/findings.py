"""What a conformance kit found: breaches while it runs, and the report of a clean run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from pytest_dura.core.errors import ConformanceError, describe_error
from pytest_dura.core.role_spec import RoleSpec


@dataclass(frozen=True)
class ConformanceReport:
    """The outcome of a conformance kit that found no breach.

    Args:
        subject: What was checked.
        checked: The properties that hold, in words.
        not_supported: Optional parts of the contract that the subject says it does not have.
    """

    subject: str
    checked: tuple[str, ...]
    not_supported: tuple[str, ...]


class Findings:
    """Collects breaches, so that one run of a kit tells all of them."""

    def __init__(self, subject: str) -> None:
        self.subject = subject
        self.breaches: list[tuple[str, str]] = []
        self.checked: list[str] = []
        self.not_supported: list[str] = []

    def breach(self, problem: str, remedy: str) -> None:
        """Something is wrong. The same finding counts once."""
        if (problem, remedy) not in self.breaches:
            self.breaches.append((problem, remedy))

    @contextmanager
    def checking(self, what: str) -> Iterator[None]:
        """One property; an error that nothing else explains is a breach of it.

        ``NotImplementedError`` says that an optional part is not supported.
        """
        try:
            yield
        except NotImplementedError:
            self.not_supported.append(what)
        except Exception as error:
            self.breach(f"{what}: raised {describe_error(error)}", "make this call succeed")
        else:
            if what not in self.checked:
                self.checked.append(what)

    def report(self) -> ConformanceReport:
        """The report.

        Raises:
            ConformanceError: If there are breaches.
        """
        if self.breaches:
            raise ConformanceError(self.subject, self.breaches)
        return ConformanceReport(self.subject, tuple(self.checked), tuple(self.not_supported))


def builder(factory: RoleSpec | Callable[[], Any]) -> tuple[str, Callable[[], Any]]:
    """The name of a factory, and how to build a fresh object with it."""
    if isinstance(factory, RoleSpec):
        return factory.path, factory.create
    return getattr(factory, "__qualname__", type(factory).__qualname__), factory
