"""Redaction: keeps secrets out of whatever a session writes.

A secret is known by the name of its variable or parameter, or by its shape, and is
recognised in every form in which a text may hold it: as it is, escaped or encoded.
"""

from __future__ import annotations

import base64
import json
import os
import re
import shlex
import string
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from fnmatch import fnmatchcase
from functools import partial
from re import Pattern
from typing import Any
from urllib.parse import quote, quote_plus, unquote, urlsplit

from pytest_dura.core.codec import encode
from pytest_dura.evidence.text import html

_SHORTEST_SECRET = 8
"""Characters; a shorter value would match everywhere."""

_VARIABLE = re.compile(
    r"(?:TOKEN|SECRET|PASSWORD|PASSWD|PASSPHRASE|SSHPASS|CREDENTIAL|APIKEY)S?(?=_|\d*$)"
    r"|CONNECTION_?STRINGS?(?=_|\d*$)"
    # Whole parts of a name: PATH is no PAT, and a COMPASS no PASS.
    r"|(?:^|_)(?:KEY|PASS|PWD|AUTH|COOKIE|PAT|WEBHOOK|CRED|LICEN[SC]E|DSN|CONN_STR)S?(?=_|\d*$)"
    r"|(?:^|_)(?:DB|DATABASE|SQLALCHEMY\w*|MONGO\w*|REDIS\w*|POSTGRES\w*)_UR[IL](?=_|\d*$)"
)
_NO_SECRET = re.compile(r"_(?:FILE|PATH|DIR|SOCK|SOCKET|HOME)$|^(?:OLD)?PWD$")
_SECRET_PARAMETER = re.compile(
    r"(?:^|.*[^a-z])(?:(?:api|access|private|secret|auth|account|encryption)[-_ ]?keys?"
    r"|token|secrets?|passw(?:or)?ds?|passphrase|credentials?|authorization)$",
    re.IGNORECASE,
)
"""Whole name of a parameter, a header or a key of data."""

_NAMED_SECRET = re.compile(
    r"(?:key|token|secret|auth|passw|cookie|credential|sig)[a-z]{0,20}\"?\s*[:=]\s*\"?"
    r"([^\"\r\n,&#]{1,4000})",
    re.IGNORECASE,
)
"""A header, or a part of a URL's query, whose name says that its value is secret."""

_COMMON_VALUES = {
    "password", "passwords", "changeme", "redacted", "disabled", "undefined", "required",
    "optional", "production", "development", "localhost", "username", "anonymous",
}  # fmt: skip


def _secrets_of(environ: Mapping[str, str], globs: Sequence[str] = ()) -> Iterator[tuple[str, str]]:
    """Yield ``(name, value)`` of variables that hold secrets, and of secrets in URLs and headers.

    Args:
        environ: The variables.
        globs: Names that the user declares secret, in letters of any case.
    """
    user_globs = [glob.upper() for glob in globs]
    for name, value in sorted(environ.items()):
        upper = name.upper()
        is_secret = _VARIABLE.search(upper) and not _NO_SECRET.search(upper)
        if is_secret or any(fnmatchcase(upper, glob) for glob in user_globs):
            yield name, value
        if "://" in value and "@" in value:
            password = _password(value)
            if password:
                yield name, password
        query = value.partition("?")[2] if "://" in value else ""
        for match in _NAMED_SECRET.finditer(value if upper.endswith("_HEADERS") else query):
            for secret in {match[1], unquote(match[1]), match[1].rpartition(" ")[2]}:
                yield name, secret


def is_common(value: str) -> bool:
    """Whether a value is too short or too ordinary to be distinguished from other text."""
    return len(value) < _SHORTEST_SECRET or len(set(value)) < 3 or value.lower() in _COMMON_VALUES


def _password(url: str) -> str | None:
    try:
        password = urlsplit(url).password
    except ValueError:  # no URL after all
        return None
    return None if password is None else unquote(password)


_SHELL_ARGUMENT = r"""(?:'[^']*'|"(?:\\.|[^"\\])*"|\\.|[^\s'"\\])+"""
"""An argument of a shell's command line."""
_OPTION = (
    r"--?(?:[A-Za-z0-9]+[-_])*(?:api[-_]?key|access[-_]?key|private[-_]?key|token|secret"
    r"|passw(?:or)?d|passphrase|credentials?|authorization)"
)
_NAME = r"(?:api[-_]?key|access[-_]?key|private[-_]?key|token|secret|passw(?:or)?d|passphrase)"
_SECRET_OPTION = re.compile(_OPTION, re.IGNORECASE)
"""An option of a command that takes a secret, whole."""


