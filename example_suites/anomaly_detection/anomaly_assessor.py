"""A SecurityAssessor that learned from episodes without faults what the sensors report together."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from sklearn.svm import OneClassSVM

from pytest_dura import (
    Alert,
    Assessed,
    ConfigurationError,
    Orchestrator,
    Percept,
    RoleContext,
    RoleView,
    SecurityAssessment,
    SecurityAssessor,
    stream,
)
from pytest_dura.library import expand_cases, load_library

SCENARIO, RUNS, SEED = "intersection/congested", 10, 1
"""What it learns on, without faults; no test runs on this base seed."""
NOISE = {
    "odometry.speed": 0.7,  # m/s2: gain of speed less the acceleration of the imu
    "localisation.along": 0.7,  # m/s: displacement ahead less the speed of the odometry
    "localisation.across": 0.7,  # m/s: displacement aside
    "localisation.heading": 0.03,  # rad/s: turn less the yaw rate of the imu
    "lidar.displacement": 0.4,  # m/s: how far an object leaps off its own velocity, at most
    "lidar.position": 0.3,  # m: from an object to the nearest return of the radar, at most
}
"""The features, each with the standard deviation that sensors would give it: those of the simulator
are exact, and on exact sensors any threshold would do. Training adds it; no episode has it."""
REACH, CAP = 78.0, 50.0
"""m from the ego, beyond which lidar and radar may see other objects; greatest feature."""


def features(before: Percept, now: Percept, dt: float) -> np.ndarray:
    """One number for each of NOISE, in units of it, near 0 while the sensors agree."""
    pose, last, radar = now["localisation"], before["localisation"], now["radar"]
    here, speed = np.complex128(complex(pose.x, pose.y)), now["odometry"].speed
    earlier = {body.id: body for body in before["lidar"]}
    known = [(body, earlier[body.id]) for body in now["lidar"] if body.id in earlier]
    with np.errstate(all="ignore"):  # a fault may report 1e300 m
        moved = (here - complex(last.x, last.y)) / dt * np.exp(-1j * last.heading)
        turned = np.angle(np.exp(1j * (pose.heading - last.heading))) / dt
        leaps = [
            np.hypot((body.x - old.x) / dt - old.vx, (body.y - old.y) / dt - old.vy)
            for body, old in known
        ]
        places = np.array([complex(body.x, body.y) for body in now["lidar"]], dtype=complex)
        places = places[np.abs(places - here) < REACH, None]
        returns = here + radar[:, 0] * np.exp(1j * (pose.heading - radar[:, 1]))
        row = [
            (speed - before["odometry"].speed) / dt - now["imu"].acceleration,
            moved.real - speed,
            moved.imag,
            turned - now["imu"].yaw_rate,
            max(leaps, default=0.0),
            np.abs(places - returns).min(axis=1, initial=REACH).max(initial=0.0),
        ]
        return np.nan_to_num(np.clip(row / np.array([*NOISE.values()]), -CAP, CAP), nan=CAP)


def nominal_rows(run: int) -> np.ndarray:
    """The features of an episode without faults, as sensors with NOISE would give them."""
    (case,) = expand_cases([load_library([]).scenarios[SCENARIO]], ["none"])
    spec = case.spec(run, SEED)
    orchestrator = Orchestrator.build(spec)
    if orchestrator.run(spec).failure is not None:
        raise RuntimeError(f"run {run} of {SCENARIO} cannot be learned from")
    pairs = pairwise(orchestrator.state.percepts)
    rows = np.array([features(before, now, spec.time_step) for before, now in pairs])
    return rows + stream(SEED, f"noise/{run}").normal(size=rows.shape)


@lru_cache
def trained() -> tuple[OneClassSVM, float, str]:
    """A model of the first half of the runs, the least score of the other half, and a digest."""
    tapes = [nominal_rows(run) for run in range(RUNS)]
    model = OneClassSVM(nu=0.001).fit(np.concatenate(tapes[: RUNS // 2]))
    threshold = float(model.score_samples(np.concatenate(tapes[RUNS // 2 :])).min())
    return model, threshold, hashlib.sha256(np.concatenate(tapes).tobytes()).hexdigest()


class AnomalyAssessor(SecurityAssessor):
    """Alerts at each tick that is less like the training than all that was held out from it.

    Args:
        rows: SHA-256 of what it learned from. It is filled in, so that each episode's spec states
            it. There is no model file: it learns anew in each process, from the same episodes.
    """

    reassess = False

    def __init__(self, rows: str = "") -> None:
        self.model, self.threshold, digest = trained()
        if rows not in ("", digest):
            raise ConfigurationError("it learned from other episodes", found=digest, expected=rows)

    @classmethod
    def resolve_parameters(cls, params: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"rows": trained()[2], **params}

    def reset(self, context: RoleContext) -> None:
        self._before: Percept | None = None

    def run(self, view: RoleView) -> SecurityAssessment:
        before, self._before = self._before, view.percept
        if before is None:
            return SecurityAssessment()
        row = features(before, view.percept, view.dt)
        margin = float(self.model.score_samples(row[None])[0]) - self.threshold
        if margin >= 0.0:
            return SecurityAssessment(score=margin)
        name = list(NOISE)[int(np.abs(row).argmax())]
        alert = Alert(f"anomaly:{name}", name.partition(".")[0], f"scores {-margin:.2g} too low")
        return SecurityAssessment(Assessed.WARNING, margin, (alert.pattern,), alerts=(alert,))
