"""Anchors of the report: where other formats may point with ``report.html#...``."""

from __future__ import annotations

import hashlib
import re

LONGEST = 80
"""Readable characters of an anchor."""


def requirement_anchor(requirement: str) -> str:
    """Of a requirement and all its verdicts. It is there for each requirement of the record."""
    return anchor("requirement", requirement)


def verdict_anchor(requirement: str, case: str) -> str:
    """Of the first verdict on a requirement and a case.

    It is there for each such pair, unless the case is folded; see :func:`folded_cases`.
    """
    return anchor("verdict", requirement, case)


def case_anchor(case: str) -> str:
    """Of a case among the scenarios. It is there for each case of the record that is not folded."""
    return anchor("case", case)


def episode_anchor(episode: str, component: str) -> str:
    """Of an episode in the list, which is bounded: of many episodes not all are there."""
    return anchor("episode", episode, component)


def player_anchor(episode: str, component: str) -> str:
    """Of an episode's player. Only a bounded number of episodes has one."""
    return anchor("player", episode, component)


def anchor(kind: str, *parts: str) -> str:
    """An anchor of letters, digits, dots and dashes, whatever the parts hold.

    Two lists of parts that differ never have the same one: a short hash tells them apart, where
    the readable text leaves anything out.
    """
    told = "-".join(part[:LONGEST] for part in parts)
    readable = re.sub(r"[^A-Za-z0-9._]+", "-", told).strip("-")[:LONGEST]
    if len(parts) == 1 and readable == parts[0]:
        return f"{kind}-{readable}"
    joined = "\0".join(parts).encode("utf-8", "surrogatepass")
    return f"{kind}-{readable}-{hashlib.sha256(joined).hexdigest()[:10]}"
