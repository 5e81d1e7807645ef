"""Redactor: keeps secrets out of whatever a session writes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from pytest_dura.evidence.redaction.forms import around, base64_cores, forms, pieces
from pytest_dura.evidence.redaction.names import PARAMETER, SHORTEST, is_common, secrets_of
from pytest_dura.evidence.redaction.shapes import OPTION, SHAPES, Shape

PIECE = 12
"""Characters of a secret that give it away, where the rest of it was cut off."""
PARAMETER_NAME = "parameter"
"""What stands for the value of a parameter whose name speaks of a secret."""

_SHORT = 200
_MARK = re.compile(r"(\[redacted: [\w. -]{1,200}\])")
_HINT = "[redacted: "
_NAMES_IN_DATA = ("key", "token", "secret", "passw", "passphrase", "credential", "authorization")
_SHAPE_NAMES = {PARAMETER_NAME, *(shape.name for shape in SHAPES)}


class Redactor:
    """Replaces secrets in plain data by ``[redacted: NAME]``.

    It knows the values that it was told of, in every form of
    :mod:`pytest_dura.evidence.redaction.forms`, the shapes of
    :mod:`pytest_dura.evidence.redaction.shapes`, and texts under keys such as ``api_key``. What is
    redacted already stays as it is.

    Args:
        globs: Names of further variables whose values are secrets, in letters of any case.

    Attributes:
        ignored: Names of variables whose values are too short or too ordinary to be looked for.
    """

    def __init__(self, globs: Sequence[str] = ()) -> None:
        self._globs = tuple(globs)
        self.ignored: set[str] = set()
        self._values: dict[str, str] = {}
        self._forms: dict[str, str] = {}
        self._cores: dict[str, str] = {}
        self._seen: dict[str, str] = {}

    @classmethod
    def of_environment(cls, environ: Mapping[str, str], globs: Sequence[str] = ()) -> Redactor:
        """One that knows the secrets among the environment's variables."""
        redactor = cls(globs)
        redactor.learn(environ)
        return redactor

    def learn(self, environ: Mapping[str, str]) -> None:
        """Take in secrets that the environment has by now; those known before stay known."""
        # Asked before whatever is written, when hardly anything has changed.
        fresh = {name: one for name, one in environ.items() if self._seen.get(name) != one}
        self._seen.update(fresh)
        for name, value in secrets_of(fresh, self._globs):
            self.add(name, value)

    def add(self, name: str, value: str) -> None:
        """Take in one secret.

        Args:
            name: What stands in its place.
            value: Its value; one that is too short or too ordinary is ignored, see ``ignored``.
        """
        stripped = value.strip()
        if is_common(stripped) or _is_own_word(stripped):
            self.ignored |= {name} if stripped else set()
            return
        name = re.sub(r"[^\w. -]", "_", name)[:200]
        self._values.setdefault(value, name)
        for known, found in ((self._forms, forms(value)), (self._cores, base64_cores(stripped))):
            for form in found:
                if len(form) >= SHORTEST:
                    known.setdefault(form, name)

    def redact(self, value: Any) -> Any:
        """The same plain data without secrets; the very same object if there is none in it."""
        if isinstance(value, str):
            return self._active([value]).text(value)
        active = self._active(_texts(value))
        return active.data(value) if active else value

    def _active(self, texts: Iterable[str]) -> _Active:
        """What of all that is known occurs in any of these texts."""
        joined = "\n".join(texts)
        lower = joined.lower()
        # Without a beginning or an end of a value there is no piece of it either.
        ends = {
            value: name
            for value, name in self._values.items()
            if len(value) > PIECE and (value[:PIECE] in joined or value[-PIECE:] in joined)
        }
        return _Active(
            names=_SHAPE_NAMES | set(self._values.values()),
            forms={form: name for form, name in self._forms.items() if form in joined},
            cores={core: name for core, name in self._cores.items() if core in joined},
            pieces=ends,
            shapes=[shape for shape in SHAPES if any(hint in lower for hint in shape.hints)],
            named=any(hint in lower for hint in _NAMES_IN_DATA),
        )


