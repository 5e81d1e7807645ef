"""Shapes by which a secret is known that nobody named: tokens of services, keys, passwords."""

from __future__ import annotations

import re
from dataclasses import dataclass
from re import Pattern

_WORD = r"""(?:'[^']*'|"(?:\\.|[^"\\])*"|\\.|[^\s'"\\])+"""
"""A word of a shell's command line."""
_OPTION = (
    r"--?(?:[A-Za-z0-9]+[-_])*(?:api[-_]?key|access[-_]?key|private[-_]?key|token|secret"
    r"|passw(?:or)?d|passphrase|credentials?|authorization)"
)
_NAME = r"(?:api[-_]?key|access[-_]?key|private[-_]?key|token|secret|passw(?:or)?d|passphrase)"
OPTION = re.compile(_OPTION, re.IGNORECASE)
"""An option of a command that takes a secret, whole."""


@dataclass(frozen=True)
class Shape:
    """A kind of secret, and how it is known.

    Texts may be hostile: no pattern looks at a character more often than a fixed number of times.

    Args:
        name: What stands in its place.
        hints: Of these, in lower case, one is in every text that the pattern matches.
        pattern: Its group ``secret`` is replaced.
    """

    name: str
    hints: tuple[str, ...]
    pattern: Pattern[str]


def _shape(name: str, hints: str, pattern: str) -> Shape:
    if "(?P<secret>" not in pattern:
        pattern = f"(?P<secret>{pattern})"
    return Shape(name, tuple(hints.split()), re.compile(pattern, re.DOTALL))


_KEY = r"(?<![A-Za-z0-9])"
"""No letter or digit comes before: ``task-`` begins no key, though it ends like one."""

SHAPES = (
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
        rf"(?i:(?<![\w-]){_OPTION})(?:=|\s+(?!-))(?P<secret>{_WORD})",
    ),
    _shape(
        "assignment",
        "key token secret passw passphrase",
        rf"(?i:{_NAME}s?[\"']*\s*[:=]\s*)(?P<secret>\"(?:\\.|[^\"\\])+\"|'(?:\\.|[^'\\])+'"
        r"|(?=[^\s\"',;)}\]]{0,64}[0-9])[^\s\"',;(){}\[\]]{8,})",
    ),
)
