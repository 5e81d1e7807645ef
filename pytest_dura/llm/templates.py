"""Templates that put a prompt into words: a domain's own files, and a user's in their place.

They are rendered in a sandbox, where they see what they are given and cannot run away. A
wording may come with examples before the question.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import traceback
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.core.state import NOTHING
from pytest_dura.llm.answers import read_answer
from pytest_dura.llm.port import Answer, Message
from pytest_dura.llm.prompts import Block, PerceivedText, Prompt

if TYPE_CHECKING:
    from jinja2 import Environment


LONGEST_RENDERED = 32_768
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
        if length > LONGEST_RENDERED:
            raise OverflowError(f"it makes more than {LONGEST_RENDERED} characters")
    return "".join(made)


_SUFFIX = ".j2"
_FEW_SHOT = "few_shot.yaml"
_LONGEST_FILE = 65_536
"""Bytes of a file."""


@dataclass(frozen=True)
class Sources:
    """Texts and places of the files in use, by name such as ``system.j2``, sorted by it."""

    texts: Mapping[str, str]
    files: Mapping[str, str]

    @property
    def digest(self) -> str:
        """SHA-256 over all names and texts, wherever they stand."""
        return hashlib.sha256(json.dumps(sorted(self.texts.items())).encode()).hexdigest()

    @property
    def wordings(self) -> tuple[str, ...]:
        """Names of the other wordings: the folders."""
        folders = (name.partition("/")[0] for name in self.texts if "/" in name)
        return tuple(dict.fromkeys(folders))

    @classmethod
    def read(cls, own: Path, directory: Path | None = None) -> Sources:
        """A domain's files, and those of a user's directory instead of them.

        Args:
            own: The domain's directory.
            directory: Of the user; each file in it replaces the domain's file of its name.

        Raises:
            ConfigurationError: For a directory that is none, a file that replaces nothing, and one
                that cannot be read.
        """
        paths = {_name(own, path): path for path in _files(own)}
        if directory is not None:
            if not directory.is_dir():
                raise ConfigurationError(
                    "there is no such directory of templates",
                    file=str(directory),
                    expected="a directory with files such as " + ", ".join(sorted(paths)),
                    remedy="create it, or leave it out for the built-in templates",
                )
            replaced = {_name(directory, path): path for path in _files(directory)}
            for name, path in replaced.items():
                _check_known(name, path, paths)
            paths |= replaced
        names = sorted(paths)
        return cls(
            {name: _text(paths[name]) for name in names}, {name: str(paths[name]) for name in names}
        )


def _files(directory: Path) -> list[Path]:
    """All files in it but hidden ones."""
    return [
        path
        for path in sorted(directory.rglob("*"))
        if path.is_file() and not any(part[0] in "._" for part in path.relative_to(directory).parts)
    ]


def _name(directory: Path, path: Path) -> str:
    return path.relative_to(directory).as_posix()


def _check_known(name: str, path: Path, known: Mapping[str, Path]) -> None:
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        raise ConfigurationError(
            f"there is no template {name!r} to replace",
            file=str(path),
            found=name,
            expected="one of " + ", ".join(sorted(known)),
            remedy=f"did you mean {near[0]!r}?" if near else "rename or remove it",
        )


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
        text = data.decode("utf-8").replace("\r\n", "\n")
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            f"the template cannot be read: {error}",
            file=str(path),
            expected="a readable file in UTF-8",
            remedy="correct it, or remove it for the built-in one",
        ) from None
    if len(data) > _LONGEST_FILE:
        raise ConfigurationError(
            f"the template has {len(data)} bytes",
            file=str(path),
            expected=f"at most {_LONGEST_FILE} bytes",
            remedy="shorten it, or remove it for the built-in one",
        )
    return text


PERCEIVED = "perceived"
"""``{perceived: ...}`` stands for a text of the scene."""


@dataclass(frozen=True)
class Example:
    """A pair of question and answer.

    Args:
        blocks: Of the question.
        answer: JSON, on one line.
        line: Where it begins in its file.
    """

    blocks: tuple[Block, ...]
    answer: str
    line: int


def _read_examples(text: str, file: str, schema: Mapping[str, Any]) -> tuple[Example, ...]:
    """The pairs of a file: a list of ``blocks`` (facts by name) and ``answer``.

    Raises:
        ConfigurationError: For what is no such list, and an answer that a model might not give;
            with file and line.
    """
    import yaml

    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        data = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        told = getattr(error, "problem", None) or str(error)
        raise _refused(f"no YAML: {told}", file, mark and mark.line + 1) from None
    if data is None or node is None:
        return ()
    if not isinstance(data, list):
        raise _refused("the examples are no list", file, 1)
    return tuple(
        _example(item, file, start.start_mark.line + 1, schema)
        for item, start in zip(data, node.value, strict=True)
    )


def _example(data: Any, file: str, line: int, schema: Mapping[str, Any]) -> Example:
    if not isinstance(data, dict) or set(data) != {"blocks", "answer"}:
        raise _refused("an example has `blocks` and `answer`, and nothing else", file, line)
    blocks, said = data["blocks"], data["answer"]
    if not isinstance(blocks, dict) or not all(
        isinstance(name, str) and isinstance(facts, dict) for name, facts in blocks.items()
    ):
        raise _refused("`blocks` are facts by the block's name", file, line)
    try:
        answer = json.dumps(said, ensure_ascii=False)
    except (TypeError, ValueError) as error:
        raise _refused(f"the answer is no JSON: {error}", file, line) from None
    reading = read_answer(Answer(answer), schema)
    if not reading.answered:
        raise _refused(f"the answer is {reading.outcome}: {reading.detail}", file, line)
    made = tuple(Block(name, _with_texts(facts)) for name, facts in blocks.items())
    return Example(made, answer, line)


def _with_texts(value: Any) -> Any:
    """Plain data with the texts of the scene marked as such."""
    if isinstance(value, dict):
        if set(value) == {PERCEIVED}:
            return PerceivedText(value[PERCEIVED])
        return {key: _with_texts(item) for key, item in value.items()}
    if isinstance(value, list):
        return tuple(map(_with_texts, value))
    return value


def _refused(problem: str, file: str, line: int | None) -> ConfigurationError:
    return ConfigurationError(
        problem,
        file=file,
        line=line,
        expected="- {blocks: {NAME: facts}, answer: an object that the answer's schema accepts}",
        remedy="correct the example, or remove the file for the built-in ones",
    )


SYSTEM, USER = "system", "user"


class Templates:
    """All templates of a domain, compiled; see :meth:`load`."""

    def __init__(
        self, sources: Sources, vocabulary: Mapping[str, Any], schema: Mapping[str, Any]
    ) -> None:
        self._sources, self._vocabulary = sources, vocabulary
        texts = {name: text for name, text in sources.texts.items() if name.endswith(_SUFFIX)}
        self._renderer = Renderer(texts, sources.files)
        self._names = frozenset(texts)
        self._examples = {
            wording: self._read(wording, schema) for wording in ("", *sources.wordings)
        }
        self._openings: dict[str, tuple[Message, ...]] = {}
        for wording in self._examples:
            self._opening(wording)

    @classmethod
    def load(
        cls,
        own: Path,
        directory: Path | None = None,
        *,
        vocabulary: Mapping[str, Any] = NOTHING,
        schema: Mapping[str, Any] = NOTHING,
        probes: Iterable[Prompt] = (),
    ) -> Templates:
        """The templates of a directory: ``system.j2``, ``user.j2``, one per block, examples.

        A folder in it is another wording; what it lacks is taken from the directory itself.

        Args:
            own: The domain's directory.
            directory: A user's; each file replaces the domain's of its name.
            vocabulary: What ``system.j2`` may use: the answer's words and what they mean.
            schema: JSON schema of an answer, for the examples.
            probes: Prompts that are rendered in every wording, so that errors show at once.

        Raises:
            ConfigurationError: For files that cannot be used, with file and line.
        """
        made = cls(Sources.read(own, directory), vocabulary, schema)
        for prompt in probes:
            for wording in made._examples:
                made._user(prompt.blocks, wording)
        return made

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the sources of all templates in use."""
        return self._sources.digest

    def messages(self, prompt: Prompt) -> tuple[Message, ...]:
        """The conversation: system, pairs of examples, and the user's message with its images.

        Raises:
            ConfigurationError: For a wording or a block without templates, or one that fails.
        """
        text = self._user(prompt.blocks, prompt.wording)
        return (*self._opening(prompt.wording), Message("user", text, prompt.images))

    def _opening(self, wording: str) -> tuple[Message, ...]:
        """All before the user's message; the same at every decision."""
        if wording not in self._examples:
            raise ConfigurationError(
                f"there is no wording {wording!r} of the prompt",
                found=wording,
                expected="one of " + ", ".join(map(repr, self._examples)),
                remedy="name a folder of the templates",
            )
        if wording not in self._openings:
            found = [Message("system", self._render(SYSTEM, wording, self._vocabulary))]
            for example in self._examples[wording]:
                found.append(Message("user", self._user(example.blocks, wording)))
                found.append(Message("assistant", example.answer))
            self._openings[wording] = tuple(found)
        return self._openings[wording]

    def _user(self, blocks: tuple[Block, ...], wording: str) -> str:
        self._check(blocks)
        shown = [
            {"name": block.name, "text": self._render(block.name.lower(), wording, block.facts)}
            for block in blocks
        ]
        return self._render(USER, wording, {"blocks": shown})

    def _check(self, blocks: tuple[Block, ...]) -> None:
        for block in blocks:
            if f"{block.name.lower()}{_SUFFIX}" not in self._names:
                known = sorted(name for name in self._names if "/" not in name)
                raise ConfigurationError(
                    f"the block {block.name!r} has no template",
                    found=block.name,
                    expected="a block of " + ", ".join(known),
                    remedy="correct the block's name",
                )

    def _render(self, stem: str, wording: str, facts: Mapping[str, Any]) -> str:
        name = f"{wording}/{stem}{_SUFFIX}" if wording else ""
        return self._renderer.render(name if name in self._names else stem + _SUFFIX, facts)

    def _read(self, wording: str, schema: Mapping[str, Any]) -> tuple[Example, ...]:
        name = f"{wording}/{_FEW_SHOT}" if wording else ""
        name = name if name in self._sources.texts else _FEW_SHOT
        if name not in self._sources.texts:
            return ()
        return _read_examples(self._sources.texts[name], self._sources.files[name], schema)
