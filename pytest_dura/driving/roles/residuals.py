"""Residuals: by how much the ego's sensors contradict each other and a model of its motion.

Each is the difference of two accounts of the same quantity, and near 0 while all sensors are well.
The model is a kinematic bicycle with its centre midway between the axles: in a turn the centre
slides sideways, by the yaw rate times the distance to the rear axle. Where the model leaves room,
such as for the speed within a tick, only what is beyond that room counts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.roles import Assessed, RoleContext, SecurityAssessment, SecurityAssessor
from pytest_dura.core.state import Alert, RoleView
from pytest_dura.driving.bodies import CAR_LENGTH, VX, VY
from pytest_dura.driving.lanes import Route
from pytest_dura.driving.maneuvers import Command, Maneuver, acceleration_for
from pytest_dura.driving.scene import HALF
from pytest_dura.driving.sensors import Imu, Pose

ACTUATOR_SLEW = 40.0
"""m/s3; so fast does the ego's acceleration follow what is asked for."""
_LETS_OFF = 1.5
"""m/s; below this speed the brake may be let off, to come to a stop without a jerk."""
_TO_REAR = CAR_LENGTH / 2
"""m from the centre to the rear axle."""
_MOVES = 0.5
"""m/s or m/s2; what moves or accelerates by more is not measured at exactly the same value twice.
"""

EGO = ("odometry.speed", "localisation.along", "localisation.across", "localisation.heading")
"""The names of :func:`ego_residuals`."""


Row = list[float]


class Snapshot(NamedTuple):
    """Values of the sensors at a tick; the objects by id."""

    imu: Imu
    speed: float
    pose: Pose
    objects: Mapping[str, Row]
    radar: list[Row]
    route: Route
    stop_line: float

    @classmethod
    def of(cls, percept: Mapping[str, Any]) -> Snapshot:
        """The values of all channels that are numbers."""
        bodies, route_map = percept["lidar"], percept["map"]
        return cls(
            percept["imu"],
            percept["odometry"].speed,
            percept["localisation"],
            dict(zip(bodies.ids, bodies.data.tolist(), strict=True)),
            percept["radar"].tolist(),
            route_map.route,
            route_map.stop_line,
        )


def residuals(
    before: Snapshot, now: Snapshot, command: Command | None, dt: float
) -> Iterator[tuple[str, str, float]]:
    """Name, subject and value of each residual of a tick, where the subject is a channel or an id.

    Args:
        before: The tick before.
        now: This tick.
        command: What was commanded at the tick before; ``None`` if nothing was.
        dt: Seconds per tick.
    """
    for name, value in zip(EGO, ego_residuals(before, now, dt), strict=True):
        yield name, name.partition(".")[0], value
    if command is not None:
        yield "command", "command", command_residual(command, before, now, dt)
    for body, (x, y) in object_residuals(before, now, dt).items():
        yield "lidar.x", body, x
        yield "lidar.y", body, y
    for channel, stays in frozen(before, now).items():
        yield f"frozen.{channel}", channel, float(stays)


def ego_residuals(before: Snapshot, now: Snapshot, dt: float) -> tuple[float, float, float, float]:
    """Sensors against each other, from one tick to the next; infinite where they make no sense.

    Returns:
        ``odometry.speed``: gain of speed against the imu's acceleration, in m/s2;
        ``localisation.along`` and ``localisation.across``: displacement against odometry and
        model, ahead and to the right, in m/s;
        ``localisation.heading``: turn against the imu's yaw rate, in rad/s.
    """
    start, end, yaw_rate = before.pose, now.pose, now.imu.yaw_rate
    turned = end.heading - start.heading
    if not math.isfinite(turned):
        return math.inf, math.inf, math.inf, math.inf
    c, s = math.cos(start.heading), math.sin(start.heading)
    vx, vy = (end.x - start.x) / dt, (end.y - start.y) / dt
    slide = yaw_rate * _TO_REAR
    slow, fast = sorted((_ahead(before.speed, slide), _ahead(now.speed, slide)))
    return (
        (now.speed - before.speed) / dt - now.imu.acceleration,
        beyond(vx * c + vy * s, slow, fast),
        vy * c - vx * s - slide,
        math.remainder(turned, 2 * math.pi) / dt - yaw_rate,
    )


