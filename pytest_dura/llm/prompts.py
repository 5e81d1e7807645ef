"""Prompts: blocks of facts and texts from the world, and the templates that put them into words.

Texts from the world are shown to a model as data, and never as anything else. Templates are a
domain's own files, and a user's in their place; they are rendered in a sandbox, where they see what
they are given and cannot run away.
"""

from __future__ import annotations

import hashlib
import html
import json
import re
import traceback
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pytest_dura.core.errors import ConfigurationError, describe_error, did_you_mean
from pytest_dura.core.percepts import NOTHING
from pytest_dura.llm.answers import OPTIONAL, read_answer, without
from pytest_dura.llm.port import Answer, Image, Message

if TYPE_CHECKING:
    from jinja2 import Environment

TAG = "perceived_text"
LONGEST_PERCEIVED = 300
"""Characters of one text that are shown."""

_ROUNDS = 3
_LEFT, _RIGHT = (
    {ord("<"), 0x2039, 0x00AB, 0x02C2, 0x1438, 0x276E, 0x27E8, 0x27EA, 0x3008, 0x300A, 0x227A},
    {ord(">"), 0x203A, 0x00BB, 0x02C3, 0x1433, 0x276F, 0x27E9, 0x27EB, 0x3009, 0x300B, 0x227B},
)
"""Code points of what looks like a tag's brackets: quotation marks, arrow heads, ornaments."""
_BRACKETS = {**dict.fromkeys(_LEFT, "("), **dict.fromkeys(_RIGHT, ")"), ord("&"): "+"}
_TAG_NAME = re.compile(r"perceived[\W_]*text", re.IGNORECASE)
_KEPT = frozenset(map(chr, (0x2013, 0x2014, 0x2018, 0x2019, 0x201C, 0x201D, 0x2026, 0xB0, 0x20AC)))
"""Dashes, quotation marks, the ellipsis, degrees, euros."""


@dataclass(frozen=True)
class PerceivedText:
    """Text of unknown origin: on a sign, as an object's name, in an answer of the model.

    ``str`` of it is always enclosed in ``<perceived_text>`` and bounded; templates cannot reach the
    original.

    Args:
        _text: As it was perceived. Any other object is shown as unreadable.
        longest: Characters that are shown of it.
    """

    _text: object
    longest: int = LONGEST_PERCEIVED

    def __str__(self) -> str:
        return f"<{TAG}>{harmless(self._text, self.longest)}</{TAG}>"

    def _bare(self) -> str:
        """The text as it is, on one line and bounded: what a prompt without hardening shows."""
        if not isinstance(self._text, str):
            return "(unreadable)"
        text = "".join(each if each.isprintable() else " " for each in self._text[: self.longest])
        return " ".join(text.split())


def harmless(text: object, longest: int = LONGEST_PERCEIVED) -> str:
    """Clean a text: one line that holds no tag, nor anything that is easily taken for one.

    Compatibility forms and entities are resolved; brackets that look like those of a tag become
    round ones, the tag's name goes, and of other scripts letters and digits stay.
    """
    if not isinstance(text, str):
        return "(unreadable)"
    text = text[: 4 * longest]  # bounds the work; what is invisible may take most of it
    for _ in range(_ROUNDS):
        text = html.unescape(unicodedata.normalize("NFKC", text))
    text = text.translate(_BRACKETS)
    text = " ".join("".join(map(_visible, text)).split())
    text = _TAG_NAME.sub("(tag)", text)
    return text if len(text) <= longest else text[: longest - 1] + "…"


def _visible(character: str) -> str:
    if character.isascii():
        return character if character.isprintable() else " "
    category = unicodedata.category(character)
    if category in ("Cf", "Mn", "Me"):  # invisible, or stacked upon others
        return ""
    if category[0] in "CZ":
        return " "
    return character if category[0] in "LMN" or character in _KEPT else "?"


@dataclass(frozen=True)
class Block:
    """Block of the prompt, such as ``LIDAR``.

    Args:
        name: In capitals, as it stands in the prompt.
        facts: For the block's template: rounded numbers, texts, and under
            ``objects`` one mapping per object, each with its ``id``.
    """

    name: str
    facts: Mapping[str, Any]


