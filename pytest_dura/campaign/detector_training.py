"""Training of learned detectors: on fault-free episodes, with a threshold from others of them.

scikit-learn (extra ``learned``) fits; what is kept is plain numbers, see
:mod:`pytest_dura.core.anomaly`. The same call with the same packages gives the same model, digest
included: every draw comes from the seed.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from pytest_dura.core.anomaly_monitor import (
    KINDS,
    AnomalyModel,
    AnomalyMonitor,
    FeatureSource,
    Floats,
    average_depth,
    rounded_numbers,
)
from pytest_dura.core.errors import ConfigurationError, DuraError, did_you_mean
from pytest_dura.core.orchestrator import Orchestrator
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import Role
from pytest_dura.core.seeding import stream
from pytest_dura.core.state import RoleView
from pytest_dura.domains import ROLES, names_of_role, role_spec
from pytest_dura.library.cases import expand_cases
from pytest_dura.library.loading import load_library
from pytest_dura.provenance import describe_tool

TREES = 64
ROWS_PER_TREE = 256
"""As the paper on isolation forests suggests; more rows hide anomalies behind each other."""
_WINDOWS = {"isolation_forest": 1.0, "one_class_svm": 0.0}
"""s over which scores are averaged, by kind. A forest scores whatever is beyond all that it has
seen like its strangest normal row, however far beyond: an anomaly lasts longer."""
BORDER = 0.001
"""Nu of the one-class SVM: the share of rows that may lie beyond the border it learns."""
_SVM_ROWS = 20_000
"""Rows, drawn from all, that it learns from: its cost grows with their square."""
TAIL, NORMAL_TAIL = 0.999, 3.2905
"""Of so many rows no feature is farther off than this many scales, as of a normal distribution."""
_PACKAGES = ("scikit-learn", "numpy")


@dataclass(frozen=True)
class Training:
    """Episodes that a detector is trained on.

    Args:
        scenarios: Globs of scenario names; their faults are left out.
        generators: Components that drive, by short name or import path.
        runs: Episodes of each scenario and generator to learn from.
        held_out: Further ones, from which the threshold comes.
        seed: Base seed of all of them, and of all draws.
        draws: How many times each episode is seen, with the source's sensor noise drawn anew; 0
            for once, as the sensors report it.
        false_alarms: Ticks above the threshold that are accepted per simulated hour of the held-out
            episodes.
        paths: Directories with further scenario files.

    Raises:
        ConfigurationError: For numbers that cannot be.
    """

    scenarios: Sequence[str]
    generators: Sequence[str]
    runs: int = 10
    held_out: int = 10
    seed: int = 1
    draws: int = 20
    false_alarms: float = 1.0
    paths: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Refuse numbers that cannot be."""
        for name, least in (("runs", 1), ("held_out", 1), ("seed", 0), ("draws", 0)):
            if getattr(self, name) < least:
                raise _refuse_training(name, getattr(self, name), f"at least {least}")
        if not 0.0 < self.false_alarms < 36_000.0:
            raise _refuse_training(
                "false_alarms", self.false_alarms, "above 0 an hour, and not every tick"
            )


class Recorder(Role):
    """Keeps what a source of features reads, tick by tick."""

    name = "recorder"

    def __init__(self, source: FeatureSource) -> None:
        self.source = source
        self.samples: list[Any] = []

    def run(self, view: RoleView) -> None:
        """Keep this tick."""
        self.samples.append(self.source.observe(view))


