"""Read YAML safely, with the line of every key, and check it against a pydantic model."""

from __future__ import annotations

import math
import re
import types
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from yaml.composer import Composer
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from yaml.resolver import Resolver

from pytest_dura.core.classes import is_subclass
from pytest_dura.core.errors import ConfigurationError, combine_errors, corrected, did_you_mean

MAX_BYTES = 1024 * 1024
_MAX_NODES = 50_000
"""Nodes of one file, each alias counted as all that it stands for."""
MAX_DEPTH = 32
_MAX_INTEGER = 2**63

_TAG = "tag:yaml.org,2002:"


@dataclass(frozen=True)
class Document:
    """A YAML file: its data, and the line, from 1, of each dotted key (``faults.0.type``).

    Documents are always equal: a place in a file is no part of a value that was read from it.
    """

    file: str = field(default="", compare=False)
    data: Mapping[str, Any] = field(default_factory=dict, compare=False)
    lines: Mapping[str, int] = field(default_factory=dict, compare=False)

    def line_of(self, key: str) -> int | None:
        """Return the line of a key, or of the nearest key above it that is in the file."""
        while key and key not in self.lines:
            key = key.rpartition(".")[0]
        return self.lines.get(key)


def read_yaml(path: Path, *, trusted: bool = False) -> Document:
    """Read a file.

    Args:
        path: The file.
        trusted: Whether it is one of this package, which tests read by both parsers: libyaml's is
            ten times as quick, and takes some files that the other one refuses, or the reverse.

    Raises:
        ConfigurationError: If it is missing, empty, binary, too large, malformed, nested too
            deeply, or holds duplicate keys, object tags, aliases that explode, several documents,
            numbers that are not finite, or anything but a mapping.
    """
    return parse_yaml(_read_text(path), str(path), trusted=trusted)


def parse_yaml(text: str, file: str, *, trusted: bool = False) -> Document:
    """Read text as :func:`read_yaml` reads a file; ``file`` is its name in messages."""
    loader: _Loader | _QuickLoader | None = None
    try:
        quick = trusted and yaml.__with_libyaml__
        loader = _QuickLoader(text, file) if quick else _Loader(text, file)
        root = loader.only_document()
    except yaml.YAMLError as error:
        _refuse_syntax(error, file)
    finally:
        if loader is not None:
            loader.dispose()
    if root is None:
        raise ConfigurationError(
            "the file is empty",
            file=file,
            line=1,
            expected="a YAML mapping of keys to values",
            remedy="fill the file, or remove it",
        )
    if not isinstance(root, MappingNode):
        raise ConfigurationError(
            "the file does not hold a mapping",
            file=file,
            line=root.start_mark.line + 1,
            found="a list" if isinstance(root, SequenceNode) else "a single value",
            expected="keys with values, such as `name: intersection/nominal`",
            remedy="begin each line at the left margin with `key: value`",
        )
    reader = _Reader(file)
    data = reader.value(root, "")
    return Document(file, data, reader.lines)


def _read_text(path: Path) -> str:
    file = str(path)
    try:
        if not path.is_file():
            text = (
                "a directory" if path.is_dir() else "nothing" if not path.exists() else "a device"
            )
            raise ConfigurationError(
                "this is not a readable file",
                file=file,
                found=text if path.exists() else "nothing at this path",
                expected="a YAML file",
                remedy="check the path",
            )
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigurationError(
            f"the file cannot be read: {error.strerror}",
            file=file,
            expected="a readable YAML file",
            remedy="check its permissions",
        ) from None
    if len(raw) > MAX_BYTES:
        raise ConfigurationError(
            "the file is too large",
            file=file,
            line=1,
            found=f"{path.stat().st_size} bytes",
            expected=f"at most {MAX_BYTES} bytes",
            remedy="split it into several files",
        )
    if b"\0" in raw:
        _refuse_binary(file, raw, raw.index(b"\0"))
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        _refuse_binary(file, raw, error.start)