def command_residual(command: Command, before: Snapshot, now: Snapshot, dt: float) -> float:
    """The imu's acceleration against the one that was commanded a tick before, in m/s2.

    The actuator follows with a bounded slew rate, and below ``_LETS_OFF`` may let the brake off.
    """
    to_line = 0.0
    if command.acceleration is None and command.maneuver in (Maneuver.WAIT, Maneuver.YIELD):
        s, _ = before.route.project(before.pose.x, before.pose.y)
        to_line = before.stop_line - s - HALF
    limit = before.route.road.speed_limit
    commanded = acceleration_for(command, before.speed, to_line, limit)
    last, reach = before.imu.acceleration, ACTUATOR_SLEW * dt
    least = max(last - reach, min(last + reach, commanded))
    most = max(least, 0.0) if before.speed < _LETS_OFF else least
    return beyond(now.imu.acceleration, least, most)


def object_residuals(before: Snapshot, now: Snapshot, dt: float) -> dict[str, tuple[float, float]]:
    """Displacement of each object against its velocity, in x and y, in m/s, by id.

    Objects that were not there a tick before have none.
    """
    differences = {}
    for name, row in now.objects.items():
        old = before.objects.get(name)
        if old is not None:
            differences[name] = (row[0] - old[0]) / dt - old[VX], (row[1] - old[1]) / dt - old[VY]
    return differences


def frozen(before: Snapshot, now: Snapshot) -> dict[str, bool]:
    """Whether each channel repeats the values of a tick before, although others say they change.

    A speed that stays while the imu accelerates, a position that stays while the wheels turn, an
    object that stays while it moves, a range that stays while it has a rate.
    """
    rolls = abs(now.speed) > _MOVES
    return {
        "odometry": now.speed == before.speed and abs(now.imu.acceleration) > _MOVES,
        "localisation": rolls and now.pose[:2] == before.pose[:2],
        "lidar": any(
            abs(row[VX]) + abs(row[VY]) > _MOVES and row[:2] == before.objects.get(name, ())[:2]
            for name, row in now.objects.items()
        ),
        "radar": any(
            abs(row[2]) > _MOVES and row[0] == old[0]
            for old, row in zip(before.radar, now.radar, strict=False)
        ),
    }


def beyond(value: float, low: float, high: float) -> float:
    """Amount by which a value is above or below a range; 0 within it."""
    if low <= value <= high:
        return 0.0
    return value - high if value > high else value - low


def _ahead(speed: float, slide: float) -> float:
    """The part of a speed that goes ahead; the speed itself where no such part is possible."""
    rest = speed * speed - slide * slide
    return math.copysign(math.sqrt(rest), speed) if rest > 0.0 else speed


_ROUNDING = 1.0 - 1e-9
"""Tolerance, so that sums that reach the threshold exactly do not miss it by rounding."""


class Cusum:
    """Two-sided CUSUM test: it sees a small lasting shift of the mean sooner than single values do.

    E. S. Page, "Continuous inspection schemes", Biometrika 41 (1954), pp. 100-115: with the
    residual x, which has mean 0 as long as all is well, the drift k and the threshold h, ::

        upper = max(0, upper + x - k)        lower = max(0, lower - x - k)

    and an alarm as soon as one of the two reaches h. Both start at 0, and again after each alarm.

    Args:
        drift: k: the deviation of a sample that does not count; in the residual's unit, at least 0.
        threshold: h: the sum at which it alarms; in the residual's unit, above 0.

    Attributes:
        upper: Sum of the deviations upwards.
        lower: Sum of the deviations downwards.

    Raises:
        ValueError: For a drift or threshold out of range.

    A lasting shift by d > k alarms after at most ``ceil(h / (d - k))`` samples, and residuals
    within plus or minus k never do.
    """

    __slots__ = ("drift", "lower", "threshold", "upper")

    def __init__(self, drift: float, threshold: float) -> None:
        if not (0.0 <= drift < math.inf and threshold > 0.0):
            raise ValueError(
                f"drift must be at least 0 and threshold above it, not {drift:g} and {threshold:g}"
            )
        self.drift, self.threshold = float(drift), float(threshold)
        self.reset()

    def reset(self) -> None:
        """Set both sums to 0."""
        self.upper = self.lower = 0.0

    def update(self, residual: float) -> bool:
        """Add one sample; returns whether it alarms. A residual that is not finite does."""
        if not math.isfinite(residual):
            self.reset()
            return True
        self.upper = max(0.0, self.upper + residual - self.drift)
        self.lower = max(0.0, self.lower - residual - self.drift)
        if max(self.upper, self.lower) < self.threshold * _ROUNDING:
            return False
        self.reset()
        return True

    @property
    def level(self) -> float:
        """Greater sum as a share of the threshold: 0 is no deviation, 1 an alarm."""
        return max(self.upper, self.lower) / self.threshold


class Limits(NamedTuple):
    """Drift that a test forgives at each tick, and the sum at which it alarms, in its unit."""

    drift: float
    threshold: float