class _Active:
    """The part of a Redactor that may find something in the data at hand."""

    def __init__(
        self,
        *,
        names: set[str],
        forms: Mapping[str, str],
        cores: Mapping[str, str],
        pieces: Mapping[str, str],
        shapes: list[Shape],
        named: bool,
    ) -> None:
        self.names = names
        self.named = named
        self.known: dict[str, str] = {}
        self.named_keys: dict[str, bool] = {}
        self.steps: list[Callable[[str], str]] = []
        if cores:
            self.steps.append(_replacing(cores, encoded=True))
        if forms:
            self.steps.append(_replacing(forms))
        self.steps += [partial(_cut, *one) for one in pieces.items()]
        self.steps += [partial(_shaped, one) for one in shapes]

    def __bool__(self) -> bool:
        """Whether there may be anything to redact."""
        return bool(self.steps) or self.named

    def text(self, text: str) -> str:
        """One text without secrets."""
        # Data of many entries has the same keys and words in each of them.
        if len(text) > _SHORT:
            return self._without(text)
        if text not in self.known:
            self.known[text] = self._without(text)
        return self.known[text]

    def _without(self, text: str) -> str:
        for step in self.steps:
            if _HINT not in text:
                text = step(text)
                continue
            # What stands in a secret's place is left alone, unless something hides in it.
            parts = _MARK.split(text)
            for i, part in enumerate(parts):
                if not (i % 2 and part[len(_HINT) : -1] in self.names):
                    parts[i] = step(part)
            text = "".join(parts)
        return text

    def data(self, value: Any) -> Any:
        """Plain data without secrets."""
        if isinstance(value, str):
            return self.text(value)
        if isinstance(value, Mapping):
            found: dict[Any, Any] = {}
            for key, item in value.items():
                new = self.text(key) if isinstance(key, str) else key
                while new in found:  # two keys that differed by their secrets alone
                    new = f"{new} (another)"
                found[new] = self._under(key, item)
            return found
        if isinstance(value, (list, tuple)):
            items = [self.data(item) for item in value]
            for i, item in enumerate(value[:-1]):
                following = value[i + 1]
                if isinstance(item, str) and OPTION.fullmatch(item) and _is_open(following):
                    items[i + 1] = _mark("option")
            return items if isinstance(value, list) else tuple(items)
        return value

    def _under(self, key: Any, item: Any) -> Any:
        redacted = self.data(item)
        if not isinstance(key, str) or not _is_open(redacted):
            return redacted
        if key not in self.named_keys:
            self.named_keys[key] = PARAMETER.match(key) is not None
        return _mark(PARAMETER_NAME) if self.named_keys[key] else redacted


def redactions_in(value: Any) -> Counter[str]:
    """How often each name stands in a secret's place, in plain data or in a text of JSON."""
    texts = [value] if isinstance(value, str) else _texts(value)
    found = (mark for text in texts if _HINT in text for mark in _MARK.findall(text))
    return Counter(mark[len(_HINT) : -1] for mark in found)


def holds_redaction(value: Any) -> bool:
    """Whether plain data lacks a secret that it once had, so that nothing can be run from it."""
    return bool(redactions_in(value))


def _mark(name: str) -> str:
    return f"{_HINT}{name}]"


def _is_open(item: Any) -> bool:
    """Whether it is a text with something in it that nothing was redacted from."""
    return isinstance(item, str) and bool(item) and not _MARK.search(item)


def _replacing(known: Mapping[str, str], *, encoded: bool = False) -> Callable[[str], str]:
    # The longest first: one form may begin like another.
    ordered = sorted(known, key=lambda form: (-len(form), form))
    pattern = re.compile("|".join(map(re.escape, ordered)))

    def replaced(text: str) -> str:
        match, done, parts = pattern.search(text), 0, []
        while match is not None:
            begin, end = match.span()
            if encoded:
                begin, end = (done + at for at in around(text[done:], begin - done, end - done))
            parts += [text[done:begin], _mark(known[match[0]])]
            done = end
            match = pattern.search(text, done)
        return "".join([*parts, text[done:]])

    return replaced


def _cut(value: str, name: str, text: str) -> str:
    done, parts = 0, []
    for begin, end in sorted(pieces(value, text, PIECE)):
        if begin >= done:
            parts += [text[done:begin], _mark(name)]
            done = end
    return "".join([*parts, text[done:]])


def _shaped(shape: Shape, text: str) -> str:
    def replaced(match: re.Match[str]) -> str:
        begin, end = (at - match.start() for at in match.span("secret"))
        return match[0][:begin] + _mark(shape.name) + match[0][end:]

    return shape.pattern.sub(replaced, text)


def _texts(value: Any) -> Iterator[str]:
    """Every text in plain data, keys too, in no particular order."""
    left = [value]
    while left:
        one = left.pop()
        if isinstance(one, str):
            yield one
        elif isinstance(one, Mapping):
            yield from (key for key in one if isinstance(key, str))
            left.extend(one.values())
        elif isinstance(one, (list, tuple)):
            left.extend(one)


def _is_own_word(value: str) -> bool:
    """Whether the record itself is written with this word: without it, nobody could read it."""
    from pytest_dura.evidence.bundle.schema import words

    return any(value in word for word in words())
