"""Reading a baseline, and what is none."""

from __future__ import annotations

import copy
import hashlib
import json
import math
import sys

import pytest
from baseline_records import record, verdict

from pytest_dura import ConfigurationError
from pytest_dura.evidence import Baseline, SessionRecord


def written(folder, told):
    file = folder / "evidence.json"
    file.write_text(json.dumps(told))
    return file


@pytest.mark.parametrize("given", ["old", "old/evidence.json"])
def test_a_baseline_is_a_file_or_the_directory_that_holds_it(tmp_path, given):
    (tmp_path / "old").mkdir()
    file = written(tmp_path / "old", record(verdict(3)))
    baseline = Baseline.read(given, tmp_path)
    session = baseline.session
    assert (session.path, session.created) == (given, "2026-01-02T03:04:05+00:00")
    assert session.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    compared = baseline.compared(
        SessionRecord.of(record(verdict(3), verdict(3, requirement="N")), tmp_path)
    )
    assert (compared.tests, compared.correction) == (1, "Holm")
    assert compared.component == {
        "name": "C", "distribution": None, "version": None, "digest": "d" * 64
    }  # fmt: skip
    statuses = [comparison.status for comparison in compared.comparisons]
    assert statuses == ["new", "no evidence of a change"]
    assert baseline.compared() == session
    assert session.comparisons == ()


# What json reads and no recursion of ours follows; its own is counted apart from Python 3.12 on.
DEEP = 900 if sys.version_info < (3, 12) else 1200


def nested(depth):
    found = []
    for _ in range(depth):
        found = [found]
    return found


def test_a_file_that_is_nested_too_deeply_is_no_record(tmp_path):
    (tmp_path / "evidence.json").write_text("[" * 100_000)
    with pytest.raises(ConfigurationError, match="this is no evidence record"):
        Baseline.read(".", tmp_path)


def test_infinity_is_no_number_of_json(tmp_path):
    written(tmp_path, damaged(lambda told: told.update(base_seed=math.inf)))
    with pytest.raises(ConfigurationError, match="this is no evidence record"):
        Baseline.read(".", tmp_path)


def damaged(change):
    told = copy.deepcopy(record(verdict(3, {0})))
    change(told)
    return told


@pytest.mark.parametrize("change, found", [
    (lambda told: told.pop("verdicts"), '/: missing key "verdicts"'),
    (lambda told: told["verdicts"][0].update(violations=4),
     "--dura-baseline: ValueError: 4 violations"),
    (lambda told: told["verdicts"][0].update(violations=-1), "/verdicts/0/violations: -1"),
    (lambda told: told["verdicts"][0].update(episodes="3"), "/verdicts/0/episodes: string"),
    (lambda told: told["verdicts"][0].update(case=None), "/verdicts/0/case: null"),
    (lambda told: told["verdicts"][0]["bound"].update(confidence=95),
     "/verdicts/0/bound/confidence: 95"),
    (lambda told: told["episodes"][0].update(id="x"), "--dura-baseline: ValueError"),
    (lambda told: told["episodes"][0]["spec"].pop("scenario"), "/episodes/0/spec: missing key"),
    (lambda told: told["episodes"][0]["spec"].update(seed="7"),
     "/episodes/0/spec/seed: string"),
    (lambda told: told["episodes"].append(None), "/episodes/3: null"),
    (lambda told: told.update(component_under_test=None), "/component_under_test: null"),
    (lambda told: told.update(base_seed="none"), "/base_seed: string"),
    (lambda told: told["verdicts"][0].update(run=10**400, episodes=10**400),
     "--dura-baseline: ValueError"),
    (lambda told: told["episodes"][0]["spec"]["scenario"]["world"].update(x=nested(DEEP)),
     "--dura-baseline: RecursionError"),
])  # fmt: skip
def test_a_damaged_baseline_is_refused(tmp_path, change, found):
    file = written(tmp_path, damaged(change))
    with pytest.raises(ConfigurationError, match="is damaged") as error:
        Baseline.read(".", tmp_path)
    assert error.value.file == str(file)
    assert f"{error.value.key}: {error.value.found}".startswith(found)
    assert error.value.expected


@pytest.mark.parametrize("status, fine", [("running", False), ("interrupted", True)])
def test_a_session_that_was_killed_is_no_baseline(tmp_path, status, fine):
    written(tmp_path, record(verdict(3), status=status))
    if fine:
        assert Baseline.read(".", tmp_path).session.status == status
    else:
        with pytest.raises(ConfigurationError, match="was killed, or is still running"):
            Baseline.read(".", tmp_path)


def test_a_missing_baseline_names_the_option(tmp_path):
    with pytest.raises(ConfigurationError, match="there is no evidence here") as error:
        Baseline.read("nowhere.json", tmp_path)
    assert error.value.key == "--dura-baseline"