def _refuse_binary(file: str, raw: bytes, position: int) -> NoReturn:
    raise ConfigurationError(
        "the file is not UTF-8 text",
        file=file,
        line=raw.count(b"\n", 0, position) + 1,
        found=f"byte 0x{raw[position]:02x} at offset {position}",
        expected="a YAML file in UTF-8",
        remedy="check that this is the file you meant, and save it as UTF-8",
    ) from None


def _refuse_syntax(error: yaml.YAMLError, file: str) -> NoReturn:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
    context = getattr(error, "context", None)
    raise ConfigurationError(
        "the file is not valid YAML",
        file=file,
        line=mark.line + 1 if mark is not None else 1,
        found=f"{problem} ({context})" if context else problem,
        expected="valid YAML",
        remedy=f"look at column {mark.column + 1}: indentation, colons, brackets and quotes"
        if mark is not None
        else "remove the characters that YAML does not allow",
    ) from None


class _CountingComposer(Composer, Resolver):
    """Composes nodes and counts them, so that aliases which explode are refused beforehand.

    Args:
        file: Name of the file in messages.
    """

    # Of the parser that a subclass brings.
    check_event: Callable[..., bool]
    get_event: Callable[[], Any]
    peek_event: Callable[[], Any]

    def __init__(self, file: str) -> None:
        Composer.__init__(self)
        Resolver.__init__(self)
        self._file = file
        self._depth = 0
        self._sizes: dict[int, int] = {}

    def only_document(self) -> Node | None:
        """Compose the root of the only document; ``None`` if there is none."""
        self.get_event()
        if self.check_event(yaml.StreamEndEvent):
            return None
        root: Node | None = self.compose_document()
        if not self.check_event(yaml.StreamEndEvent):
            mark = self.peek_event().start_mark
            raise ConfigurationError(
                "the file holds several YAML documents",
                file=self._file,
                line=mark.line + 1,
                found="a second document after `---`",
                expected="one document",
                remedy="put each into a file of its own",
            )
        return None if root is None or root.tag == _TAG + "null" else root

    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        event = self.peek_event()
        line = event.start_mark.line + 1
        if self._depth >= MAX_DEPTH:
            raise ConfigurationError(
                "the file is nested too deeply",
                file=self._file,
                line=line,
                expected=f"at most {MAX_DEPTH} levels",
                remedy="flatten it",
            )
        alias = event.anchor if isinstance(event, yaml.AliasEvent) else None
        self._depth += 1
        node = super().compose_node(parent, index)
        assert node is not None  # the base class returns a node or raises
        self._depth -= 1
        if alias is None:
            self._sizes[id(node)] = 1 + sum(self._sizes[id(child)] for child in _children(node))
        elif id(node) not in self._sizes:
            raise ConfigurationError(
                f"the alias *{alias} stands inside what it refers to",
                file=self._file,
                line=line,
                found=f"*{alias}",
                expected="data without circles",
                remedy="write the values out",
            )
        if self._sizes[id(node)] > _MAX_NODES:
            raise ConfigurationError(
                "the file is too large once its aliases are followed",
                file=self._file,
                line=line,
                found=f"{self._sizes[id(node)]} values",
                expected=f"at most {_MAX_NODES} values",
                remedy="write out the values that are meant, without nested aliases",
            )
        return node


def _children(node: Node) -> list[Node]:
    if isinstance(node, MappingNode):
        return [child for pair in node.value for child in pair]
    return list(node.value) if isinstance(node, SequenceNode) else []


