"""XML with line numbers, and a record of what of it has been used.

Nothing in a file is expanded or fetched: a document type, without which there are no entities, is
refused.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn
from xml.parsers import expat

from pytest_dura.core.errors import ConfigurationError

MAX_BYTES = 10_000_000
MAX_ELEMENTS = 100_000
MAX_DEPTH = 64
_SCHEMA = ("xmlns", "xsi:", "xml:")
"""How attributes begin that name the schema and say nothing of the scenario."""


@dataclass
class Element:
    """An element of a file.

    Args:
        file: The file, for messages.
        line: Line on which it begins.
        tag: Its name.
        attributes: Its attributes as texts.
    """

    file: str
    line: int
    tag: str
    attributes: dict[str, str]
    children: list[Element] = field(default_factory=list)
    text: str = ""
    used: bool = False
    read: set[str] = field(default_factory=set)

    def find(self, *path: str) -> Element | None:
        """Return the element at a path of tags below this one; it counts as used."""
        element: Element | None = self
        for tag in path:
            assert element is not None
            element = next((child for child in element.children if child.tag == tag), None)
            if element is None:
                return None
        if element is not None:
            self._use(path)
        return element

    def all(self, tag: str) -> list[Element]:
        """Return the children with a tag; they count as used."""
        children = [child for child in self.children if child.tag == tag]
        for child in children:
            child.used = True
        return children

    def kind(self, ending: str) -> Element | None:
        """Return the first child whose tag ends so; it does not count as used yet."""
        return next((child for child in self.children if child.tag.endswith(ending)), None)

    def get(self, name: str) -> str | None:
        """Return an attribute, which counts as used; ``None`` without it."""
        self.used = True
        self.read.add(name)
        return self.attributes.get(name)

    def require(self, name: str) -> str:
        """Return an attribute, which counts as used.

        Raises:
            ConfigurationError: If it is missing.
        """
        value = self.get(name)
        if value is None:
            self.refuse(f"{self.tag} has no attribute {name!r}", key=self.tag, expected=name)
        return value

    def refuse(self, problem: str, **details: Any) -> NoReturn:
        """Raise an error at this element.

        Raises:
            ConfigurationError: Always.
        """
        details.setdefault("remedy", "correct the file there, or leave this out")
        raise ConfigurationError(problem, file=self.file, line=self.line, **details)

    def unused(self, within: str = "") -> Iterator[tuple[Element, list[str], str]]:
        """Yield what has not been used: elements, their unused attributes, and within which tag.

        Of an element that is used, some attributes may not be.
        """
        left = [name for name in self.attributes if name not in self.read]
        left = [name for name in left if not name.startswith(_SCHEMA)]
        if not self.used or left or self.text:
            yield self, left, within
        for child in self.children:
            yield from child.unused("" if self.used else within or self.tag)

    def _use(self, path: tuple[str, ...]) -> None:
        element = self
        element.used = True
        for tag in path:
            element = next(child for child in element.children if child.tag == tag)
            element.used = True


def read_document(file: Path) -> Element:
    """Read a file.

    Returns:
        Its outermost element.

    Raises:
        ConfigurationError: If it cannot be read, is too large, is no XML, or has a document type.
    """
    name = str(file)
    if not os.path.isfile(file):  # noqa: PTH113 - never raises; what is no file could block
        raise ConfigurationError(
            "there is no such file",
            file=name,
            expected="a file to import",
            remedy="correct the path",
        )
    try:
        with file.open("rb") as opened:
            content = opened.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigurationError(
            f"the file cannot be read: {error.strerror or error}",
            file=name,
            remedy="make it readable",
        ) from None
    if len(content) > MAX_BYTES:
        raise ConfigurationError(
            "the file is too large for a scenario",
            file=name,
            expected=f"at most {MAX_BYTES // 1_000_000} MB",
            remedy="import a file of one scenario",
        )
    builder = _Builder(name)
    try:
        builder.parser.Parse(content, True)
    except expat.ExpatError as error:
        raise ConfigurationError(
            f"this is no well-formed XML: {expat.ErrorString(error.code)}",
            file=name,
            line=error.lineno,
            found=f"column {error.offset + 1}, in {len(content)} bytes",
            expected="OpenSCENARIO XML 1.x",
            remedy="correct the file there, or export it again",
        ) from None
    except (LookupError, ValueError) as error:  # of encodings
        raise ConfigurationError(
            f"the XML cannot be decoded: {error}", file=name, remedy="save it as UTF-8"
        ) from None
    assert builder.root is not None
    return builder.root


class _Builder:
    """Makes elements of what expat reports."""

    def __init__(self, file: str) -> None:
        self.root: Element | None = None
        self._file, self._open, self._count = file, list[Element](), 0
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartDoctypeDeclHandler = self._doctype
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._text

    def _doctype(self, *_: object) -> None:
        self._refuse("a document type, which may define entities", "XML without <!DOCTYPE>")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > MAX_ELEMENTS:
            self._refuse("too many elements", f"at most {MAX_ELEMENTS}")
        if len(self._open) >= MAX_DEPTH:
            self._refuse("elements that are nested too deeply", f"at most {MAX_DEPTH} levels")
        element = Element(self._file, self.parser.CurrentLineNumber, tag, dict(attributes))
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)

    def _end(self, _: str) -> None:
        self._open.pop()

    def _text(self, text: str) -> None:
        if text.strip() and self._open:
            self._open[-1].text += text.strip()

    def _refuse(self, what: str, expected: str) -> NoReturn:
        raise ConfigurationError(
            f"the file has {what}",
            file=self._file,
            line=self.parser.CurrentLineNumber,
            expected=expected,
            remedy="take it out of the file",
        )
