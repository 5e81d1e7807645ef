"""Checks and measures as functions of an episode."""

from __future__ import annotations

import math

from pytest_dura import CheckResult


def touches_nothing(episode):
    return bool((episode.signals["gap"] > 0).all())


def half_a_metre(episode):
    return episode.signals["gap"].min() - 0.5


def in_words(episode):
    late = float(episode.time[-1])
    return CheckResult(episode.signals["x"].max() < 1, margin=-2.5, time=late, detail="too far")


def never_concerned(episode):
    return CheckResult(True, vacuous=True)


def raises(episode):
    raise LookupError("no such map")


def nan(episode):
    return math.nan


def nothing(episode):
    return None


def farthest(episode):
    return episode.signals["x"].max()


def touched_at(episode):
    touched = episode.time[episode.signals["gap"] <= 0]
    return touched[0] if len(touched) else math.nan


def of_two(episode, other):
    return True


def exits(episode):
    raise SystemExit(3)


def at_no_time(episode):
    return CheckResult(False, time=math.nan)


def holds_by_number(episode):
    return CheckResult(-2.5)


def writes(episode):
    episode.signals["gap"][:] = -1.0
    return True