_STAYS = Limits(0.5, 1.0)
"""Two ticks in a row, or more often than every other tick."""
LIMITS: Mapping[str, Limits] = {
    "odometry.speed": Limits(0.25, 3.2),
    "localisation.along": Limits(0.2, 3.2),
    "localisation.across": Limits(0.2, 3.2),
    "localisation.heading": Limits(0.05, 0.085),
    "command": Limits(0.5, 5.5),
    "lidar.x": Limits(1.0, 2.4),
    "lidar.y": Limits(1.0, 2.4),
    "frozen.odometry": _STAYS,
    "frozen.localisation": _STAYS,
    "frozen.lidar": _STAYS,
    "frozen.radar": _STAYS,
}
"""The tests. Each drift is half of the smallest lasting shift that is worth an alarm: 0.5 m/s2 of
speed, 0.4 m/s of displacement, 0.1 rad/s of turning, 1 m/s2 of the command's effect, 2 m/s of an
object's displacement. The thresholds are what ``benchmarks/residual_limits.py`` found."""


class ResidualMonitor(SecurityAssessor):
    """Watches whether the sensors contradict each other and the ego's motion for long enough.

    One two-sided CUSUM test per residual of this module; an alarm is an alert
    with a pattern such as ``residual:odometry.speed``. It names the contradiction, not the culprit:
    a wrong speed contradicts the imu and the localisation alike. It is alerted when it begins, and
    again after a quiet time. An alert is a warning, and does not stop the component.

    Args:
        thresholds: By residual, drift and threshold in place of those of ``LIMITS``, in its unit.
        quiet: Seconds without an alarm after which a test's next one is alerted anew.

    Raises:
        ConfigurationError: For an unknown residual, and for numbers that cannot be.

    The score is 1 less how near the nearest test is to its alarm: 1 for not at all, 0 for an alarm.
    """

    name = "residual_monitor"
    reassess = False

    def __init__(
        self, thresholds: Mapping[str, Sequence[float]] = NOTHING, quiet: float = 1.0
    ) -> None:
        self.limits = {**LIMITS, **_checked(thresholds)}
        self.quiet = quiet

    @classmethod
    def check_params(
        cls,
        params: Mapping[str, Any],
        time_step: float,  # noqa: ARG003 - as Role has it
    ) -> None:
        """Refuse unknown residuals, and limits that are none."""
        _checked(params.get("thresholds", NOTHING))

    def reset(self, context: RoleContext) -> None:
        """Forget what was seen."""
        self._before: Snapshot | None = None
        self._tests: dict[tuple[str, str], Cusum] = {}
        self._seen: dict[tuple[str, str], float] = {}

    def run(self, view: RoleView) -> SecurityAssessment:
        """The alarms of this tick; none at the first one, where there is nothing to compare."""
        before, self._before = self._before, Snapshot.of(view.percept)
        if before is None:
            return _QUIET
        # What is out of sight is forgotten.
        earlier, self._tests = self._tests, {}
        alerts, reasons, nearest = [], [], 0.0
        for name, subject, residual in residuals(before, self._before, view.command, view.dt):
            key = name, subject
            test = self._tests[key] = earlier.get(key) or Cusum(*self.limits[name])
            if not test.update(residual):
                nearest = max(nearest, test.level)
                continue
            nearest = 1.0
            reasons.append(f"residual:{name} ({subject})")
            if view.time - self._seen.get(key, -math.inf) > self.quiet:
                detail = f"off by {residual:.2f} at last"
                alerts.append(Alert(f"residual:{name}", subject, detail))
            self._seen[key] = view.time
        return SecurityAssessment(
            verdict=Assessed.WARNING if reasons else Assessed.SAFE,
            score=1.0 - nearest,
            reasons=tuple(reasons),
            alerts=tuple(alerts),
        )


def _checked(thresholds: Mapping[str, Sequence[float]]) -> dict[str, Limits]:
    limits = {}
    for name, pair in thresholds.items():
        if name not in LIMITS:
            raise ConfigurationError(
                f"there is no residual {name!r}",
                key="thresholds",
                found=name,
                expected=", ".join(LIMITS),
                remedy="correct its name",
            )
        try:
            limits[name] = Limits(*pair)
            Cusum(*limits[name])
        except (TypeError, ValueError):
            raise ConfigurationError(
                f"these are no limits of {name!r}",
                key=f"thresholds.{name}",
                found=pair,
                expected="drift (at least 0) and threshold (above 0)",
                remedy=f"for example {list(LIMITS[name])}",
            ) from None
    return limits


_QUIET = SecurityAssessment(score=1.0)
