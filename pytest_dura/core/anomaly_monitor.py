"""AnomalyMonitor: a SecurityAssessor that alarms where a learned model says so."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.anomaly import AnomalyModel
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.roles import (
    Alert,
    Assessed,
    RoleContext,
    SecurityAssessment,
    SecurityAssessor,
)
from pytest_dura.core.state import RoleView

Floats = NDArray[np.float64]


class FeatureSource(ABC):
    """Turns what a role sees into one row of numbers per tick, in training as in use.

    A feature's name begins with the channel that it is about: ``odometry.speed``.
    """

    names: ClassVar[tuple[str, ...]]
    """Of the features, in order."""
    resolutions: ClassVar[tuple[float, ...]]
    """By so much must a feature differ to mean anything, in its unit; above 0."""
    noise: ClassVar[Mapping[str, float]]
    """Standard deviations of the sensor noise of :meth:`disturbed`, by what they are of."""

    @abstractmethod
    def observe(self, view: RoleView) -> Any:
        """All that is read of a tick, which :meth:`update` takes."""

    @abstractmethod
    def disturbed(self, sample: Any, random: np.random.Generator) -> Any:
        """The same observation from sensors with noise."""

    @abstractmethod
    def reset(self) -> None:
        """Forget what was seen."""

    @abstractmethod
    def update(self, sample: Any) -> Floats | None:
        """Take in a tick's observation; its features, ``(names,)``, or ``None`` if there are none.

        There are none at the first tick, where changes are features.
        """


class AnomalyMonitor(SecurityAssessor):
    """Alarms at a tick whose features score above the threshold of a model.

    An alarm is an alert with the pattern ``anomaly:<feature>``, of the feature that is farthest
    from what it was in training, and that feature's channel as its subject. It is alerted when it
    begins, and again after a quiet time. An alert is a warning, and stops nobody.

    Derive a class for a domain: ``kind``, :meth:`source`, and ``shipped`` if a model comes with it.

    Args:
        model: A file that ``python -m pytest_dura train-detector`` wrote, relative to where the
            session was started; the shipped model if there is none.
        digest: SHA-256 that the model states. It is filled in before an episode runs, so that
            specs, the evidence and the addresses of kept episodes depend on the model; a file that
            has changed since is refused.
        quiet: Seconds without an alarm after which the next one is alerted anew.

    Raises:
        ConfigurationError: If the model cannot be read, was changed, or is of another kind or of
            other features.

    A model that averages scores over a window says nothing until that is full.

    The score is how far below the threshold the model's score is, as a part of the threshold: above
    0 for no alarm, below 0 for one.
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
        """A fresh source of the features that models of this class score."""

    @classmethod
    def model_of(cls, model: str | None = None, digest: str | None = None) -> AnomalyModel:
        """The model in a file, or the shipped one.

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
        found = AnomalyModel.read(file, digest)
        names = cls.source().names
        for key, own, meant in (
            ("kind", found.kind, cls.kind),
            ("features", found.features, names),
        ):
            if own != meant:
                raise ConfigurationError(
                    f"{cls.__name__} cannot use this model: its {key} are others",
                    file=str(file),
                    key="model",
                    found=own,
                    expected=str(meant),
                    remedy="train one for it with: python -m pytest_dura train-detector",
                )
        return found

    @classmethod
    def check_params(cls, params: Mapping[str, Any], time_step: float) -> None:
        """Refuse a model that cannot be used, and one that was trained at another time step."""
        _check_time_step(cls.model_of(params.get("model"), params.get("digest")), time_step)

    @classmethod
    def settled(cls, params: Mapping[str, Any]) -> Mapping[str, Any]:
        """The parameters with the model's digest."""
        return {**params, "digest": cls.model_of(params.get("model"), params.get("digest")).digest}

    def reset(self, context: RoleContext) -> None:
        """Forget what was seen."""
        _check_time_step(self.model, context.dt)
        self._source.reset()
        self._scores: deque[float] = deque(maxlen=self.model.window)
        self._seen = -math.inf

    def run(self, view: RoleView) -> SecurityAssessment:
        """The alarm of this tick; none while there are no features."""
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
        name = model.strangest(features)
        alerts: tuple[Alert, ...] = ()
        if view.time - self._seen > self.quiet:
            detail = f"{self.kind} scores {score:.3g}, above {model.threshold:.3g}"
            alerts = (Alert(f"anomaly:{name}", name.partition(".")[0], detail),)
        self._seen = view.time
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