@dataclass(frozen=True)
class Prompt:
    """Message on the channel ``prompt``, which faults may change.

    Args:
        blocks: In the order in which they are shown.
        images: In the order in which they are shown.
        wording: Name of another wording of the same content; empty for the templates' own.
        hardened: Whether texts of the scene are shown as such, and the model is warned of them.
    """

    blocks: tuple[Block, ...]
    images: tuple[Image, ...] = ()
    wording: str = ""
    hardened: bool = True

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of all objects in it, each once, in the order in which they are shown."""
        listed = (each for block in self.blocks for each in block.facts.get(OBJECTS, ()))
        return tuple(dict.fromkeys(str(each["id"]) for each in listed))


_PARAPHRASED = "paraphrased"
REFORMATTED = "reformatted"
"""The wording that needs no templates: each block is one JSON object of its facts."""
OBJECTS, PICTURES = "objects", "pictures"
"""Keys of a block's facts."""


def shuffled(items: Sequence[Any], rng: np.random.Generator) -> tuple[Any, ...]:
    """The same items in another order; in the same only if there are fewer than two."""
    order = rng.permutation(len(items)).tolist()
    if order == sorted(order):
        order = order[1:] + order[:1]
    return tuple(items[place] for place in order)


def reordered(prompt: Prompt, rng: np.random.Generator) -> Prompt:
    """The objects within each block in another order; the blocks stay where they are."""

    def reorder(block: Block) -> Block:
        listed = block.facts.get(OBJECTS, ())
        if len(listed) < 2:
            return block
        return replace(block, facts={**block.facts, OBJECTS: shuffled(listed, rng)})

    return replace(prompt, blocks=tuple(map(reorder, prompt.blocks)))


def paraphrased(prompt: Prompt) -> Prompt:
    """The same facts in other words."""
    return replace(prompt, wording=_PARAPHRASED)


def reformatted(prompt: Prompt) -> Prompt:
    """The same facts in another format."""
    return replace(prompt, wording=REFORMATTED)


def unhardened(prompt: Prompt) -> Prompt:
    """The same with texts of the scene among all others, and no warning of them."""
    return replace(prompt, hardened=False)


def blind(prompt: Prompt) -> Prompt:
    """The same without pictures, which the text then lists as missing."""

    def without_pictures(block: Block) -> Block:
        pictures = block.facts.get(PICTURES, ())
        if not pictures:
            return block
        unseen = tuple({**picture, "shown": 0} for picture in pictures)
        return replace(block, facts={**block.facts, PICTURES: unseen})

    return replace(prompt, blocks=tuple(map(without_pictures, prompt.blocks)), images=())


LONGEST_RENDERED = 32_768
"""Characters that one template may make."""

FILTERS = (
    "abs", "count", "default", "first", "float", "int", "items", "join", "last", "length", "list",
    "lower", "map", "max", "min", "reject", "rejectattr", "round", "select", "selectattr", "sort",
    "string", "sum", "trim", "unique", "upper",
)  # fmt: skip
"""None of them makes a long text of a short one."""


