"""Drafts: requirements that a program wrote, which decide nothing until a person has signed them.

The source of such a requirement begins with :data:`DRAFTED`, and so says it in every report. The
signature of a person holds a digest of what was signed: after a change of text, kind, check or
bound it is unsigned again. It is a statement, as a name below a document, and bound to no key.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import asdict

from pytest_dura.requirements.model import Requirement

DRAFTED = "drafted, "
"""Beginning of the source of a draft."""
NOT_REVIEWED = f"{DRAFTED}not reviewed: "
_SIGNED = re.compile(r"drafted, signed sha256:([0-9a-f]{64}) by \S")
_ELSEWHERE = ("source", "applies_to", "scale")
"""Fields that change neither what is required nor how it is judged."""


def draft_digest(requirement: Requirement) -> str:
    """SHA-256 of what a person signs: all but source, scenarios and scale of a search."""
    data = {name: each for name, each in asdict(requirement).items() if name not in _ELSEWHERE}
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


_AUTHOR = "; draft of "
"""What stands between a person's decision and who drafted a requirement."""


def drafted_by(source: str) -> str:
    """Who drafted a requirement and how, of its source, whatever was decided on it since."""
    _, found, author = source.rpartition(_AUTHOR)
    return author if found else source.removeprefix(NOT_REVIEWED)


def signed_source(
    requirement: Requirement, who: str, when: str, what: str, *, accepted: bool
) -> str:
    """Source of a draft that a person has accepted or rejected.

    Args:
        requirement: The draft.
        who: Name and role of the person.
        when: Day, YYYY-MM-DD.
        what: What was reviewed.
        accepted: Whether it may decide from now on.
    """
    word = f"signed sha256:{draft_digest(requirement)}" if accepted else "rejected"
    author = drafted_by(requirement.source)
    return f"{DRAFTED}{word} by {who} on {when}: {what}{_AUTHOR}{author}"


def unsigned_reason(requirement: Requirement) -> str:
    """Why a requirement may not support anything, in words; empty for one that is no draft."""
    source = " ".join(requirement.source.split())
    if not source.casefold().startswith(DRAFTED.strip()):
        return ""
    signed = _SIGNED.match(source)
    if signed is None:
        rejected = source.startswith(f"{DRAFTED}rejected")
        return f"it is a draft that {'a person rejected' if rejected else 'no person has signed'}"
    if signed[1] != draft_digest(requirement):
        return "it is a draft that was changed after a person signed it"
    return ""
