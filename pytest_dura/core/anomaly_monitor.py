"""Anomaly detection: CUSUM, learned models as data, and the monitor that alarms by them.

CUSUM sees a small lasting shift of a residual's mean sooner than any single value does. E. S. Page,
"Continuous inspection schemes", Biometrika 41 (1954), pp. 100-115: with the residual x, which has
mean 0 as long as all is well, the drift k and the threshold h, ::

    upper = max(0, upper + x - k)        lower = max(0, lower - x - k)

and an alarm as soon as one of the two reaches h. Both start at 0, and again after each alarm. Half
the smallest shift worth an alarm is the usual k; h is set by the false alarms that are acceptable.

An :class:`AnomalyModel` holds the learned numbers of a detector, in a file with a digest.
scikit-learn fits it (see ``pytest_dura.campaign.detector_training``); the fit is kept as JSON and
evaluated here with NumPy, so that a monitor needs no scikit-learn, and a file from a stranger can
do no more than score badly: nothing in it is called. Two kinds:

``isolation_forest``
    How few random splits isolate a row. F. T. Liu, K. M. Ting, Z.-H. Zhou, "Isolation Forest",
    ICDM 2008, pp. 413-422: with the mean depth E[h] over the trees, each grown on psi rows, ::

        score = 2 ** (-E[h] / c(psi))        c(n) = 2 (ln(n - 1) + 0.5772) - 2 (n - 1) / n

    from 0 to 1; the greater, the more anomalous.
``one_class_svm``
    How unlike a row is to those at the border of the training data. B. Schoelkopf and others,
    "Estimating the support of a high-dimensional distribution", Neural Computation 13 (2001),
    pp. 1443-1471: with the support vectors x_i and their weights a_i, which sum to 1, ::

        score = -ln(sum(a_i * exp(-gamma * |x - x_i|**2)))

    at least 0. The sum is the paper's decision function but for a constant; its logarithm puts rows
    in the same order, and still tells those apart that are far from all.

Both score rows that were standardised: less the mean of each feature, divided by its scale.
"""

from __future__ import annotations

import hashlib
import json
import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.files import replace_file
from pytest_dura.core.roles import Assessed, RoleContext, SecurityAssessment, SecurityAssessor
from pytest_dura.core.state import Alert, RoleView

_ROUNDING = 1.0 - 1e-9
"""Tolerance, so that sums that reach the threshold exactly do not miss it by rounding."""