# A class and no state; made at first use, since jinja2 is of the extra.
@cache
def _environment_class() -> type[Environment]:
    from jinja2.exceptions import SecurityError
    from jinja2.runtime import Macro
    from jinja2.sandbox import SandboxedEnvironment

    class Bounded(SandboxedEnvironment):
        """Sandbox: no calls but of macros, no products but of numbers; loops end with the data."""

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
        from jinja2 import FunctionLoader, StrictUndefined, TemplateSyntaxError

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
        try:
            for name in sources:
                self._environment.get_template(name)
        except TemplateSyntaxError as error:
            raise ConfigurationError(
                f"no template: {error.message}",
                file=error.filename or files[name],
                line=error.lineno,
                expected="a jinja2 template",
                remedy="correct it, or remove it for the built-in one",
            ) from None

    def render(self, name: str, facts: Mapping[str, Any]) -> str:
        """Render a template, without white space around it.

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
    text = ""
    for part in parts:
        text += part
        if len(text) > LONGEST_RENDERED:
            raise OverflowError(f"it makes more than {LONGEST_RENDERED} characters")
    return text


_SUFFIX = ".j2"
_FEW_SHOT = "few_shot.yaml"
_UNHARDENED_FEW_SHOT = "few_shot_unhardened.yaml"
_LONGEST_FILE = 65_536
"""Bytes of a file."""


@dataclass(frozen=True)
class Sources:
    """Texts and paths of the files in use, by name such as ``system.j2``, sorted by it."""

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
        """Read a domain's files, and those of a user's directory in their place.

        Args:
            own: The domain's directory.
            directory: Of the user; each file in it replaces the domain's file of its name.

        Raises:
            ConfigurationError: For a directory that does not exist, a file that replaces none, and
                one that cannot be read.
        """
        paths = _files(own)
        if directory is not None:
            if not directory.is_dir():
                raise ConfigurationError(
                    "there is no such directory of templates",
                    file=str(directory),
                    expected="a directory with files such as " + ", ".join(sorted(paths)),
                    remedy="create it, or leave it out for the built-in templates",
                )
            replaced = _files(directory)
            for name in [name for name in replaced if name not in paths]:
                raise ConfigurationError(
                    f"there is no template {name!r} to replace",
                    file=str(replaced[name]),
                    found=name,
                    expected="one of " + ", ".join(sorted(paths)),
                    remedy=did_you_mean(name, paths, "rename or remove it"),
                )
            paths |= replaced
        names = sorted(paths)
        return cls(
            {name: _text(paths[name]) for name in names}, {name: str(paths[name]) for name in names}
        )


def _files(directory: Path) -> dict[str, Path]:
    """Files in a directory, but hidden ones, by their names in it."""
    files = (path.relative_to(directory) for path in sorted(directory.rglob("*")) if path.is_file())
    return {
        file.as_posix(): directory / file
        for file in files
        if not any(part[0] in "._" for part in file.parts)
    }


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
    """Example: a pair of question and answer.

    Args:
        blocks: Of the question.
        answer: JSON, on one line.
        line: Where it begins in its file.
    """

    blocks: tuple[Block, ...]
    answer: str
    line: int


def _read_examples(text: str, file: str, schema: Mapping[str, Any]) -> tuple[Example, ...]:
    """Read the examples of a file: a list of ``blocks`` (facts by name) and ``answer``.

    Raises:
        ConfigurationError: For any other content, and an answer that the schema refuses; with file
            and line.
    """
    import yaml

    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        data = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error)
        raise _refused(f"no YAML: {problem}", file, mark and mark.line + 1) from None
    if data is None or node is None:
        return ()
    if not isinstance(data, list):
        raise _refused("the examples are no list", file, 1)
    return tuple(
        _example(pair, file, place.start_mark.line + 1, schema)
        for pair, place in zip(data, node.value, strict=True)
    )


def _example(data: Any, file: str, line: int, schema: Mapping[str, Any]) -> Example:
    if not isinstance(data, dict) or set(data) != {"blocks", "answer"}:
        raise _refused("an example has `blocks` and `answer`, and nothing else", file, line)
    blocks = data["blocks"]
    if not isinstance(blocks, dict) or not all(
        isinstance(name, str) and isinstance(facts, dict) for name, facts in blocks.items()
    ):
        raise _refused("`blocks` are facts by the block's name", file, line)
    try:
        answer = json.dumps(data["answer"], ensure_ascii=False)
    except (TypeError, ValueError) as error:
        raise _refused(f"the answer is no JSON: {error}", file, line) from None
    reading = read_answer(Answer(answer), schema)
    if not reading.answered:
        raise _refused(f"the answer is {reading.outcome}: {reading.detail}", file, line)
    question = tuple(Block(name, _with_texts(facts)) for name, facts in blocks.items())
    return Example(question, answer, line)


def _with_texts(value: Any) -> Any:
    """Plain data with the texts of the scene marked as such."""
    if isinstance(value, dict):
        if set(value) == {PERCEIVED}:
            return PerceivedText(value[PERCEIVED])
        return {key: _with_texts(fact) for key, fact in value.items()}
    if isinstance(value, list):
        return tuple(map(_with_texts, value))
    return value


def _bare_texts(value: Any) -> Any:
    """Facts whose texts of the scene are as any other text."""
    if isinstance(value, PerceivedText):
        return value._bare()  # noqa: SLF001 - out of reach for templates alone
    if isinstance(value, Mapping):
        return {key: _bare_texts(fact) for key, fact in value.items()}
    if isinstance(value, (list, tuple)):
        return tuple(map(_bare_texts, value))
    return value


def _as_json(block: Block) -> str:
    """A block as one JSON object; an object's id is its label."""

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            left_out = {"id"} if "label" in value else set()
            return {key: plain(fact) for key, fact in value.items() if key not in left_out}
        if isinstance(value, (list, tuple)):
            return list(map(plain, value))
        return str(value) if isinstance(value, PerceivedText) else value

    return json.dumps({block.name: plain(block.facts)}, ensure_ascii=False)


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
    """Templates of a domain, compiled; see :meth:`load`."""

    def __init__(
        self, sources: Sources, vocabulary: Mapping[str, Any], schema: Mapping[str, Any]
    ) -> None:
        self._sources = sources
        texts = {name: text for name, text in sources.texts.items() if name.endswith(_SUFFIX)}
        self._renderer = Renderer(texts, sources.files)
        self._names = frozenset(texts)
        self._wordings = ("", *sources.wordings, REFORMATTED)
        read = cache(lambda name: _read_examples(sources.texts[name], sources.files[name], schema))
        self._examples = {
            (wording, hardened): read(name) if (name := self._few_shot(wording, hardened)) else ()
            for wording in self._wordings
            for hardened in (True, False)
        }
        answers = [json.loads(example.answer) for example in self._examples["", True]]
        system = texts.get(SYSTEM + _SUFFIX, "")
        self.schema = without(schema, [
            key
            for key in OPTIONAL
            if key not in system or not answers or any(key not in answer for answer in answers)
        ])  # fmt: skip
        """Of what is asked for: an optional key is, where the system's message and the examples
        have it, so that requests of templates without it stay as they are."""
        self._vocabulary = {**vocabulary, "asked": tuple(self.schema.get("properties", ()))}
        self._openings: dict[tuple[str, bool], tuple[Message, ...]] = {}
        for wording, hardened in self._examples:
            self._opening(wording, hardened=hardened)

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
        """Load the templates of a directory: ``system.j2``, ``user.j2``, one per block, examples.

        A folder in it is another wording; files that it lacks are those of the directory itself.

        Args:
            own: The domain's directory.
            directory: A user's; each file replaces the domain's of its name.
            vocabulary: For ``system.j2``: the answer's terms and their meaning.
            schema: JSON schema of an answer, for the examples.
            probes: Prompts that are rendered in every wording, so that errors show at once.

        Raises:
            ConfigurationError: For files that cannot be used, with file and line.
        """
        templates = cls(Sources.read(own, directory), vocabulary, schema)
        for prompt in probes:
            for wording in templates._wordings:
                templates._user(prompt.blocks, wording)
        return templates

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the sources of all templates in use."""
        return self._sources.digest

    def messages(self, prompt: Prompt) -> tuple[Message, ...]:
        """Make the conversation: system, examples, and the user's message with its images.

        Raises:
            ConfigurationError: For a wording or a block without templates, or one that fails.
        """
        text = self._user(prompt.blocks, prompt.wording, hardened=prompt.hardened)
        opening = self._opening(prompt.wording, hardened=prompt.hardened)
        return (*opening, Message("user", text, prompt.images))

    def _opening(self, wording: str, *, hardened: bool) -> tuple[Message, ...]:
        """All messages before the user's; the same at every decision."""
        key = wording, hardened
        if key not in self._examples:
            raise ConfigurationError(
                f"there is no wording {wording!r} of the prompt",
                found=wording,
                expected="one of " + ", ".join(map(repr, self._wordings)),
                remedy="name a folder of the templates",
            )
        if key not in self._openings:
            vocabulary = {**self._vocabulary, "hardened": int(hardened)}
            opening = [Message("system", self._render(SYSTEM, wording, vocabulary))]
            for example in self._examples[key]:
                question = self._user(example.blocks, wording, hardened=hardened)
                opening.append(Message("user", question))
                opening.append(Message("assistant", self._asked(example.answer)))
            self._openings[key] = tuple(opening)
        return self._openings[key]

    def _asked(self, answer: str) -> str:
        """An example's answer without what is not asked for."""
        known = self._vocabulary["asked"]
        data = json.loads(answer)
        if not known or data.keys() <= set(known):
            return answer
        return json.dumps({key: data[key] for key in data if key in known}, ensure_ascii=False)

    def _user(self, blocks: tuple[Block, ...], wording: str, *, hardened: bool = True) -> str:
        shown = []
        for given in blocks:
            stem = given.name.lower()
            if stem + _SUFFIX not in self._names:
                known = sorted(name for name in self._names if "/" not in name)
                raise ConfigurationError(
                    f"the block {given.name!r} has no template",
                    found=given.name,
                    expected="a block of " + ", ".join(known),
                    remedy="correct the block's name",
                )
            block = given if hardened else replace(given, facts=_bare_texts(given.facts))
            in_json = wording == REFORMATTED
            text = _as_json(block) if in_json else self._render(stem, wording, block.facts)
            shown.append({"name": block.name, "text": text})
        return self._render(USER, wording, {"blocks": shown})

    def _render(self, stem: str, wording: str, facts: Mapping[str, Any]) -> str:
        name = f"{wording}/{stem}{_SUFFIX}" if wording else ""
        return self._renderer.render(name if name in self._names else stem + _SUFFIX, facts)

    def _few_shot(self, wording: str, hardened: bool) -> str | None:
        """Name of the file of examples for a wording, if there is one."""
        names = [f"{wording}/{_FEW_SHOT}", _FEW_SHOT]
        if not hardened:
            names.insert(0, _UNHARDENED_FEW_SHOT)
        return next((name for name in names if name in self._sources.texts), None)
