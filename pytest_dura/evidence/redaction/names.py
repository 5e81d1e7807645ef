"""Which names speak of secrets: of environment variables, and of parameters."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from urllib.parse import unquote, urlsplit

SHORTEST = 8
"""Characters; a shorter value would be found everywhere, and is no secret worth the name."""

_VARIABLE = re.compile(
    r"(?:TOKEN|SECRET|PASSWORD|PASSWD|PASSPHRASE|SSHPASS|CREDENTIAL|APIKEY)S?(?=_|\d*$)"
    r"|(?:^|_)(?:KEY|PASS|PWD|AUTH|COOKIE)S?(?=_|\d*$)"
)
_NO_SECRET = re.compile(r"_(?:FILE|PATH|DIR|SOCK|SOCKET|HOME)$|^(?:OLD)?PWD$")
PARAMETER = re.compile(
    r"(?:^|.*[^a-z])(?:(?:api|access|private|secret|auth|account|encryption)[-_ ]?keys?"
    r"|token|secrets?|passw(?:or)?ds?|passphrase|credentials?|authorization)$",
    re.IGNORECASE,
)
"""The whole name of a parameter, a header or a key of data."""

_COMMON = {
    "password", "passwords", "changeme", "redacted", "disabled", "undefined", "required",
    "optional", "production", "development", "localhost", "username", "anonymous",
}  # fmt: skip


def secrets_of(environ: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """``(name, value)`` of the variables that hold secrets, and of passwords in their URLs."""
    for name, value in sorted(environ.items()):
        upper = name.upper()
        if _VARIABLE.search(upper) and not _NO_SECRET.search(upper):
            yield name, value
        elif "://" in value and "@" in value:
            password = _password(value)
            if password:
                yield name, password


def is_common(value: str) -> bool:
    """Whether a value is too short or too ordinary to be told from any other text."""
    return len(value) < SHORTEST or len(set(value)) < 3 or value.lower() in _COMMON


def _password(url: str) -> str | None:
    try:
        found = urlsplit(url).password
    except ValueError:  # no URL after all
        return None
    return None if found is None else unquote(found)