class Cusum:
    """Two-sided CUSUM test.

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


Floats = NDArray[np.float64]
Scorer = Callable[[Floats], Floats]
"""Maps standardised rows, ``(n, features)``, to their scores, ``(n,)``."""

FORMAT = "pytest-dura anomaly model"
VERSION = 1
LARGEST = 8_000_000
"""Greatest size of a file, in bytes; a forest of 64 trees takes some 100,000."""
LONGEST = 1000
"""Scores that are averaged at most."""
_STANDARDISED_LIMIT = 1e6
"""Standardised values are clipped here, so that their squares stay finite."""
_DIGITS = 7
"""Significant digits that are kept of a fitted number."""
_BATCH = 4096
"""Rows that are scored at once, which bounds the memory."""


@dataclass(frozen=True)
class AnomalyModel:
    """Fitted detector: scores rows of features, and has a threshold for alarms.

    Args:
        kind: A key of :data:`KINDS`.
        features: Names of the columns, in order.
        centre: Mean of each feature in training, in its unit; shape ``(features,)``.
        scale: Usual deviation from the mean, above 0, in its unit; shape ``(features,)``.
        parameters: Plain data of the kind.
        threshold: Scores above it are alarms; above 0.
        window: Number of consecutive scores whose mean is compared with the threshold.
        time_step: Seconds between two rows; features of changes depend on it.
        training: Plain data on its origin: scenarios, seeds, versions, rates.

    Raises:
        ValueError: If the numbers do not fit together.
    """

    kind: str
    features: tuple[str, ...]
    centre: tuple[float, ...]
    scale: tuple[float, ...]
    parameters: Mapping[str, Any]
    threshold: float
    window: int
    time_step: float
    training: Mapping[str, Any] = field(default_factory=dict)
    _centre: Floats = field(init=False, repr=False, compare=False)
    _scale: Floats = field(init=False, repr=False, compare=False)
    _scorer: Scorer = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the numbers, and prepare to score."""
        width = len(self.features)
        if self.kind not in KINDS:
            raise ValueError(f"kind {self.kind!r} is none of {', '.join(KINDS)}")
        if not width or len(set(self.features)) < width:
            raise ValueError("there must be features, each with a name of its own")
        centre, scale = _numbers(self.centre, (width,)), _numbers(self.scale, (width,))
        if not (scale > 0.0).all():
            raise ValueError("every scale must be above 0")
        for name in ("threshold", "time_step"):
            if not 0.0 < float(getattr(self, name)) < math.inf:
                raise ValueError(f"{name} must be above 0")
        if type(self.window) is not int or not 1 <= self.window <= LONGEST:
            raise ValueError(f"window must be a whole number from 1 to {LONGEST}")
        object.__setattr__(self, "_centre", centre)
        object.__setattr__(self, "_scale", scale)
        object.__setattr__(self, "_scorer", KINDS[self.kind](self.parameters, width))

    @property
    def digest(self) -> str:
        """SHA-256 of :meth:`to_json`, in hexadecimal digits."""
        return _digest(self.to_json())

    def standardised(self, rows: Floats) -> Floats:
        """Standardise rows: in scales from the mean; NaN becomes the greatest value."""
        limit = _STANDARDISED_LIMIT
        clipped: Floats = ((rows - self._centre) / self._scale).clip(-limit, limit)
        return np.nan_to_num(clipped, nan=limit)

    def scores(self, rows: Floats) -> Floats:
        """Score each row of ``(n, features)``; the greater, the more anomalous."""
        off = self.standardised(rows)
        if len(off) <= _BATCH:
            return self._scorer(off)
        parts = [self._scorer(off[at : at + _BATCH]) for at in range(0, len(off), _BATCH)]
        return np.concatenate(parts)

    def farthest_feature(self, row: Floats) -> str:
        """Name of the feature that is farthest from its mean, in scales."""
        return self.features[int(np.abs(self.standardised(row)).argmax())]

    def to_json(self) -> dict[str, Any]:
        """Plain data; equal models have equal data."""
        return {
            "kind": self.kind,
            "features": list(self.features),
            "centre": list(self.centre),
            "scale": list(self.scale),
            "parameters": dict(self.parameters),
            "threshold": self.threshold,
            "window": self.window,
            "time_step": self.time_step,
            "training": dict(self.training),
        }

    def write(self, file: Path) -> str:
        """Write the model atomically; returns its digest.

        Raises:
            OSError: If it cannot be written.
        """
        plain = self.to_json()
        digest = _digest(plain)
        whole = {"format": FORMAT, "version": VERSION, "sha256": digest, "model": plain}
        replace_file(file, [json.dumps(whole, allow_nan=False, separators=(",", ":")), "\n"],
                     durable=False)  # fmt: skip
        return digest

    @classmethod
    def read(cls, file: Path, digest: str | None = None) -> AnomalyModel:
        """Read the model in a file; a file that has not changed is parsed once.

        Args:
            file: A file of :meth:`write`.
            digest: Digest of the expected model; ``None`` accepts any.

        Raises:
            ConfigurationError: If the file has no model, was changed, or has another model.
        """
        try:
            stat = file.stat()
            if not file.is_file() or stat.st_size > LARGEST:
                raise ConfigurationError(
                    "this is no model of a detector",
                    file=str(file),
                    found="no regular file" if not file.is_file() else f"{stat.st_size} bytes",
                    expected=f"a file of at most {LARGEST} bytes",
                    remedy=_REMEDY,
                )
            model, own = _read(file, stat.st_size, stat.st_mtime_ns)
        except OSError as error:
            raise ConfigurationError(
                f"the model of a detector cannot be read: {error.strerror}",
                file=str(file),
                key="model",
                remedy=_REMEDY,
            ) from None
        if digest is not None and digest != own:
            raise ConfigurationError(
                "this is not the model of the detector that is meant",
                file=str(file),
                key="digest",
                found=own,
                expected=digest,
                remedy="bring that model back, or run the session anew with this one",
            )
        return model


_REMEDY = "write one with: python -m pytest_dura train-detector"