def train(detector: str, training: Training) -> AnomalyModel:
    """Simulate, fit, and set the threshold.

    Args:
        detector: Short name of a learned detector, or ``package.module:Name`` of an
            :class:`AnomalyMonitor`.
        training: What it is trained on.

    Raises:
        ConfigurationError: For an unknown name, scenarios with several time steps, too few held-out
            episodes for the rate of false alarms, and if scikit-learn is not installed.
        DuraError: If an episode fails.
    """
    monitor = detector_class(detector)
    fit = FITS[monitor.kind]
    _module("sklearn")  # better missed before minutes of simulation than after
    source = monitor.source()
    tapes = list(_tapes(source, training))
    time_step = _time_step(tapes)
    rows = np.concatenate(_rows(source, [tape for tape in tapes if not tape.held_out], training))
    others = _rows(source, [tape for tape in tapes if tape.held_out], training)
    # Numbers that never differ in training, such as an object's size, would have no scale.
    spread = stream(training.seed, "dither").random(rows.shape) - 0.5
    dithered = rows + spread * np.array(source.resolutions)
    centre = rounded_numbers(dithered.mean(axis=0))
    off = np.abs(dithered - np.array(centre))
    # What is 0 but for rare ticks has a small deviation, and would be an anomaly at each of them.
    scale = rounded_numbers(
        np.maximum(dithered.std(axis=0), np.quantile(off, TAIL, axis=0) / NORMAL_TAIL)
    )
    parameters = fit((dithered - np.array(centre)) / np.array(scale), training.seed)
    plain = (monitor.kind, source.names, tuple(centre), tuple(scale), parameters)
    unset = AnomalyModel(*plain, threshold=1.0, window=1, time_step=time_step)
    window = max(1, round(_WINDOWS[monitor.kind] / time_step))
    scores = np.concatenate([_averaged(unset.scores(ticks), window) for ticks in others])
    hours = sum(map(len, others)) * time_step / 3600.0
    threshold = _threshold(scores, hours, training.false_alarms)
    record = {
        "tool": f"pytest-dura {describe_tool()['version']}",
        "packages": {name: version(name) for name in _PACKAGES},
        "scenarios": sorted({tape.scenario for tape in tapes}),
        "generators": list(training.generators),
        "seed": training.seed,
        "runs": [0, training.runs],
        "held_out_runs": [training.runs, training.runs + training.held_out],
        "noise_draws": training.draws,
        "noise": dict(source.noise) if training.draws else {},
        "rows": len(rows),
        "held_out_rows": sum(map(len, others)),
        "held_out_hours": rounded_numbers(hours),
        "false_alarms_per_hour": training.false_alarms,
        "data": _digest(rows, *others),
    }
    return AnomalyModel(*plain, threshold, window, time_step, record)


def detector_class(name: str) -> type[AnomalyMonitor]:
    """The learned detector of a short name or import path.

    Raises:
        ConfigurationError: If there is none.
    """
    short = {
        kind: known for kind, known in names_of_role("residual_monitor").items() if kind in KINDS
    }
    if ":" not in name and name not in short:
        raise ConfigurationError(
            f"there is no learned detector {name!r}",
            key="--detector",
            found=name,
            expected=", ".join(sorted(short)) + ", or an import path package.module:Class",
            remedy=did_you_mean(name, short),
        )
    detector = RoleSpec(ROLES.path(short[name]) if name in short else name).resolve()
    if not (
        inspect.isclass(detector) and issubclass(detector, AnomalyMonitor) and detector.kind in FITS
    ):
        raise ConfigurationError(
            f"{name} is no learned detector",
            key="--detector",
            found=name,
            expected="a subclass of pytest_dura.core.anomaly_monitor.AnomalyMonitor with a `kind`: "
            + ", ".join(FITS),
            remedy=f"for example {min(short)}",
        )
    return detector


@dataclass(frozen=True)
class _Tape:
    """Observations of an episode."""

    scenario: str
    name: str
    held_out: bool
    samples: list[Any]
    time_step: float


def _tapes(source: FeatureSource, training: Training) -> Iterator[_Tape]:
    library = load_library(training.paths)
    for case in expand_cases(library.scenarios, ["none"], training.scenarios):
        domain = case.scenario.system
        for generator in training.generators:
            component = role_spec("generator", RoleSpec(generator), domain)
            for run in range(training.runs + training.held_out):
                recorder = Recorder(source)
                roles = {"generator": component, "recorder": RoleSpec.of(recorder)}
                spec = case.spec(run, training.seed, roles)
                episode = Orchestrator.build(spec).run(spec)
                name = f"{case.scenario.name}/{generator}/{run}"
                if episode.failure is not None:
                    raise DuraError(f"the episode {name} failed: {episode.failure}")
                late = run >= training.runs
                yield _Tape(case.scenario.name, name, late, recorder.samples, spec.time_step)


def _time_step(tapes: Sequence[_Tape]) -> float:
    steps = sorted({tape.time_step for tape in tapes})
    if len(steps) != 1:
        raise ConfigurationError(
            "a detector is trained at one time step",
            key="--scenario",
            found=", ".join(f"{step:g} s" for step in steps),
            expected="scenarios with the same time_step",
            remedy="train a detector for each",
        )
    return steps[0]


def _rows(source: FeatureSource, tapes: Sequence[_Tape], training: Training) -> list[Floats]:
    """The features of all ticks, ``(ticks, features)`` for each time an episode is seen."""
    seen = []
    for tape in tapes:
        for draw in range(max(training.draws, 1)):
            source.reset()
            random = stream(training.seed, f"noise/{tape.name}/{draw}")
            rows = [
                source.update(source.disturbed(sample, random) if training.draws else sample)
                for sample in tape.samples
            ]
            seen.append(np.array([row for row in rows if row is not None]))
    return [rows for rows in seen if len(rows)]


