"""Learned monitors: features, alarms, models that are recorded and refused, and their training."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from roads import SCENARIOS, SIX, Views, car, channels_of, run, spec_of_drive, truth_of

from pytest_dura.__main__ import main
from pytest_dura.campaign import Training, train
from pytest_dura.campaign.detector_training import detector_class
from pytest_dura.core import (
    AnomalyModel,
    Assessed,
    ConfigurationError,
    RoleContext,
    RoleSpec,
    check_role,
)
from pytest_dura.domains import DOMAINS
from pytest_dura.driving import BodyList, HighwaySimulator
from pytest_dura.driving.roles.learned import (
    CAP,
    DrivingFeatures,
    IsolationForestMonitor,
    OneClassSvmMonitor,
)
from pytest_dura.execution import Addresses, EpisodeTask
from pytest_dura.library import ParameterResolver, expand_cases, load_library, load_scenarios

KINDS = ["isolation_forest", "one_class_svm"]
BUSY = {
    "ego": {"distance": 30.0, "speed": 6.0, "turn": "left"},
    "traffic": {
        "headway": 5.0,
        "turns": {"left": 1.0, "straight": 0.01, "right": 1.0},
        "arms": ["west", "north", "east"],
    },
}
SMALL = ["--scenario", "intersection/nominal", "--generator", "rule_based", "--runs", "1"]
SMALL += ["--held-out", "1", "--draws", "2", "--false-alarms", "2000", "--seed", "5"]


def spec_of(kind: str, **params: Any) -> RoleSpec:
    return RoleSpec(DOMAINS["driving"].short_names["residual_monitor"][kind], params)


def features(*percepts: Any) -> dict[str, float]:
    """Of the last of these."""
    source, views = DrivingFeatures(), Views()
    rows = [source.update(source.observe(views.role(one))) for one in percepts]
    assert rows[0] is None
    return dict(zip(source.names, rows[-1].tolist(), strict=True))


def cruise(ticks: int, *bodies: Any, speed: float = 8.0) -> list[dict[str, Any]]:
    return [channels_of(*bodies, s=50.0 + tick * speed * 0.1, speed=speed) for tick in range(ticks)]


def faster(percept: dict[str, Any], by: float) -> dict[str, Any]:
    odometry = percept["odometry"]
    return {**percept, "odometry": odometry._replace(speed=odometry.speed + by)}


def test_features_are_zero_while_all_is_well() -> None:
    parked = car("V1", 20.0, 2.0)
    assert all(abs(value) < 1e-9 for value in features(*cruise(3, parked)).values())


def test_what_a_wrong_speed_does_to_features() -> None:
    first, second = cruise(2)
    left = features(first, faster(second, 1.0))
    assert left["odometry.speed"] == pytest.approx(10.0)
    assert left["odometry.speed.mean"] == pytest.approx(10.0 * (1.0 - math.exp(-0.1)))


@pytest.mark.parametrize(
    "before, now, name, value",
    [
        ([], [car("V1", 0.0, 2.0)], "lidar.newcomer", None),
        ([car("V1", 0.0, 2.0)], [], "lidar.vanished", None),
        ([car("V1", 0.0, 2.0)], [car("V1", 1.0, 2.0)], "lidar.displacement", 10.0),
    ],
)
def test_what_objects_do_to_features(before, now, name, value) -> None:
    left = features(channels_of(*before), channels_of(*now))
    assert left[name] == pytest.approx(value) if value else left[name] > 10.0
    lidar = {one for one in left if one.startswith("lidar.") and abs(left[one]) > 1e-9}
    assert lidar == {name}


def test_a_size_that_changes_is_a_feature() -> None:
    body = car("V1", 0.0, 2.0)
    small = body._replace(length=body.length - 4.0, width=body.width - 1.0)
    left = features(channels_of(body), channels_of(small))
    assert left["lidar.size"] == pytest.approx(5.0)


def test_lidar_against_radar() -> None:
    both, alone = channels_of(car("V1", 0.0, 2.0)), channels_of()
    ghost = {**alone, "lidar": both["lidar"]}
    left = features(ghost, ghost)
    assert (left["radar.unconfirmed"], left["radar.unexplained"]) == (10.0, 0.0)
    missed = {**both, "lidar": BodyList.of([])}
    left = features(missed, missed)
    assert (left["radar.unconfirmed"], left["radar.unexplained"]) == (0.0, 10.0)
    faster_than_radar = {**both, "lidar": BodyList.of([car("V1", 0.0, 2.0, math.pi / 2, 5.0)])}
    assert features(both, faster_than_radar)["radar.rate"] > 1.0
    swapped = channels_of(car("V1", 0.0, 2.0), car("V2", 0.0, 20.0))
    swapped = {**swapped, "radar": swapped["radar"][::-1]}
    left = features(swapped, swapped)
    assert max(left[f"radar.{one}"] for one in ("unconfirmed", "unexplained", "rate")) < 1e-9


@pytest.mark.parametrize("absurd", [1e300, -1e300, math.inf, -math.inf, math.nan])
@pytest.mark.parametrize("channel", ["odometry", "localisation", "imu"])
@pytest.mark.parametrize("kind", KINDS)
def test_absurd_values_break_nothing(kind, channel, absurd) -> None:
    monitor, views = detector_class(kind)(), Views()
    monitor.reset(RoleContext(1, 0.1))
    for tick, percept in enumerate(cruise(4, car("V1", 20.0, 2.0))):
        if tick == 2:
            value = percept[channel]
            changed = value._replace(**dict.fromkeys(value._fields, absurd))
            percept = {**percept, channel: changed}  # noqa: PLW2901 - what the fault makes of it
        output = monitor.run(views.role(percept, "wait"))
        assert math.isfinite(output.score)
    assert max(map(abs, features(*cruise(2)).values())) <= CAP


@pytest.mark.parametrize("kind", KINDS)
def test_it_keeps_the_contract_of_a_role(kind) -> None:
    check_role(
        detector_class(kind),
        simulator=HighwaySimulator,
        scenario={"world": BUSY},
        context=RoleContext(1, 0.1, {"world": BUSY}),
        ticks=20,
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_lasting_fault_is_alerted_once_with_feature_and_channel(kind) -> None:
    monitor, views = detector_class(kind)(), Views()
    monitor.reset(RoleContext(1, 0.1))
    seen = []
    for tick, percept in enumerate(cruise(40)):
        seen.append(monitor.run(views.role(faster(percept, 20.0 if tick >= 15 else 0.0))))
    assert all(one.verdict is Assessed.SAFE and one.score > 0.0 for one in seen[:15])
    alerts = [alert for one in seen for alert in one.alerts]
    assert len(alerts) == 1
    assert alerts[0].pattern.startswith("anomaly:")
    assert alerts[0].subject == alerts[0].pattern.removeprefix("anomaly:").partition(".")[0]
    assert kind in alerts[0].detail
    assert seen[-1].verdict is Assessed.WARNING
    assert seen[-1].score < 0.0
    monitor.reset(RoleContext(1, 0.1))
    assert not monitor.run(Views().role(faster(cruise(1)[0], 5.0))).alerts


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SIX)
def test_no_false_alarms_in_clean_episodes(kind, name) -> None:
    (case,) = expand_cases([load_scenarios([SCENARIOS / "intersection"])[name]], ["none"])
    episode = run(case.spec(0, 2024, {"residual_monitor": RoleSpec(kind)}))
    assert episode.failure is None
    assert episode.metrics.alert_ticks["residual_monitor"] == []


def test_it_changes_no_decision() -> None:
    fault = {"type": "gnss-jump", "activation": {"at": 1.0}, "parameters": {"along": -5.0}}
    arms = [
        run(spec_of_drive(BUSY, generator="rule_based", faults=[fault], policy="recover", roles=r))
        for r in ({}, {"residual_monitor": spec_of("one_class_svm")})
    ]
    assert arms[1].metrics.alert_ticks["residual_monitor"]
    assert truth_of(arms[0]) == truth_of(arms[1])
    for column in ("proposed", "executed", "source"):
        assert np.array_equal(arms[0].decisions[column], arms[1].decisions[column])


@pytest.fixture(scope="module")
def forest(tmp_path_factory) -> Path:
    """A model that the command trained on next to nothing."""
    pytest.importorskip("sklearn", reason="the extra `learned` is not installed")
    file = tmp_path_factory.mktemp("models") / "forest.json"
    assert main(["train-detector", "--detector", KINDS[0], "--output", str(file), *SMALL]) == 0
    return file


def test_the_command_says_what_it_trained(tmp_path, capsys) -> None:
    pytest.importorskip("sklearn", reason="the extra `learned` is not installed")
    file = tmp_path / "new" / "svm.json"
    assert main(["train-detector", "--detector", KINDS[1], "--output", str(file), *SMALL]) == 0
    first, second, third = capsys.readouterr().out.splitlines()
    assert "17 features" in first
    assert "at 2000 ticks an hour" in second
    model = AnomalyModel.read(file)
    assert model.digest in third
    told = model.training
    assert (told["scenarios"], told["generators"]) == (["intersection/nominal"], ["rule_based"])
    assert (told["seed"], told["runs"], told["held_out_runs"]) == (5, [0, 1], [1, 2])
    assert set(told["packages"]) == {"scikit-learn", "numpy"}
    assert model.features == DrivingFeatures.names


def test_the_same_training_gives_the_same_digest(forest) -> None:
    small = Training(["intersection/nominal"], ["rule_based"], 1, 1, 5, 2, 2000.0)
    assert train(KINDS[0], small).digest == AnomalyModel.read(forest).digest
    other = Training(["intersection/nominal"], ["rule_based"], 1, 1, 6, 2, 2000.0)
    assert train(KINDS[0], other).digest != AnomalyModel.read(forest).digest


def test_as_many_held_out_ticks_are_above_the_threshold_as_are_accepted() -> None:
    from pytest_dura.campaign.detector_training import _averaged, _threshold

    scores = np.random.default_rng(2).permutation(np.arange(100.0))
    for accepted in (1, 5):
        assert (scores > _threshold(scores, 2.0, accepted / 2.0)).sum() == accepted
    assert _averaged(np.arange(5.0), 1).tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert _averaged(np.arange(5.0), 4).tolist() == [1.5, 2.5]
    assert _averaged(np.arange(3.0), 4).tolist() == []


@pytest.mark.parametrize("kind", KINDS)
def test_scores_are_those_of_scikit_learn(kind) -> None:
    ensemble = pytest.importorskip("sklearn.ensemble", reason="the extra `learned` is missing")
    from sklearn.svm import OneClassSVM

    from pytest_dura.campaign.detector_training import BORDER, FITS, ROWS_PER_TREE, TREES
    from pytest_dura.core import stream

    rows = np.random.default_rng(3).normal(size=(600, 3))
    model = AnomalyModel(
        kind, ("a", "b", "c"), (0.0,) * 3, (1.0,) * 3, FITS[kind](rows, 9), 1.0, 1, 0.1
    )
    asked = np.random.default_rng(4).normal(size=(200, 3)) * 3.0
    found = model.scores(asked)
    if kind == KINDS[0]:
        seed = int(stream(9, "isolation_forest").integers(2**31))
        theirs = ensemble.IsolationForest(
            n_estimators=TREES, max_samples=ROWS_PER_TREE, random_state=seed
        )
        assert found == pytest.approx(-theirs.fit(rows).score_samples(asked), abs=2e-3)
    else:
        theirs = OneClassSVM(nu=BORDER, gamma="scale").fit(rows)
        kernels = theirs.score_samples(asked) / theirs.dual_coef_.sum()
        assert np.exp(-found) == pytest.approx(kernels, rel=1e-4, abs=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_the_shipped_model_says_where_it_comes_from(kind) -> None:
    detector = detector_class(kind)
    assert detector.shipped.stat().st_size < 200_000
    model = detector.model_of()
    assert model.features == DrivingFeatures.names
    assert model.training["seed"] == 1
    assert model.training["false_alarms_per_hour"] == 1.0
    assert set(model.training["noise"]) == set(DrivingFeatures.noise)


def test_the_specs_of_episodes_state_the_models_digest(forest) -> None:
    scenario = load_scenarios([SCENARIOS / "intersection"])["intersection/nominal"]
    (case,) = expand_cases([scenario], ["none"])
    roles = {"residual_monitor": RoleSpec("isolation_forest")}
    shipped = case.spec(0, 0, roles).roles["residual_monitor"]
    assert shipped.params == {"digest": IsolationForestMonitor.model_of().digest}
    roles = {"residual_monitor": RoleSpec("isolation_forest", {"model": str(forest)})}
    own = case.spec(0, 0, roles).roles["residual_monitor"]
    assert own.params == {"model": str(forest), "digest": AnomalyModel.read(forest).digest}
    assert ParameterResolver().resolve(own).params == own.params


def test_another_model_is_another_episode(forest, tmp_path) -> None:
    file = tmp_path / "model.json"
    scenario = load_scenarios([SCENARIOS / "intersection"])["intersection/nominal"]
    (case,) = expand_cases([scenario], ["none"])
    roles = {"residual_monitor": RoleSpec("isolation_forest", {"model": str(file)})}
    addresses = []
    for threshold in (0.5, 0.75):
        plain = AnomalyModel.read(forest).to_json()
        AnomalyModel(
            **{**plain, "features": tuple(plain["features"]), "threshold": threshold}
        ).write(file)
        spec = case.spec(0, 0, roles)
        addresses.append(Addresses().of(EpisodeTask(spec)))
    first, second = addresses
    assert first.name != second.name
    assert second.changed(first.parts) == ["roles and their parameters"]
    with pytest.raises(ConfigurationError, match="not the model"):
        IsolationForestMonitor(**{**spec.roles["residual_monitor"].params, "digest": "0" * 64})


def test_a_model_of_another_kind_is_refused(forest) -> None:
    with pytest.raises(ConfigurationError, match="its kind are others"):
        OneClassSvmMonitor(str(forest))


def test_a_model_of_another_time_step_is_refused(forest) -> None:
    for ask in (
        lambda: IsolationForestMonitor.check_params({"model": str(forest)}, 0.05),
        lambda: IsolationForestMonitor(str(forest)).reset(RoleContext(1, 0.05)),
    ):
        with pytest.raises(ConfigurationError, match="another time step"):
            ask()


def test_a_scenario_with_a_changed_model_is_refused_when_it_is_read(forest, tmp_path) -> None:
    whole = json.loads(forest.read_text())
    whole["model"]["threshold"] = 0.9
    (tmp_path / "changed.json").write_text(json.dumps(whole))
    text = (SCENARIOS / "intersection" / "nominal.yaml").read_text()
    assert "\nroles:" not in text
    text = text.replace("intersection/nominal", "own/nominal")
    text += "\nroles:\n  residual_monitor:\n    path: isolation_forest\n"
    text += f"    params: {{model: {tmp_path / 'changed.json'}}}\n"
    (tmp_path / "own.yaml").write_text(text)
    with pytest.raises(ConfigurationError, match="was changed after it was written"):
        load_library([tmp_path])


@pytest.mark.parametrize(
    "arguments, key",
    [
        (["--detector", "isolation_florest"], "--detector"),
        (["--detector", "pytest_dura.driving.roles.residuals:ResidualMonitor"], "--detector"),
        (["--runs", "0"], "--runs"),
        (["--false-alarms", "0"], "--false-alarms"),
        (["--false-alarms", "0.001"], "--false-alarms"),
        (["--generator", "rule_baste"], "roles.generator"),
        (["--scenario", "intersection/nowhere"], "intersection/nowhere"),
    ],
)
def test_a_wrong_call_is_refused_in_one_error(tmp_path, capsys, arguments, key) -> None:
    pytest.importorskip("sklearn", reason="the extra `learned` is not installed")
    file = tmp_path / "m.json"
    whole = ["train-detector", "--detector", KINDS[0], "--output", str(file), *SMALL, *arguments]
    assert main(whole) == 2
    told = capsys.readouterr().err
    assert key in told
    assert "Traceback" not in told
    assert not file.exists()


def test_using_a_model_needs_no_scikit_learn() -> None:
    script = (
        "import sys; sys.modules['sklearn'] = None\n"
        "from pytest_dura.driving.roles.learned import IsolationForestMonitor as F\n"
        "from pytest_dura.driving.roles.learned import OneClassSvmMonitor as S\n"
        "print(F().model.kind, S().model.kind)\n"
        "from pytest_dura.__main__ import main\n"
        f"sys.exit(main(['train-detector', '--detector', 'isolation_forest', '--output', 'x', "
        f"*{SMALL!r}]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.stdout.split() == KINDS
    assert done.returncode == 2
    assert "pip install 'pytest-dura[learned]'" in done.stderr
