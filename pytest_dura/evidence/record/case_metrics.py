"""CaseMetrics: what a case's episodes come to, which are seen one at a time."""

from __future__ import annotations

import math
import statistics
from array import array
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from pytest_dura.core.metrics import DISCOMFORT
from pytest_dura.evidence.record.failure_modes import FailureModes
from pytest_dura.evidence.record.faults import FaultMetrics

COUNTED = ("flagged", "collided", "gridlock")
DERIVED = ("comfort_failed", "rescued")
SUMMED = ("decisions", "recovered", "takeovers", "switches", "censored")

Data = Mapping[str, Any]


class CaseMetrics:
    """What the planned episodes of a case with one component come to.

    Of an episode it keeps a few numbers at most, so that there may be many of them.
    """

    def __init__(self) -> None:
        self._words: Counter[str] = Counter()
        self._early = 0
        self._known: set[str] = set()
        self._in_run: Counter[str] = Counter()
        self._in_valid: Counter[str] = Counter()
        self._sums: Counter[str] = Counter()
        self._clears = False
        self._times = array("d")
        self._switching: Counter[str] = Counter()
        self._times_to_safe = array("d")
        self._reactions: Counter[str] = Counter()
        self._user: dict[str, array[float]] = {}
        self._faults = FaultMetrics()
        self._failure_modes = FailureModes()

    def add(self, episode: Data) -> None:
        """Take in an episode.

        Args:
            episode: Of :func:`episode_record`.
        """
        told = episode["outcome"]
        known = {**{key: told[key] for key in COUNTED}, **_derived(episode)}
        raised = [key for key, value in known.items() if value]
        self._words[episode["validity"]] += 1
        self._early += episode["termination"] == "decided"
        self._known.update(key for key, value in known.items() if value is not None)
        self._in_run.update(raised)
        self._faults.add(episode)
        if episode["validity"] != "valid":
            return
        self._in_valid.update(raised)
        self._sums.update({key: told[key] for key in ("recoveries", "alerts")})
        self._reactions.update(episode["metrics"]["reactions"])
        self._clears |= told["gridlock"] is not None
        if told["clearance_time"] is not None:
            self._times.append(told["clearance_time"])
        self._failure_modes.add(episode["metrics"])
        if told["switching"]["decisions"]:
            self._add_switching(told["switching"])
        for name, value in episode["metrics"]["user"].items():
            column = self._user.setdefault(name, array("d"))
            if value is not None:
                column.append(value)

    def _add_switching(self, told: Data) -> None:
        self._switching["episodes"] += 1
        self._switching.update({key: told[key] for key in SUMMED})
        self._times_to_safe.extend(time for time in told["time_to_safe"] if time is not None)

    def to_json(self, planned: int) -> dict[str, Any]:
        """Plain data.

        Counts of ``flagged``, ``collided``, ``gridlock``, ``comfort_failed`` and ``rescued`` are
        given over valid episodes and over all that were run, each with its share: of the valid
        ones, and of the planned ones. Of those that ended once all was decided (``ended_early``),
        they are what was seen by then.

        Args:
            planned: Episodes that were planned.
        """
        times = self._times
        clearance = {
            "runs": len(times),
            "mean": statistics.fmean(times) if times else None,
            "sd": statistics.stdev(times) if len(times) > 1 else None,
        }
        return {
            "planned": planned,
            "run": self._words.total(),
            **{word: self._words[word] for word in ("valid", "invalid", "missing")},
            "ended_early": self._early,
            **{key: self._share(key, planned) for key in COUNTED},
            "clearance_time": clearance if self._clears else None,
            **{key: self._sums[key] for key in ("recoveries", "alerts")},
            **{key: self._share(key, planned) for key in DERIVED},
            "reactions": dict(sorted(self._reactions.items())),
            "switching": self._shared_control(),
            "user": {
                name: {"mean": statistics.fmean(column) if column else None, "runs": len(column)}
                for name, column in self._user.items()
            },
            "faults": self._faults.to_json(),
            "failure_modes": self._failure_modes.to_json(),
            "answer_times": self._failure_modes.answer_times(),
            "answer_ages": self._failure_modes.answer_ages(),
        }

    def _share(self, key: str, planned: int) -> dict[str, Any] | None:
        """``None`` where no episode has such a signal."""
        if key not in self._known:
            return None
        valid = self._words["valid"]
        return {
            "valid": self._in_valid[key],
            "run": self._in_run[key],
            "share_of_valid": self._in_valid[key] / valid if valid else None,
            "share_of_planned": self._in_run[key] / planned if planned else None,
        }

    def _shared_control(self) -> dict[str, Any] | None:
        """How control was shared over the valid episodes: see :class:`Switching` for the terms."""
        sums, times = self._switching, self._times_to_safe
        if not sums["episodes"]:
            return None
        return {
            "share": sums["recovered"] / sums["decisions"],
            "takeovers": sums["takeovers"],
            "switches_per_episode": sums["switches"] / sums["episodes"],
            "time_to_safe": {
                "median": statistics.median(times) if times else None,
                "max": max(times) if times else None,
                "censored": sums["censored"],
            },
        }


def in_order(case: Data) -> tuple[float, str, str]:
    """What cases are sorted by: the place that the scenario gives, then their names."""
    place = math.inf if case["order"] is None else case["order"]
    return place, case["id"], case["component"]


class Pooled:
    """What the planned episodes of all cases of a component come to, twins of pairs left out.

    Args:
        cases: Of the record, with or without their metrics.
        verdicts: Of the record.
    """

    def __init__(self, cases: Iterable[Data], verdicts: Iterable[Data] = ()) -> None:
        self._planned: Counter[str] = Counter()
        self._cases: dict[str, set[str]] = {}
        judged, twins = set(), set()
        for verdict in verdicts:
            judged.add(verdict["case"])
            if verdict["pairs"]:
                twins.add(verdict["pairs"]["case"])
        for case in cases:
            # A case without faults may be a twin, or be judged for its own sake.
            if not case["without"] and case["id"] not in twins - judged:
                self._planned[case["component"]] += case["planned"]
                self._cases.setdefault(case["component"], set()).add(case["id"])
        self._metrics = {component: CaseMetrics() for component in self._cases}

    def add(self, episode: Data) -> None:
        """Take in a planned episode of any of the record's cases."""
        component = episode["component"]
        if episode["case"] in self._cases.get(component, ()):
            self._metrics[component].add(episode)

    def to_json(self) -> list[dict[str, Any]]:
        """Plain data: an entry for each component, by name."""
        return [
            {
                "component": component,
                "cases": len(self._cases[component]),
                "metrics": self._metrics[component].to_json(self._planned[component]),
            }
            for component in sorted(self._cases)
        ]


def _derived(episode: Data) -> dict[str, bool | None]:
    """What follows from an episode's measures; ``None`` where nothing measures it."""
    discomfort = episode["metrics"]["performance"].get(DISCOMFORT)
    switching = episode["outcome"]["switching"]
    return {
        "comfort_failed": None if discomfort is None else discomfort["max"] > 1.0,
        "rescued": switching["takeovers"] > 0 if switching["decisions"] else None,
    }