def _averaged(scores: Floats, window: int) -> Floats:
    """Means of so many scores in a row, ``(len(scores) - window + 1,)``; none of too few."""
    sums = np.concatenate([[0.0], np.cumsum(scores)])
    means: Floats = (sums[window:] - sums[:-window]) / window
    return means


def _threshold(scores: Floats, hours: float, rate: float) -> float:
    """The score above which as many held-out ticks lie as are accepted."""
    accepted = int(rate * hours)
    if not 1 <= accepted < len(scores):
        raise ConfigurationError(
            f"{hours:.2f} h of held-out episodes cannot show {rate:g} false alarms an hour",
            key="--false-alarms",
            found=f"{rate:g} an hour",
            expected=f"at least {1.0 / hours:.3g} an hour, or {1.0 / rate:.3g} h",
            remedy="raise --held-out, --draws or --false-alarms",
        )
    return float(rounded_numbers(np.sort(scores)[-1 - accepted]))


def _fit_isolation_forest(rows: Floats, seed: int) -> Mapping[str, Any]:
    forest = _module("sklearn.ensemble").IsolationForest(
        n_estimators=TREES,
        max_samples=min(ROWS_PER_TREE, len(rows)),
        random_state=int(stream(seed, "isolation_forest").integers(2**31)),
    )
    forest.fit(rows)
    trees = [_preorder(estimator.tree_) for estimator in forest.estimators_]
    return {"sample": int(forest.max_samples_), "trees": trees}


def _preorder(tree: Any) -> list[list[Any]]:
    """The features (-1 for a leaf) and the values of a tree's nodes, as the model has them."""
    features: list[int] = []
    values: list[float] = []
    waiting = [(0, 0)]
    while waiting:
        node, depth = waiting.pop()
        if tree.children_left[node] < 0:
            features.append(-1)
            values.append(rounded_numbers(depth + average_depth(int(tree.n_node_samples[node]))))
        else:
            features.append(int(tree.feature[node]))
            values.append(rounded_numbers(tree.threshold[node]))
            waiting += [
                (int(tree.children_right[node]), depth + 1),
                (int(tree.children_left[node]), depth + 1),
            ]
    return [features, values]


def _fit_one_class_svm(rows: Floats, seed: int) -> Mapping[str, Any]:
    random = stream(seed, "one_class_svm")
    if len(rows) > _SVM_ROWS:
        rows = rows[np.sort(random.choice(len(rows), _SVM_ROWS, replace=False))]
    gamma = 1.0 / (rows.shape[1] * float(rows.var()))  # what scikit-learn calls "scale"
    machine = _module("sklearn.svm").OneClassSVM(nu=BORDER, gamma=gamma).fit(rows)
    weights = machine.dual_coef_[0]
    return {
        "gamma": rounded_numbers(gamma),
        "weights": rounded_numbers(weights / weights.sum()),
        "vectors": rounded_numbers(machine.support_vectors_),
    }


FITS: Mapping[str, Callable[[Floats, int], Mapping[str, Any]]] = {
    "isolation_forest": _fit_isolation_forest,
    "one_class_svm": _fit_one_class_svm,
}
"""From standardised rows and the seed to a model's parameters, by kind."""


def _module(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise ConfigurationError(
            f"to train a detector needs the package 'scikit-learn': {error}",
            remedy="pip install 'pytest-dura[learned]'",
        ) from None


def _digest(*rows: Floats) -> str:
    """SHA-256 of the features that were learned from, and held out."""
    state = hashlib.sha256()
    for row in rows:
        state.update(np.ascontiguousarray(row, dtype="<f8").tobytes())
    return state.hexdigest()


def _refuse_training(name: str, found: object, expected: str) -> ConfigurationError:
    key = "--" + name.replace("_", "-")
    return ConfigurationError(
        f"{key} is out of range", key=key, found=found, expected=expected, remedy="correct it"
    )


def describe_training(model: AnomalyModel, file: Path, digest: str) -> list[str]:
    """Lines that say what was trained, for people."""
    training = model.training
    rows = f"{training['rows']} rows to learn from, {training['held_out_rows']} held out"
    hours = training["held_out_hours"]
    rate = f"{training['false_alarms_per_hour']:g} ticks an hour of those held out"
    return [
        f"{model.kind}: {len(model.features)} features, {rows} ({hours:.2f} h)",
        f"threshold {model.threshold:g}, at {rate}",
        f"{file}: {file.stat().st_size} bytes, SHA-256 {digest}",
    ]
