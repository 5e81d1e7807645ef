"""A user's own argument: a file in the manner of gsn2x, read safely, with the line of each key."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NoReturn

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.formats.gsn.element import PREFIXES, kind_of
from pytest_dura.evidence.text import name

MAX_BYTES = 1024 * 1024
MAX_DEPTH = 8
KEY = "--dura-argument"

_LISTS = ("supportedBy", "inContextOf", "defeatedRelation")
_FLAGS = ("undeveloped", "defeated")
_TEXTS = ("text", "challenges", "url")
_REFUSED = {
    "name": "gsn2x takes whatever has a `name` for a module; call the key otherwise",
    "nodeType": "let the id begin with the prefix of its kind instead",
    "alias": "aliases belong to the generated elements; call the key otherwise",
}

UserArgument = Mapping[str, Any]
"""Plain data, as it goes into the record: ``path``, ``sha256``, ``elements`` and ``lines``."""


def read_user_argument(path: Path) -> dict[str, Any]:
    """Read and check a user's argument. What it refers to is checked when it is merged.

    Returns:
        ``path`` as given, ``sha256`` of the file, ``elements`` by id under the keys of gsn2x, and
        ``lines`` of each ``id`` and ``id.key``.

    Raises:
        ConfigurationError: If the file cannot be read, is no YAML of elements, or uses anchors,
            aliases, tags or a key twice.
    """
    file = str(path)
    try:
        raw = path.read_bytes() if path.is_file() else None
    except OSError as error:
        _refuse(f"the file cannot be read: {error.strerror}", file, expected="a readable file")
    if raw is None:
        _refuse("this is not a file", file, expected="a YAML file in the manner of gsn2x")
    if len(raw) > MAX_BYTES:
        _refuse(
            "the file is too large",
            file,
            found=f"{len(raw)} bytes",
            expected=f"at most {MAX_BYTES} bytes",
        )
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        _refuse("the file is not UTF-8 text", file, line=line, expected="YAML in UTF-8")
    reader = _Reader(file)
    elements = reader.elements(text)
    return {
        "path": file,
        "sha256": hashlib.sha256(raw).hexdigest(),
        "elements": elements,
        "lines": reader.lines,
    }


def refuse(
    user: UserArgument, problem: str, key: str, *, found: str = "", expected: str, remedy: str = ""
) -> NoReturn:
    """The error of something in a user's argument, with its line.

    Raises:
        ConfigurationError: Always.
    """
    line = user["lines"].get(key) or user["lines"].get(key.partition(".")[0])
    _refuse(
        problem, user["path"], line=line, key=key, found=found, expected=expected, remedy=remedy
    )


def check_requirements(user: UserArgument, requirements: Iterable[str]) -> None:
    """Check what is known before anything runs: that the requirements referred to exist.

    Raises:
        ConfigurationError: For ``requirement:ID`` of an unknown requirement.
    """
    known = sorted(requirements)
    for id_, node in user["elements"].items():
        for key in (*_LISTS, "challenges"):
            for one in [node[key]] if isinstance(node.get(key), str) else node.get(key, []):
                told = one.removeprefix("requirement:")
                if told != one and told not in known:
                    refuse(
                        user,
                        "this requirement is not part of the session",
                        f"{id_}.{key}",
                        found=one,
                        expected=f"one of {', '.join(known) or 'none'}",
                        remedy="correct the id, or select the scenarios that judge it",
                    )


def _refuse(
    problem: str,
    file: str,
    *,
    line: int | None = None,
    key: str = KEY,
    found: str = "",
    expected: str,
    remedy: str = "",
) -> NoReturn:
    raise ConfigurationError(
        problem,
        file=file,
        line=line,
        key=key,
        found=found or None,
        expected=expected,
        remedy=remedy or "correct the file, or leave the option out",
    ) from None


class _Reader:
    """Turns the nodes of one file into elements, and notes their lines."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.lines: dict[str, int] = {}

    def elements(self, text: str) -> dict[str, Any]:
        import yaml

        try:
            self._events(text)
            root = yaml.compose(text, Loader=yaml.SafeLoader)
        except yaml.YAMLError as error:
            mark = getattr(error, "problem_mark", None)
            _refuse(
                "the file is not valid YAML",
                self.file,
                line=mark.line + 1 if mark is not None else 1,
                found=str(getattr(error, "problem", None) or getattr(error, "reason", error)),
                expected="valid YAML",
            )
        if not isinstance(root, yaml.MappingNode):
            _refuse("the file holds no elements", self.file, line=1, expected="`G1:` and others")
        found = self._mapping(root, "")
        found.pop("module", None)
        if not found:
            _refuse("the file holds no elements", self.file, line=1, expected="`G1:` and others")
        return {id_: self._element(id_, node) for id_, node in found.items()}

    def _events(self, text: str) -> None:
        """Refuse what could explode or make objects, before anything is built from it."""
        import yaml

        depth = 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            line = event.start_mark.line + 1 if event.start_mark is not None else 1
            anchor = getattr(event, "anchor", None)
            tag = getattr(event, "tag", None)
            if anchor is not None or tag is not None:
                _refuse(
                    "anchors, aliases and tags are not allowed here",
                    self.file,
                    line=line,
                    found=f"&{anchor}" if anchor is not None else str(tag),
                    expected="plain text, lists and mappings",
                )
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                _refuse(
                    "the file is nested too deeply",
                    self.file,
                    line=line,
                    expected=f"at most {MAX_DEPTH} levels",
                )

    def _mapping(self, node: Any, path: str) -> dict[str, Any]:
        import yaml

        found: dict[str, Any] = {}
        for key_node, value in node.value:
            line = key_node.start_mark.line + 1
            key = str(key_node.value)
            inner = f"{path}.{key}" if path else key
            if not isinstance(key_node, yaml.ScalarNode) or key in found:
                _refuse(
                    "a key stands here twice" if key in found else "a key is text",
                    self.file,
                    line=line,
                    key=inner if key in found else path,
                    expected="each key once, as text",
                )
            self.lines.setdefault(inner, line)
            found[key] = self._plain(value, inner)
        return found

    def _plain(self, node: Any, path: str) -> Any:
        import yaml

        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, path)
        if isinstance(node, yaml.SequenceNode):
            return [self._plain(one, path) for one in node.value]
        if node.style is None and node.value in ("true", "false"):
            return bool(node.value == "true")
        return node.value

    def _element(self, id_: str, node: Any) -> dict[str, Any]:
        if kind_of(id_) is None:
            self._wrong(id_, "the id begins with no known prefix", id_, ", ".join(PREFIXES))
        if name(id_) != id_ or id_ != id_.strip() or "->" in id_:
            expected = "at most 120 that can be seen, without ->"
            self._wrong(id_, "the id has odd or too many characters", id_, expected)
        if not isinstance(node, dict):
            self._wrong(id_, "an element is a mapping", str(node)[:80], "`text:` and other keys")
        for key, value in node.items():
            if key in _REFUSED:
                self._wrong(f"{id_}.{key}", "this key cannot be used", key, _REFUSED[key])
            if key in _FLAGS and not isinstance(value, bool):
                self._wrong(f"{id_}.{key}", "no truth value", str(value)[:80], "true or false")
            if key in _TEXTS and not isinstance(value, str):
                self._wrong(f"{id_}.{key}", "no text", str(value)[:80], "text")
            if key in _LISTS and not _names(value):
                self._wrong(f"{id_}.{key}", "no list of ids", str(value)[:80], "[G2, S1]")
        if not node.get("text"):
            self._wrong(id_, "an element has a text", "none", "`text:`")
        return {key: [value] if key in _LISTS and isinstance(value, str) else value
                for key, value in node.items()}  # fmt: skip

    def _wrong(self, key: str, problem: str, found: str, expected: str) -> NoReturn:
        line = self.lines.get(key)
        _refuse(problem, self.file, line=line, key=key, found=found, expected=expected)


def _names(value: Any) -> bool:
    return isinstance(value, str) or (
        isinstance(value, list) and all(isinstance(one, str) for one in value)
    )
