"""What we are ourselves: our name, version, and the digest of our own code."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from pytest_dura.provenance.sources import sources_of

_OURS = "pytest_dura"
_MOST = 5000
"""Files of our own, all of which count."""


@cache
def describe_tool() -> dict[str, Any]:
    """Name, version, and the digest of all our own Python files as they are when first asked.

    Development checkouts and installations that were changed have the version of a release; the
    digest tells them apart. It takes some 15 ms, once a process.

    Returns:
        ``name``, ``version``, ``code``: the SHA-256 of :func:`sources_of`, the same wherever it is
        installed, or ``None`` where the files cannot be read, as in a zip file.
    """
    # Our own name is loaded in any case; to import it by statement would reach for all of us.
    package = import_module(_OURS)
    return {"name": "pytest-dura", "version": package.__version__, "code": _digest()}


def own_code() -> str:
    """What tells our code from another, for addresses: its digest, else the version."""
    told = describe_tool()
    return told["code"] or f"version {told['version']}"


def _digest() -> str | None:
    file = Path(__file__).absolute().parents[1] / "__init__.py"
    found = sources_of(file, _OURS, file.parent, most=_MOST)
    return None if found is None else found.digest