@lru_cache(maxsize=16)
def _read(file: Path, _size: int, _changed: int) -> tuple[AnomalyModel, str]:
    def refused(problem: str, found: object = None, expected: str | None = None) -> Exception:
        return ConfigurationError(
            problem, file=str(file), found=found, expected=expected, remedy=_REMEDY
        )

    with file.open("rb") as stream:
        content = stream.read(LARGEST + 1)
    try:
        whole = json.loads(content)
    except (ValueError, RecursionError):
        raise refused("this is no model of a detector", expected="a file of JSON") from None
    if not isinstance(whole, dict) or whole.get("format") != FORMAT:
        raise refused("this is no model of a detector", expected=f"JSON with format {FORMAT!r}")
    if whole.get("version") != VERSION:
        raise refused(
            "this model of a detector has another version", whole.get("version"), str(VERSION)
        )
    plain = whole.get("model")
    try:
        digest = _digest(plain)
    except (ValueError, RecursionError):  # NaN, which JSON does not have but Python reads
        raise refused("this model of a detector holds what is no number") from None
    if whole.get("sha256") != digest:
        raise refused(
            "this model of a detector was changed after it was written",
            f"content with the SHA-256 {digest}",
            f"the one that it states: {whole.get('sha256')}",
        )
    try:
        model = _built(plain)
    except KeyError as error:
        raise refused("this model of a detector is not whole", f"no {error}") from None
    except (ValueError, TypeError, OverflowError) as error:
        raise refused(f"this model of a detector cannot be used: {error}") from None
    return model, digest


def _built(plain: Any) -> AnomalyModel:
    kind, features = plain["kind"], plain["features"]
    if not all(isinstance(name, str) for name in (kind, *features)):
        raise ValueError("kind and features must be texts")
    return AnomalyModel(
        kind=kind,
        features=tuple(features),
        centre=tuple(map(float, plain["centre"])),
        scale=tuple(map(float, plain["scale"])),
        parameters=dict(plain["parameters"]),
        threshold=float(plain["threshold"]),
        window=plain["window"],
        time_step=float(plain["time_step"]),
        training=dict(plain["training"]),
    )


