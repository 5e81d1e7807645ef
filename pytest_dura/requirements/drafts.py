"""Drafts: requirements that a program wrote, which decide nothing until a person has signed them.

The source of such a requirement begins with :data:`DRAFTED`, and so says it in every report. The
signature of a person holds a digest of what was signed: after a change of text, kind, check, bound
or of what the source says of model and person it is unsigned again. It is a statement, as a name
below a document, and bound to no key.
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
_SIGNED = re.compile(r"(drafted, signed sha256:)([0-9a-f]{64})( by \S.*)")
_ELSEWHERE = ("source", "applies_to", "scale")
"""Fields that change neither what is required nor how it is judged."""


def draft_digest(requirement: Requirement, statement: str = "") -> str:
    """SHA-256 of what a person signs.

    Args:
        requirement: Of which source, scenarios and scale of a search do not count.
        statement: Its source after the signature, without the digest.
    """
    data = {name: each for name, each in asdict(requirement).items() if name not in _ELSEWHERE}
    whole = [data, statement] if statement else data
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()


_AUTHOR = "; draft of "
"""What stands between a person's decision and who drafted a requirement."""


def drafted_by(source: str) -> str:
    """Who drafted a requirement and how, of its source, whatever was decided on it since."""
    if source.startswith(NOT_REVIEWED):
        return source.removeprefix(NOT_REVIEWED)
    return source.partition(_AUTHOR)[2] or source


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
    who, what = (" ".join(each.replace(_AUTHOR.strip(), "").split()) for each in (who, what))
    decided = f" by {who} on {when}: {what}{_AUTHOR}{drafted_by(requirement.source)}"
    decided = " ".join(decided.split())
    if not accepted:
        return f"{DRAFTED}rejected {decided}"
    begins = f"{DRAFTED}signed sha256:"
    return f"{begins}{draft_digest(requirement, f'{begins} {decided}')} {decided}"


def is_rejected(requirement: Requirement) -> bool:
    """Whether a person has rejected a draft."""
    return requirement.source.startswith(f"{DRAFTED}rejected")


def unsigned_reason(requirement: Requirement) -> str:
    """Why a requirement may not support anything, in words; empty for one that is no draft."""
    source = " ".join(requirement.source.split())
    if not source.casefold().startswith(DRAFTED.strip()):
        return ""
    signed = _SIGNED.fullmatch(source)
    if signed is None:
        rejected = is_rejected(requirement)
        return f"it is a draft that {'a person rejected' if rejected else 'no person has signed'}"
    begins, digest, decided = signed.groups()
    if digest != draft_digest(requirement, f"{begins}{decided}"):
        return "it is a draft that was changed after a person signed it"
    return ""