_CountingComposer.yaml_implicit_resolvers = {}  # those of YAML 1.1 are not inherited
_CountingComposer.add_implicit_resolver(
    _TAG + "null", re.compile(r"^(?:~|null|Null|NULL|)$"), ["~", "n", "N", ""]
)
_CountingComposer.add_implicit_resolver(
    _TAG + "bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
_CountingComposer.add_implicit_resolver(
    _TAG + "int", re.compile(r"^(?:[-+]?[0-9]+|0x[0-9a-fA-F]+|0o[0-7]+)$"), list("-+0123456789")
)
_CountingComposer.add_implicit_resolver(
    _TAG + "float",
    re.compile(
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
    list("-+0123456789."),
)
RESOLVERS: Mapping[str, Any] = _CountingComposer.yaml_implicit_resolvers
"""What plain scalars are read as, by their first character: for what writes files to be read."""


class _Loader(_CountingComposer, yaml.SafeLoader):
    """Parses in Python."""

    def __init__(self, text: str, file: str) -> None:
        yaml.SafeLoader.__init__(self, text)
        _CountingComposer.__init__(self, file)


if yaml.__with_libyaml__:
    from yaml._yaml import CParser

    class _QuickLoader(_CountingComposer, CParser):
        """Parses with libyaml."""

        def __init__(self, text: str, file: str) -> None:
            CParser.__init__(self, text)
            _CountingComposer.__init__(self, file)


class _Reader:
    """Turns composed nodes into plain data, and records the line of every key."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.lines: dict[str, int] = {}

    def value(self, node: Node, path: str) -> Any:
        kind = node.tag.removeprefix(_TAG)
        if isinstance(node, MappingNode) and kind == "map":
            return self._mapping(node, path)
        if isinstance(node, SequenceNode) and kind == "seq":
            return self._sequence(node, path)
        if isinstance(node, ScalarNode) and kind in _SCALARS:
            return self._scalar(node, kind, path)
        raise ConfigurationError(
            "YAML tags that make objects are not allowed",
            file=self.file,
            line=node.start_mark.line + 1,
            key=path or None,
            found=node.tag.replace(_TAG, "!!"),
            expected="plain mappings, lists, text, numbers, true, false or null",
            remedy="remove the tag and write plain data",
        )

    def _mapping(self, node: MappingNode, path: str) -> dict[str, Any]:
        data: dict[str, Any] = {}
        own: dict[str, int] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            key = self._key(key_node, path)
            inner = f"{path}.{key}" if path else key
            if key in own:
                raise ConfigurationError(
                    f"the key {key!r} stands here twice",
                    file=self.file,
                    line=line,
                    key=inner,
                    found=f"{key!r} in lines {own[key]} and {line}",
                    expected="each key once",
                    remedy="remove or rename one of them",
                )
            own[key] = line
            self.lines.setdefault(inner, line)
            data[key] = self.value(value_node, inner)
        return data

    def _key(self, node: Node, path: str) -> str:
        if isinstance(node, ScalarNode) and node.tag == _TAG + "str" and node.value != "<<":
            return str(node.value)
        merge = isinstance(node, ScalarNode) and node.value == "<<"
        raise ConfigurationError(
            "merge keys are not supported" if merge else "a key must be text",
            file=self.file,
            line=node.start_mark.line + 1,
            key=path or None,
            found=node.value if isinstance(node, ScalarNode) else "a list or a mapping",
            expected="a name before the colon",
            remedy="write the merged keys out" if merge else "put the key in quotes",
        )

    def _sequence(self, node: SequenceNode, path: str) -> list[Any]:
        values = []
        for i, entry in enumerate(node.value):
            inner = f"{path}.{i}" if path else str(i)
            self.lines.setdefault(inner, entry.start_mark.line + 1)
            values.append(self.value(entry, inner))
        return values

    def _scalar(self, node: ScalarNode, kind: str, path: str) -> Any:
        try:
            value = _SCALARS[kind](node.value)
        except ValueError:
            value = math.nan
        is_endless = isinstance(value, float) and not math.isfinite(value)
        is_too_large = isinstance(value, int) and not -_MAX_INTEGER <= value < _MAX_INTEGER
        if is_endless or is_too_large:
            raise ConfigurationError(
                "this is not a finite number",
                file=self.file,
                line=node.start_mark.line + 1,
                key=path or None,
                found=node.value,
                expected="a finite number",
                remedy="write an ordinary number, or null where null is allowed",
            )
        return value


def _integer(text: str) -> int:
    return int(text, 0) if text[:2] in ("0x", "0o") else int(text)


def _boolean(text: str) -> bool:
    if text.lower() not in ("true", "false"):
        raise ValueError(text)
    return text.lower() == "true"


_SCALARS: dict[str, Callable[[str], Any]] = {
    "null": lambda _: None,
    "bool": _boolean,
    "int": _integer,
    "float": float,
    "str": str,
}


Model = TypeVar("Model", bound=BaseModel)


def validate(model: type[Model], document: Document) -> Model:
    """Make an instance of the model from a document's data.

    Raises:
        ConfigurationError: One for all errors, with file, lines, keys and remedies.
    """
    try:
        return model.model_validate(document.data)
    except ValidationError as error:
        raise translate(error, model, document) from None


def translate(
    error: ValidationError, model: type[BaseModel], document: Document, at: str = ""
) -> ConfigurationError:
    """Make one error of all that pydantic reports on a document, or on its part at a key."""
    errors = [_translate(model, document, at, problem) for problem in error.errors()]
    return combine_errors(sorted(errors, key=lambda each: (each.line or 0, each.key or "")))


def _translate(
    model: type[BaseModel], document: Document, at: str, problem: Any
) -> ConfigurationError:
    parts = [str(part) for part in problem["loc"] if not _is_tag(part)]
    key = ".".join([at, *parts] if at else parts)
    kind, value = problem["type"], problem["input"]
    holder = _model_at(model, parts[:-1])
    name = parts[-1] if parts else ""
    expected: str | None
    if kind == "extra_forbidden":
        text, expected = f"unknown key {name!r}", "one of " + ", ".join(holder.model_fields)
        value, remedy = name, did_you_mean(name, holder.model_fields)
    elif kind == "missing":
        text, expected, value = f"the key {name!r} is missing", _meaning(holder, name), None
        remedy = f"add `{name}: ...`"
    elif kind == "value_error":
        text = str(problem["ctx"]["error"])
        expected, remedy = _meaning(holder, name) or None, "correct the value"
    elif kind == "model_type":
        fields = _model_at(model, parts).model_fields
        first = next((each for each in fields if fields[each].is_required()), "key")
        text, expected = f"{key!r} is no mapping", "a mapping, with the keys " + ", ".join(fields)
        remedy = f"write `{{{first}: {value if isinstance(value, str) else 'value'}, ...}}`"
    else:
        message = problem["msg"]
        form = message.removeprefix("Input should be ")
        text = f"{name!r} must be {form}" if form != message else f"{name!r}: {message}"
        meaning = _meaning(holder, name)
        expected, remedy = f"{form} ({meaning})" if meaning else form, corrected(value)
    return ConfigurationError(
        text,
        file=document.file or None,
        line=document.line_of(key) or (1 if document.file else None),
        key=key or None,
        found=value if not isinstance(value, Mapping) else None,
        expected=expected,
        remedy=remedy,
    )


def _is_tag(part: object) -> bool:
    return isinstance(part, str) and part.startswith("<") and part.endswith(">")


def _meaning(holder: type[BaseModel], name: str) -> str:
    field = holder.model_fields.get(name)
    return (field.description or "").rstrip(".") if field is not None else ""


def _model_at(model: type[BaseModel], parts: list[str]) -> type[BaseModel]:
    """Find the model whose fields are under a path; above free mappings, the nearest one."""
    annotation: Any = model
    candidate = model
    for part in parts:
        options = list(_models(annotation))
        owner = next((option for option in options if part in option.model_fields), None)
        if owner is not None:
            annotation = owner.model_fields[part].annotation
        candidates = list(_models(annotation))
        candidate = candidates[0] if candidates else candidate
    return candidate


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models that an annotation mentions."""
    if is_subclass(annotation, BaseModel):
        yield annotation
    elif get_origin(annotation) in (Union, types.UnionType) or get_args(annotation):
        for inner in get_args(annotation):
            yield from _models(inner)