def _digest(plain: Any) -> str:
    text = json.dumps(plain, allow_nan=False, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def rounded_numbers(values: Any) -> Any:
    """Round fitted numbers to seven significant digits, as (nested) lists.

    So the file does not depend on the order in which a library adds.
    """
    if isinstance(values, (list, tuple, np.ndarray)):
        return [rounded_numbers(value) for value in values]
    return float(f"{float(values):.{_DIGITS}g}")


def _numbers(values: Any, shape: tuple[int, ...]) -> Floats:
    array = np.array(values, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"expected finite numbers of shape {shape}, found shape {array.shape}")
    return array


def average_depth(rows: float) -> float:
    """Mean depth of an unsuccessful search in a random tree of so many rows: c(n)."""
    if rows <= 1:
        return 0.0
    if rows == 2:
        return 1.0
    return 2.0 * (math.log(rows - 1.0) + float(np.euler_gamma)) - 2.0 * (rows - 1.0) / rows


def _one_class_svm(parameters: Mapping[str, Any], width: int) -> Scorer:
    """From ``vectors``, ``(n, features)``, their ``weights``, ``(n,)``, and ``gamma``."""
    weights = _numbers(parameters["weights"], (len(parameters["weights"]),))
    vectors = _numbers(parameters["vectors"], (len(weights), width))
    gamma = float(parameters["gamma"])
    if not (len(weights) and (weights > 0.0).all() and 0.0 < gamma < math.inf):
        raise ValueError("support vectors need weights and a gamma above 0")
    logarithms, lengths = np.log(weights / weights.sum()), np.einsum("ij,ij->i", vectors, vectors)

    def score(rows: Floats) -> Floats:
        squares = np.einsum("ij,ij->i", rows, rows)[:, None] + lengths - 2.0 * (rows @ vectors.T)
        exponents = logarithms - gamma * np.maximum(squares, 0.0)
        greatest = exponents.max(axis=1)
        scored: Floats = -greatest - np.log(np.exp(exponents - greatest[:, None]).sum(axis=1))
        return np.maximum(scored, 0.0)

    return score


def _isolation_forest(parameters: Mapping[str, Any], width: int) -> Scorer:
    """From ``sample`` (rows per tree) and ``trees``, each a pair of lists over its nodes.

    Nodes are in preorder: a split, all on its lower side, all on its upper side. The first list
    holds the feature of a split, or -1 for a leaf; the second the value up to which rows go to the
    lower side, or the depth that a leaf stands for.
    """
    trees, sample = parameters["trees"], float(parameters["sample"])
    if not trees or not 2 <= sample < math.inf:
        raise ValueError("a forest needs trees of at least 2 rows each")
    feature: list[int] = []
    value: list[float] = []
    children: list[tuple[int, int]] = []
    roots, deepest = [], 0
    for features, values in trees:
        roots.append(len(feature))
        links, depth = _links(features, width, len(feature))
        if len(values) != len(features):
            raise ValueError("a tree needs a value for each of its nodes")
        feature += features
        value += values
        children += links
        deepest = max(deepest, depth)
    numbers = _numbers(value, (len(feature),))
    split = np.array(feature, dtype=np.intp)
    leaf = split < 0
    column = np.where(leaf, 0, split)
    child = np.array(children, dtype=np.intp).ravel()
    start, each = np.array(roots, dtype=np.intp), average_depth(sample) * len(roots)

    def score(rows: Floats) -> Floats:
        node = np.broadcast_to(start, (len(rows), len(start)))
        flat, row = rows.ravel(), (np.arange(len(rows)) * width)[:, None]
        for _ in range(deepest):  # a leaf leads to itself, on either side
            upper = flat.take(column.take(node) + row) > numbers.take(node)
            node = child.take(2 * node + upper)
        scored: Floats = 2.0 ** (-numbers.take(node).sum(axis=1) / each)
        return scored

    return score


def _links(features: Sequence[int], width: int, first: int) -> tuple[list[tuple[int, int]], int]:
    """Children of each node of a tree in preorder, and the depth of the deepest leaf."""
    links: list[tuple[int, int]] = []
    waiting: list[tuple[int, int]] = [(-1, 0)]  # (the split whose side is to come, its depth)
    deepest = 0
    for number, feature in enumerate(features):
        if not waiting or type(feature) is not int or not -1 <= feature < width:
            raise ValueError("a tree's nodes do not fit together")
        above, depth = waiting.pop()
        node = first + number
        if above >= 0 and links[above][1] < 0:
            lower = links[above][0]
            links[above] = (node, -1) if lower < 0 else (lower, node)
        deepest = max(deepest, depth)
        if feature < 0:
            links.append((node, node))
        else:
            links.append((-1, -1))
            waiting += [(number, depth + 1), (number, depth + 1)]
    if waiting:
        raise ValueError("a tree ends before all of its nodes are there")
    return links, deepest


KINDS: Mapping[str, Callable[[Mapping[str, Any], int], Scorer]] = {
    "isolation_forest": _isolation_forest,
    "one_class_svm": _one_class_svm,
}
"""Makes a scorer from parameters and the number of features, by kind."""


class FeatureSource(ABC):
    """Source of one row of features per tick from the view of a role, in training as in use.

    A feature's name begins with its channel: ``odometry.speed``.
    """

    names: ClassVar[tuple[str, ...]]
    """Names of the features, in order."""
    resolutions: ClassVar[tuple[float, ...]]
    """Smallest significant difference of each feature, in its unit; above 0."""
    noise: ClassVar[Mapping[str, float]]
    """Standard deviations of the sensor noise of :meth:`disturbed`, by quantity."""

    @abstractmethod
    def observe(self, view: RoleView) -> Any:
        """Read the sample of a tick, which :meth:`update` takes."""

    @abstractmethod
    def disturbed(self, sample: Any, random: np.random.Generator) -> Any:
        """Return the sample as sensors with noise give it."""

    @abstractmethod
    def reset(self) -> None:
        """Forget all samples."""

    @abstractmethod
    def update(self, sample: Any) -> Floats | None:
        """Add a tick's sample; returns its features, ``(names,)``, or ``None`` if there are none.

        There are none at the first tick if features are changes.
        """


class AnomalyMonitor(SecurityAssessor):
    """Monitor that alarms at a tick whose features score above the threshold of a model.

    An alarm is an alert with the pattern ``anomaly:<feature>``, of the feature that is farthest
    from its mean in training, and that feature's channel as its subject. It is alerted when it
    begins, and again after a quiet time. An alert is a warning, and stops no action.

    Derive a class for a domain: ``kind``, :meth:`source`, and ``shipped`` if a model comes with it.

    Args:
        model: A file that ``python -m pytest_dura train-detector`` wrote, relative to where the
            session was started; the shipped model if there is none.
        digest: SHA-256 of the model. It is filled in before an episode runs, so that
            specs, the evidence and the addresses of kept episodes depend on the model; a file that
            has changed since is refused.
        quiet: Seconds without an alarm after which the next one is alerted anew.

    Raises:
        ConfigurationError: If the model cannot be read, was changed, or is of another kind or of
            other features.

    A model that averages scores over a window gives no alarm until that is full.

    The assessment's score is the distance of the model's score below the threshold, as a part of
    the threshold: above 0 for no alarm, below 0 for one.
    """

    reassess = False
    kind: ClassVar[str] = ""
    shipped: ClassVar[Path | None] = None

    def __init__(
        self, model: str | None = None, digest: str | None = None, quiet: float = 1.0
    ) -> None:
        self.model = self.model_of(model, digest)
        self.quiet = quiet
        self._source = self.source()

    @classmethod
    @abstractmethod
    def source(cls) -> FeatureSource:
        """Make a fresh source of the features that models of this class score."""

    @classmethod
    def model_of(cls, model: str | None = None, digest: str | None = None) -> AnomalyModel:
        """Read the model in a file, or the shipped one.

        Raises:
            ConfigurationError: See the class.
        """
        file = cls.shipped if model is None else Path(model)
        if file is None:
            raise ConfigurationError(
                f"{cls.__name__} has no model",
                key="model",
                expected="the file of a model",
                remedy="train one with: python -m pytest_dura train-detector",
            )
        trained = AnomalyModel.read(file, digest)
        names = cls.source().names
        for key, own, expected in (
            ("kind", trained.kind, cls.kind),
            ("features", trained.features, names),
        ):
            if own != expected:
                raise ConfigurationError(
                    f"{cls.__name__} cannot use this model: its {key} are others",
                    file=str(file),
                    key="model",
                    found=own,
                    expected=str(expected),
                    remedy="train one for it with: python -m pytest_dura train-detector",
                )
        return trained

    @classmethod
    def check_params(cls, params: Mapping[str, Any], time_step: float) -> None:
        """Refuse a model that cannot be used, and one that was trained at another time step."""
        _check_time_step(cls.model_of(params.get("model"), params.get("digest")), time_step)

    @classmethod
    def resolve_parameters(cls, params: Mapping[str, Any]) -> Mapping[str, Any]:
        """Add the digest of the model."""
        return {**params, "digest": cls.model_of(params.get("model"), params.get("digest")).digest}

    def reset(self, context: RoleContext) -> None:
        """Forget the scores of the previous episode."""
        _check_time_step(self.model, context.dt)
        self._source.reset()
        self._scores: deque[float] = deque(maxlen=self.model.window)
        self._last_alarm = -math.inf

    def run(self, view: RoleView) -> SecurityAssessment:
        """Score this tick; no alarm while there are no features."""
        features = self._source.update(self._source.observe(view))
        if features is None:
            return _QUIET
        model = self.model
        self._scores.append(float(model.scores(features[None])[0]))
        if len(self._scores) < model.window:
            return _QUIET
        score = sum(self._scores) / model.window
        margin = 1.0 - score / model.threshold
        if score <= model.threshold:
            return SecurityAssessment(score=margin)
        name = model.farthest_feature(features)
        alerts: tuple[Alert, ...] = ()
        if view.time - self._last_alarm > self.quiet:
            detail = f"{self.kind} scores {score:.3g}, above {model.threshold:.3g}"
            alerts = (Alert(f"anomaly:{name}", name.partition(".")[0], detail),)
        self._last_alarm = view.time
        reasons = (f"anomaly:{name} ({self.kind})",)
        return SecurityAssessment(Assessed.WARNING, margin, reasons, alerts=alerts)


def _check_time_step(model: AnomalyModel, time_step: float) -> None:
    if not math.isclose(model.time_step, time_step, rel_tol=1e-9):
        raise ConfigurationError(
            "the model of a detector was trained at another time step",
            key="model",
            found=f"{model.time_step:g} s",
            expected=f"{time_step:g} s",
            remedy="train one on scenarios with this time step",
        )


_QUIET = SecurityAssessment(score=1.0)
