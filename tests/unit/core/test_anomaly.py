"""AnomalyModel: what it scores, what its file holds, and which files are refused."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from pytest_dura.core import AnomalyModel, ConfigurationError, average_depth

FOREST = {"sample": 4, "trees": [[[0, -1, 1, -1, -1], [1.0, 1.0, 0.5, 2.0, 3.0]], [[-1], [2.0]]]}
SVM = {"gamma": 0.5, "weights": [0.75, 0.25], "vectors": [[0.0, 0.0], [2.0, 0.0]]}


def model(kind="isolation_forest", parameters=FOREST, **changes):
    plain = {
        "features": ("a.x", "b.y"), "centre": (1.0, 0.0), "scale": (2.0, 1.0),
        "threshold": 0.5, "window": 1, "time_step": 0.1, "training": {"seed": 3},
    }  # fmt: skip
    return AnomalyModel(kind=kind, parameters=parameters, **{**plain, **changes})


def test_a_forest_scores_by_the_mean_depth_of_its_leaves() -> None:
    rows = np.array([[3.0, 9.0], [3.1, 0.5], [3.1, 0.6]])  # scaled: 1, 1.05, 1.05 of the first
    depths = [(1.0 + 2.0) / 2, (2.0 + 2.0) / 2, (3.0 + 2.0) / 2]
    expected = [2.0 ** (-depth / average_depth(4)) for depth in depths]
    assert model().scores(rows) == pytest.approx(expected)


@pytest.mark.parametrize("rows, depth", [(1, 0.0), (2, 1.0), (3, 1.20739), (256, 10.2448)])
def test_the_average_depth_of_the_paper(rows, depth) -> None:
    assert average_depth(rows) == pytest.approx(depth, abs=1e-4)


def test_a_one_class_svm_scores_by_the_weighted_kernels() -> None:
    found = model("one_class_svm", SVM).scores(np.array([[1.0, 0.0], [1.0, 2.0]]))
    near = 0.75 + 0.25 * math.exp(-0.5 * 4)
    far = 0.75 * math.exp(-0.5 * 4) + 0.25 * math.exp(-0.5 * 8)
    assert found == pytest.approx([-math.log(near), -math.log(far)])


@pytest.mark.parametrize("kind, parameters", [("isolation_forest", FOREST), ("one_class_svm", SVM)])
def test_absurd_rows_have_finite_scores_and_name_their_feature(kind, parameters) -> None:
    absurd = np.array([[1e300, 0.0], [math.nan, 0.0], [0.0, -math.inf]])
    scored = model(kind, parameters)
    assert np.isfinite(scored.scores(absurd)).all()
    assert [scored.farthest_feature(row) for row in absurd] == ["a.x", "a.x", "b.y"]


def test_many_rows_score_as_each_by_itself() -> None:
    rows = np.random.default_rng(1).normal(size=(5000, 2))
    whole = model().scores(rows)
    assert whole[[0, 4999]] == pytest.approx([model().scores(rows[[i]])[0] for i in (0, 4999)])


def test_what_is_written_is_read_with_the_same_digest(tmp_path) -> None:
    digest = model().write(tmp_path / "m.json")
    again = AnomalyModel.read(tmp_path / "m.json", digest)
    assert again == model()
    assert again.digest == digest != model(threshold=0.6).digest


def rewritten(file, change, *, honest=True):
    whole = json.loads(file.read_text())
    change(whole["model"])
    if honest:
        from pytest_dura.core.anomaly_monitor import _digest

        whole["sha256"] = _digest(whole["model"])
    file.write_text(json.dumps(whole))


def test_a_changed_file_is_refused_in_one_error(tmp_path) -> None:
    file = tmp_path / "m.json"
    digest = model().write(file)
    rewritten(file, lambda plain: plain.update(threshold=99.0), honest=False)
    with pytest.raises(ConfigurationError, match="was changed after it was written") as caught:
        AnomalyModel.read(file)
    assert str(file) in str(caught.value)
    assert digest in caught.value.expected
    assert "train-detector" in caught.value.remedy


def test_another_model_than_the_one_meant_is_refused(tmp_path) -> None:
    file = tmp_path / "m.json"
    own = model().write(file)
    with pytest.raises(ConfigurationError, match="not the model") as caught:
        AnomalyModel.read(file, "0" * 64)
    assert (caught.value.found, caught.value.expected) == (own, "0" * 64)


@pytest.mark.parametrize(
    "change",
    [
        lambda plain: plain.pop("scale"),
        lambda plain: plain.update(kind="pickle"),
        lambda plain: plain.update(kind=["isolation_forest"]),
        lambda plain: plain.update(features=[]),
        lambda plain: plain.update(features=["a.x", "a.x"]),
        lambda plain: plain.update(features=7),
        lambda plain: plain.update(scale=[1.0, 0.0]),
        lambda plain: plain.update(centre=["x", 0.0]),
        lambda plain: plain.update(threshold=0.0),
        lambda plain: plain.update(time_step=-1),
        lambda plain: plain.update(window=0),
        lambda plain: plain.update(window=1.5),
        lambda plain: plain.update(window=True),
        lambda plain: plain.update(training=None),
        lambda plain: plain["parameters"].update(trees=[]),
        lambda plain: plain["parameters"].update(trees=[[[0, -1], [1.0, 1.0]]]),
        lambda plain: plain["parameters"].update(trees=[[[-1, -1], [1.0, 1.0]]]),
        lambda plain: plain["parameters"].update(trees=[[[2, -1, -1], [1.0, 1.0, 1.0]]]),
        lambda plain: plain["parameters"].update(trees=[[[0.5, -1, -1], [1.0, 1.0, 1.0]]]),
        lambda plain: plain["parameters"].update(trees=[[[-1], [1.0, 1.0]]]),
        lambda plain: plain["parameters"].update(trees=[[[-1], [1e999]]]),
        lambda plain: plain["parameters"].update(trees=7),
        lambda plain: plain["parameters"].update(sample=1),
        lambda plain: plain.update(kind="one_class_svm", parameters={**SVM, "gamma": 0}),
        lambda plain: plain.update(kind="one_class_svm", parameters={**SVM, "weights": [1.0]}),
        lambda plain: plain.update(kind="one_class_svm", parameters={**SVM, "weights": []}),
        lambda plain: plain.update(kind="one_class_svm", parameters={**SVM, "vectors": [[1, 2]]}),
    ],
)
def test_a_model_that_does_not_fit_together_is_refused(tmp_path, change) -> None:
    file = tmp_path / "m.json"
    model().write(file)
    try:
        rewritten(file, change)
    except ValueError:  # what is no number has no honest digest either
        rewritten(file, change, honest=False)
    with pytest.raises(ConfigurationError) as caught:
        AnomalyModel.read(file)
    assert caught.value.file == str(file)


@pytest.mark.parametrize(
    "content",
    [b"", b"\x80\x04K\x01.", b"[]", b"{}", b"[" * 100_000, b'{"format": "other"}',
     b'{"format": "pytest-dura anomaly model", "version": 2}',
     b'{"format": "pytest-dura anomaly model", "version": 1}',
     b'{"format": "pytest-dura anomaly model", "version": 1, "model": NaN}'],
)  # fmt: skip
def test_what_is_no_model_is_refused(tmp_path, content) -> None:
    (tmp_path / "m.json").write_bytes(content)
    with pytest.raises(ConfigurationError, match="model of a detector"):
        AnomalyModel.read(tmp_path / "m.json")


def test_what_is_no_file_is_refused(tmp_path) -> None:
    for file in (tmp_path, tmp_path / "none.json"):
        with pytest.raises(ConfigurationError, match="model of a detector"):
            AnomalyModel.read(file)


def test_a_file_that_is_written_anew_is_read_anew(tmp_path) -> None:
    file = tmp_path / "m.json"
    model().write(file)
    assert AnomalyModel.read(file).threshold == 0.5
    model(threshold=0.625).write(file)
    assert AnomalyModel.read(file).threshold == 0.625