@dataclass(frozen=True)
class SecretShape:
    """A kind of secret, and the pattern that recognises it.

    Texts may be hostile: no pattern looks at a character more often than a fixed number of times.

    Args:
        name: Name that replaces it.
        hints: Every text that the pattern matches contains one of these, in lower case.
        pattern: Its group ``secret`` is replaced.
    """

    name: str
    hints: tuple[str, ...]
    pattern: Pattern[str]


def _shape(name: str, hints: str, pattern: str) -> SecretShape:
    if "(?P<secret>" not in pattern:
        pattern = f"(?P<secret>{pattern})"
    return SecretShape(name, tuple(hints.split()), re.compile(pattern, re.DOTALL))


_KEY = r"(?<![A-Za-z0-9])"
"""No letter or digit comes before: ``task-`` begins no key, though it ends like one."""

_SECRET_SHAPES = (
    _shape(
        "private key",
        "-----begin",
        r"-----BEGIN [A-Z0-9 ]*PRIVATE KEY(?: BLOCK)?-----.*?"
        r"(?:-----END [A-Z0-9 ]*PRIVATE KEY(?: BLOCK)?-----|\Z)",
    ),
    _shape("API key", "sk-", _KEY + r"sk-(?=[A-Za-z_-]{0,64}[0-9])[A-Za-z0-9_-]{16,}"),
    _shape(
        "API key",
        "sk_live_ sk_test_ rk_live_ rk_test_",
        _KEY + r"[sr]k_(?:live|test)_[A-Za-z0-9]{10,}",
    ),
    _shape("API key", "aiza", _KEY + r"AIza[A-Za-z0-9_-]{30,}"),
    _shape("GitHub token", "ghp_ gho_ ghu_ ghs_ ghr_", _KEY + r"gh[pousr]_[A-Za-z0-9]{16,}"),
    _shape("GitHub token", "github_pat_", _KEY + r"github_pat_[A-Za-z0-9_]{16,}"),
    _shape("GitLab token", "glpat-", _KEY + r"glpat-[A-Za-z0-9_-]{16,}"),
    _shape("package token", "hf_ npm_ pypi-", _KEY + r"(?:hf_|npm_|pypi-)[A-Za-z0-9_-]{30,}"),
    _shape("AWS key", "akia asia", _KEY + r"(?:AKIA|ASIA)[0-9A-Z]{16}(?![0-9A-Za-z])"),
    _shape("Slack token", "xox", _KEY + r"xox[abeoprs]-[A-Za-z0-9-]{10,}"),
    _shape(
        "JSON web token",
        "eyj",
        r"(?<![A-Za-z0-9_-])eyJ[A-Za-z0-9_-]{8,}\.[A-Za-z0-9_-]{8,}(?:\.[A-Za-z0-9_-]*)*",
    ),
    _shape(
        "authorization",
        "authorization",
        r"(?i:authorization[\"']*\s*[:=]\s*[\"']*(?:(?:bearer|basic|digest|token|apikey)\s+)?)"
        r"(?P<secret>(?!(?:bearer|basic|digest|token|apikey)\s)[^\s\"',;]{8,})",
    ),
    _shape(
        "authorization",
        "bearer",
        r"(?i:\bbearer\s+)(?P<secret>(?=[A-Za-z._~+/=-]{0,64}[0-9])[A-Za-z0-9._~+/=-]{16,})",
    ),
    _shape("URL password", "://", r"://[^/\s:@\"'?#]*:(?P<secret>[^/\s@\"']+)@"),
    _shape("URL password", "://", r"://(?P<secret>[^/\s:@\"'?#]{16,})@"),
    _shape(
        "option",
        "key token secret passw passphrase credential authorization",
        rf"(?i:(?<![\w-]){_OPTION})(?:=|\s+(?!-))(?P<secret>{_SHELL_ARGUMENT})",
    ),
    _shape(
        "assignment",
        "key token secret passw passphrase",
        rf"(?i:{_NAME}s?[\"']*\s*[:=]\s*)(?P<secret>\"(?:\\.|[^\"\\])+\"|'(?:\\.|[^'\\])+'"
        r"|(?=[^\s\"',;)}\]]{0,64}[0-9])[^\s\"',;(){}\[\]]{8,})",
    ),
)


