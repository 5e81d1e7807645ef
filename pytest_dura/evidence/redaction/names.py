"""Which names speak of secrets: of environment variables, and of parameters."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from urllib.parse import unquote, urlsplit

SHORTEST = 8
"""Characters; a shorter value would be found everywhere, and is no secret worth the name."""

_VARIABLE = re.compile(
    r"(?:TOKEN|SECRET|PASSWORD|PASSWD|PASSPHRASE|SSHPASS|CREDENTIAL|APIKEY)S?(?=_|\d*$)"
    r"|CONNECTION_?STRINGS?(?=_|\d*$)"
    # Whole parts of a name: PATH is no PAT, and a COMPASS no PASS.
    r"|(?:^|_)(?:KEY|PASS|PWD|AUTH|COOKIE|PAT|WEBHOOK|CRED|LICEN[SC]E|DSN|CONN_STR)S?(?=_|\d*$)"
    r"|(?:^|_)(?:DB|DATABASE|SQLALCHEMY\w*|MONGO\w*|REDIS\w*|POSTGRES\w*)_UR[IL](?=_|\d*$)"
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


def secrets_of(environ: Mapping[str, str], globs: Sequence[str] = ()) -> Iterator[tuple[str, str]]:
    """``(name, value)`` of the variables that hold secrets, and of passwords in their URLs.

    Args:
        environ: The variables.
        globs: Names that the user calls secret, in letters of any case.
    """
    own = [glob.upper() for glob in globs]
    for name, value in sorted(environ.items()):
        upper = name.upper()
        speaks = _VARIABLE.search(upper) and not _NO_SECRET.search(upper)
        if speaks or any(fnmatchcase(upper, glob) for glob in own):
            yield name, value
        if "://" in value and "@" in value:
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
