"""An own planner: waits at the line until the crossing road is empty within sight, then goes."""

from __future__ import annotations

import math

from pytest_dura import Generator, GeneratorView, Proposal


class PatientPlanner(Generator):
    """Crosses only when no car is on the crossing road within some distance.

    Args:
        sight: Metres from the junction within which a car on the crossing road makes it wait.
    """

    def __init__(self, sight: float = 45.0) -> None:
        self.sight = sight

    def propose(self, view: GeneratorView) -> Proposal:
        """A maneuver by name; the vehicle turns it into an acceleration."""
        pose = view.percept["localisation"]
        way = view.percept["map"]
        s, _ = way.route.project(pose.x, pose.y)
        front = s + 2.5
        if front > way.stop_line:
            return Proposal("accelerate", "is in the junction and leaves it")
        for body in view.percept["lidar"]:
            on_crossing_road = abs(body.y) < 5.0 and abs(body.x) < self.sight
            leaving = body.x * body.vx > 0.0 and abs(body.x) > 8.0
            if on_crossing_road and not leaving:
                return Proposal("wait", f"waits for {body.id}")
            if math.hypot(body.x - pose.x, body.y - pose.y) < 15.0 and body.is_pedestrian:
                return Proposal("wait", "waits for a pedestrian")
        return Proposal("proceed", "nobody comes")