def _secret_forms(value: str) -> set[str]:
    """Collect a value escaped for JSON, Python, shells, HTML and URLs, and in hexadecimal."""
    quoted = shlex.quote(value)
    forms = {value, value.strip(), quoted if quoted == value else quoted[1:-1]}
    forms |= {html(value), html(value, quote=False)}
    # Data within data is escaped twice.
    for ascii_only in (True, False):
        once = json.dumps(value, ensure_ascii=ascii_only)[1:-1]
        forms |= {once, json.dumps(once, ensure_ascii=ascii_only)[1:-1]}
    forms.add(repr(value)[1:-1])
    forms.add(value.encode("unicode_escape").decode("ascii"))
    data = _bytes(value)
    for safe in ("", "/", "/:=&?"):
        for encoded in (quote(data, safe=safe), quote_plus(data, safe=safe)):
            forms |= {encoded, _lower_escapes(encoded)}
    forms |= {data.hex(), data.hex().upper()}
    return forms


def _base64_cores(value: str) -> set[str]:
    """Collect what the base64 of any text with this value in it contains, in both alphabets.

    Three bytes make four characters, so that it depends on where the value begins; characters
    that depend on its neighbours as well are left out.
    """
    data = _bytes(value)
    cores = set()
    for offset in range(3):
        encoded = base64.b64encode(b"\0" * offset + data).decode("ascii")
        core = encoded[(0, 2, 3)[offset] : (offset + len(data)) * 8 // 6]
        for variant in (core, core.translate(_URL_SAFE)):
            cores |= {variant, quote(variant, safe="")}
    return cores


_DOTS = ("...", "…")
_BASE64 = string.ascii_letters + string.digits + "+/-_%"
_URL_SAFE = str.maketrans("+/", "-_")


def _common_length(text: str, other: str) -> int:
    return len(os.path.commonprefix((text, other)))  # noqa: RUF071 - of characters, not of paths


def _bytes(value: str) -> bytes:
    try:
        return value.encode("utf-8", "surrogateescape")  # as the environment holds bytes
    except UnicodeEncodeError:  # another lone surrogate
        return value.encode("utf-8", "backslashreplace")


def _lower_escapes(text: str) -> str:
    """Replace ``%2F`` by ``%2f`` and the like."""
    head, *rest = text.split("%")
    return "%".join([head, *(piece[:2].lower() + piece[2:] for piece in rest)])


_PIECE = 12
"""Characters of a truncated secret from which on it is recognised."""
_MOST_KEPT = 100_000
"""Characters of texts up to which it is kept that they hold no secret."""
_PARAMETER_NAME = "parameter"
"""Name for the value of a parameter that is secret by its own name."""

_MARK = re.compile(r"(\[redacted: [\w. -]{1,200}\])")
_HINT = "[redacted: "
_NAMES_IN_DATA = ("key", "token", "secret", "passw", "passphrase", "credential", "authorization")
_SHAPE_NAMES = {_PARAMETER_NAME, *(shape.name for shape in _SECRET_SHAPES)}
_HINTS = {*_NAMES_IN_DATA, *(hint for shape in _SECRET_SHAPES for hint in shape.hints)}
"""Without any of these in a text, in lower case, it has no secret that is known by its shape."""


class Redactor:
    """Replaces secrets in plain data by ``[redacted: NAME]``.

    It recognises the values that were added, in every form, the shapes of common secrets, and
    texts under keys such as ``api_key``. What is redacted already stays as it is.

    Args:
        globs: Names of further variables whose values are secrets, in letters of any case.

    Attributes:
        ignored: Names of variables whose values are too short or too ordinary to be redacted.
    """

    def __init__(self, globs: Sequence[str] = ()) -> None:
        self._globs = tuple(globs)
        self.ignored: set[str] = set()
        self._values: dict[str, str] = {}
        self._forms: dict[str, str] = {}
        self._cores: dict[str, str] = {}
        self._clean = ""
        """Texts without a secret that were searched last: reports of one item show the same."""
        self._environ: dict[Any, Any] = {}
        """As the environment holds it: in bytes, where it is the process's own."""

    @classmethod
    def of_environment(cls, environ: Mapping[str, str], globs: Sequence[str] = ()) -> Redactor:
        """Make a redactor for the secrets among the environment's variables."""
        redactor = cls(globs)
        redactor.learn(environ)
        return redactor

    def learn(self, environ: Mapping[str, str]) -> None:
        """Add the secrets of the environment; those added before stay."""
        # Called before anything is written, when hardly any variable has changed: `os.environ`
        # decodes each variable that it is asked for, while its bytes compare at once.
        encoded = getattr(environ, "_data", environ)
        if encoded == self._environ:
            return
        encoded = dict(encoded)
        changed = [key for key, value in encoded.items() if self._environ.get(key) != value]
        self._environ = encoded
        fresh = {name: environ[name] for name in map(os.fsdecode, changed)}
        for name, value in _secrets_of(fresh, self._globs):
            self.add(name, value)

    def add(self, name: str, value: str) -> None:
        """Add a secret.

        Args:
            name: Name that replaces it.
            value: Its value; one that is too short or too ordinary is ignored, see ``ignored``.
        """
        stripped = value.strip()
        if is_common(stripped) or _is_record_vocabulary(stripped):
            self.ignored |= {name} if stripped else set()
            return
        name = re.sub(r"[^\w. -]", "_", name)[:200]
        self._clean = ""
        self._values.setdefault(value, name)
        for known, forms in (
            (self._forms, _secret_forms(value)),
            (self._cores, _base64_cores(stripped)),
        ):
            for form in forms:
                if len(form) >= _SHORTEST_SECRET:
                    known.setdefault(form, name)

    def redact(self, value: Any) -> Any:
        """Return the plain data without secrets, or the very same object if it has none."""
        active = self._active([value] if isinstance(value, str) else _texts(value))
        return active.data(value) if active else value

    def may_change(self, value: Any) -> bool:
        """Whether :meth:`redact` may find something in plain data, or in a part of it."""
        return bool(self._active(_texts(value)))

    def _active(self, texts: Iterable[str]) -> _Active:
        """Select the secrets and shapes that may occur in any of these texts."""
        joined = "\n".join(texts)
        if not joined or joined == self._clean:
            return _NOTHING
        lower = joined.lower()
        steps: list[Callable[[str], str]] = []
        if cores := {core: name for core, name in self._cores.items() if core in joined}:
            steps.append(_replacing(cores, encoded=True))
        if forms := {form: name for form, name in self._forms.items() if form in joined}:
            steps.append(_replacing(forms))
        # Without a beginning or an end of a value there is no piece of it either.
        steps += [
            partial(_cut_pieces, value, name)
            for value, name in self._values.items()
            if len(value) > _PIECE and (value[:_PIECE] in joined or value[-_PIECE:] in joined)
        ]
        hints = {hint for hint in _HINTS if hint in lower}
        if not (hints or steps):
            self._clean = joined if len(joined) < _MOST_KEPT else ""
            return _NOTHING
        shapes = [each for each in _SECRET_SHAPES if not hints.isdisjoint(each.hints)]
        steps += [partial(_shaped, shape) for shape in shapes]
        names = _SHAPE_NAMES | set(self._values.values())
        return _Active(names, steps, named=not hints.isdisjoint(_NAMES_IN_DATA))


@dataclass(frozen=True)
class _Active:
    """Part of a Redactor that may match something in the data at hand."""

    names: set[str]
    steps: Sequence[Callable[[str], str]]
    named: bool
    """Whether a key may name a secret."""

    def __bool__(self) -> bool:
        """Whether there may be anything to redact."""
        return bool(self.steps) or self.named

    def text(self, text: str) -> str:
        """Redact a text."""
        for step in self.steps:
            if _HINT not in text:
                text = step(text)
                continue
            # Marks stay as they are, unless a secret hides in what looks like one.
            parts = _MARK.split(text)
            for i, part in enumerate(parts):
                if not (i % 2 and part[len(_HINT) : -1] in self.names):
                    parts[i] = step(part)
            text = "".join(parts)
        return text

    def data(self, value: Any) -> Any:
        """Redact plain data."""
        if isinstance(value, str):
            return self.text(value)
        if isinstance(value, Mapping):
            redacted: dict[Any, Any] = {}
            for key, entry in value.items():
                new = self.text(key) if isinstance(key, str) else key
                while new in redacted:  # two keys that differed by their secrets alone
                    new = f"{new} (another)"
                plain = self.data(entry)
                if isinstance(key, str) and _is_open(plain) and _SECRET_PARAMETER.match(key):
                    plain = _mark(_PARAMETER_NAME)
                redacted[new] = plain
            return redacted
        if isinstance(value, (list, tuple)):
            entries = [self.data(entry) for entry in value]
            for i, entry in enumerate(value[:-1]):
                following = value[i + 1]
                if (
                    isinstance(entry, str)
                    and _SECRET_OPTION.fullmatch(entry)
                    and _is_open(following)
                ):
                    entries[i + 1] = _mark("option")
            return entries if isinstance(value, list) else tuple(entries)
        return value


_NOTHING = _Active(set(), (), named=False)


def count_redactions(value: Any) -> Counter[str]:
    """Count the marks of redactions by name, in plain data or in a text of JSON."""
    texts = [value] if isinstance(value, str) else _texts(value)
    marks = (mark for text in texts if _HINT in text for mark in _MARK.findall(text))
    return Counter(mark[len(_HINT) : -1] for mark in marks)


def holds_redaction(value: Any) -> bool:
    """Whether plain data has lost a secret, so that nothing can be run from it."""
    return bool(count_redactions(value))


def _mark(name: str) -> str:
    return f"{_HINT}{name}]"


def _is_open(value: Any) -> bool:
    """Whether a value is a text, not empty, from which nothing was redacted."""
    return isinstance(value, str) and bool(value) and not _MARK.search(value)


def _replacing(known: Mapping[str, str], *, encoded: bool = False) -> Callable[[str], str]:
    # The longest first: one form may begin like another.
    ordered = sorted(known, key=lambda form: (-len(form), form))
    pattern = re.compile("|".join(map(re.escape, ordered)))

    def replaced(text: str) -> str:
        match, done, parts = pattern.search(text), 0, []
        while match is not None:
            begin, end = match.span()
            if encoded:  # the whole base64 that a core is part of
                begin = done + len(text[done:begin].rstrip(_BASE64))
                end = len(text) - len(text[end:].lstrip(_BASE64 + "="))
            parts += [text[done:begin], _mark(known[match[0]])]
            done = end
            match = pattern.search(text, done)
        return "".join([*parts, text[done:]])

    return replaced


def _cut_pieces(value: str, name: str, text: str) -> str:
    """Replace what a text holds of the beginning or the end of a value, cut off with dots."""
    head, tail, pieces = value[:_PIECE], value[-_PIECE:], list[tuple[int, int]]()
    start = text.find(head)
    while start >= 0:
        end = start + _common_length(value, text[start : start + len(value)])
        if text.startswith(_DOTS, end):
            pieces.append((start, end))
        start = text.find(head, start + 1)
    start = text.find(tail)
    while start >= 0:
        end = start + len(tail)
        begin = end - _common_length(value[::-1], text[max(0, end - len(value)) : end][::-1])
        if text.endswith(_DOTS, 0, begin):
            pieces.append((begin, end))
        start = text.find(tail, start + 1)
    done, parts = 0, []
    for begin, end in sorted(pieces):
        if begin >= done:
            parts += [text[done:begin], _mark(name)]
            done = end
    return "".join([*parts, text[done:]])


def _shaped(shape: SecretShape, text: str) -> str:
    def replaced(match: re.Match[str]) -> str:
        begin, end = (at - match.start() for at in match.span("secret"))
        return match[0][:begin] + _mark(shape.name) + match[0][end:]

    return shape.pattern.sub(replaced, text)


def _texts(value: Any) -> Iterator[str]:
    """Yield every text in plain data, keys too, in no particular order."""
    pending = [value]
    while pending:
        element = pending.pop()
        kind = type(element)  # exact types first: of the data of a session most are these
        if isinstance(element, str):
            yield element
        elif kind is dict:
            yield from [key for key in element if isinstance(key, str)]
            pending += [part for part in element.values() if type(part) not in _WITHOUT_TEXT]
        elif kind is list or kind is tuple:
            pending += [part for part in element if type(part) not in _WITHOUT_TEXT]
        elif kind in _WITHOUT_TEXT:
            continue
        elif is_dataclass(element):
            pending.append(encode(element))
        elif isinstance(element, Mapping):
            yield from (key for key in element if isinstance(key, str))
            pending.extend(element.values())
        elif isinstance(element, (list, tuple)):
            pending.extend(element)


_WITHOUT_TEXT = frozenset({float, int, bool, type(None)})


def _is_record_vocabulary(value: str) -> bool:
    """Whether a value is part of a name of the record itself, which must stay readable."""
    from pytest_dura.evidence.schema import record_vocabulary

    return any(value in term for term in record_vocabulary())
