"""Conclusions on heads and episodes that a test makes up."""

from __future__ import annotations

from types import SimpleNamespace

KEYS = ("cases", "requirements", "judgements", "doubts", "searches", "verdicts", "monitors")


def concluded(conclusion, episodes=(), **head):
    """What a conclusion gives of these keys of the head and these episodes."""
    known = SimpleNamespace(**{**dict.fromkeys(KEYS, ()), **head})
    made = conclusion(known)
    for episode in episodes:
        made.add(episode)
    return made.concluded(known)
