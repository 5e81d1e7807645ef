"""The paper's experiment runs offline from its cassette, and shows the paper's figures."""

from __future__ import annotations

import shutil
import sqlite3

from suites import SUITES, run_suite

from pytest_dura.evidence import open_record, verify_bundle
from pytest_dura.llm.record import models_of

SUITE = SUITES / "paper"
SELECTED = "--dura-select=intersection/[gn]*"


def test_the_suite_replays_every_decision_and_prints_the_paper_beside_it(tmp_path):
    project = tmp_path / "paper"
    shutil.copytree(SUITE, project, ignore=shutil.ignore_patterns("train", "planner-lora.gguf"))
    done = run_suite(project, SELECTED, "--dura-runs=2")
    assert "The paper's figures beside these" in done.stdout
    bundle = project / "dura-evidence"
    record = open_record(bundle / "evidence.json")
    assert {episode.validity for episode in record.episodes()} == {"valid"}
    (model,) = models_of(record.head)
    assert (model.about, model.asked, model.missed) == ("SmolLM2-135M-Instruct + LoRA", 0, 0)
    assert model.reused > 0
    rows = {row[0]: row for row in record.head.conclusions["paper"].rows}
    assert set(rows) == {"nominal", "ghost-obstacle"}
    assert verify_bundle(bundle).problems == []


def test_the_cassette_has_an_answer_to_each_request_and_is_no_larger_than_20_mb():
    file = SUITE / "smollm2.sqlite"
    assert file.stat().st_size < 20e6
    with sqlite3.connect(f"file:{file}?mode=ro", uri=True) as opened:
        failures = opened.execute(
            "SELECT DISTINCT json_extract(answer, '$.failure') FROM exchanges"
        ).fetchall()
    assert failures == [("",)]
