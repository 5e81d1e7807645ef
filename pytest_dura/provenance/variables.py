"""The environment variables that code reads by their names."""

from __future__ import annotations

import hashlib
import os
import re

_READ = re.compile(
    r"""\b(?:environb?(?:\s*\[|\s*\.\s*(?:get|setdefault|pop)\s*\()|getenvb?\s*\()\s*
    b?["']([A-Za-z_]\w*)["']""",
    re.VERBOSE,
)
_OF_A_RUN = re.compile(r"PYTEST_|.*(?:KEY|TOKEN|SECRET|PASSW|CREDENTIAL)", re.IGNORECASE)
"""Names of what is another one in each process or for each user, and no episode should rest on."""


def variables_in(text: str) -> set[str]:
    """The names of the variables that a text of Python reads; computed names are not found.

    Secrets are left out, and what pytest sets for each of its processes and tests.
    """
    return {name for name in _READ.findall(text) if not _OF_A_RUN.match(name)}


def describe_variable(name: str) -> str:
    """SHA-256 of its value, or that it is not set."""
    value = os.environ.get(name)
    if value is None:
        return "not set"
    return hashlib.sha256(f"{name}={value}".encode("utf-8", "surrogateescape")).hexdigest()
