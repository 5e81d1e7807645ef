"""The training scripts of the paper's suite: the corpus, what makes it, and the adapter's file."""

from __future__ import annotations

import collections
import gzip
import json
import random
import re

import numpy as np
import pytest
from suites import SUITES

from pytest_dura.llm.answers import read_answer
from pytest_dura.llm.driving.planner import driving_templates
from pytest_dura.llm.port import Answer

SUITE = SUITES / "paper"
HELD_OUT = "intersection/trajectory-spoofing"
NAMED = re.compile(r"\b[VPX][0-9A-F]+\b|\b[A-Z]{2,}[A-Z0-9_]*\b")


@pytest.fixture(scope="module")
def scripts():
    """Modules of the training scripts, by name."""
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(SUITE / "train")
        import base_model
        import corpus
        import to_gguf

        yield {"corpus": corpus, "base_model": base_model, "to_gguf": to_gguf}


def check_rows(rows, systems):
    """Each is a prompt of the planner and an answer that its schema allows."""
    schema = driving_templates(SUITE / "prompts").schema
    keys = {"part", "system", "user", "answer", "maneuver", "scenario", "run", "tick"}
    for row in rows:
        assert set(row) == keys
        assert row["system"] in range(len(systems))
        reading = read_answer(Answer(row["answer"]), schema)
        assert reading.answered, (row, reading)
        assert reading.content["maneuver"] == row["maneuver"]
        assert set(reading.content["threat_ids"]) <= set(NAMED.findall(row["user"]))
        assert (row["part"] == "held_out_scenario") == (row["scenario"] == HELD_OUT)


def test_the_corpus_has_prompts_of_the_planner_and_valid_answers():
    with gzip.open(SUITE / "train" / "corpus.jsonl.gz", "rt") as lines:
        systems, *rows = (json.loads(line) for line in lines)
    assert set(systems) == {"systems"}
    check_rows(rows, systems["systems"])
    parts = collections.Counter(row["part"] for row in rows)
    assert parts == {"train": 5268, "validation": 589, "held_out_scenario": 194}
    assert (SUITE / "train" / "corpus.jsonl.gz").stat().st_size < 1_000_000


def test_the_script_makes_samples_of_that_form(scripts):
    corpus, systems = scripts["corpus"], []
    samples = next(corpus.episodes(corpus.VALIDATION, 1))
    rows = list(corpus.rows_of("train", samples, systems, random.Random(0)))
    assert len(rows) == len(samples) > 10
    check_rows(rows, systems)


def test_other_ids_are_those_of_prompt_and_answer(scripts):
    prompt, answer = "V1,car\nP2,pedestrian\nV1 again, S1", '{"threat_ids":["V1","P2"]}'
    user, renamed = scripts["corpus"].renamed(prompt, answer, random.Random(1))
    (car, walker), pattern = json.loads(renamed)["threat_ids"], r"[VP]\d+"
    assert re.fullmatch(pattern, car)
    assert re.fullmatch(pattern, walker)
    assert car != "V1"
    assert user == f"{car},car\n{walker},pedestrian\n{car} again, S1"


def test_an_adapter_is_written_with_the_names_and_rows_of_llama_cpp(scripts, tmp_path):
    gguf = pytest.importorskip("gguf")
    draws, rank = np.random.default_rng(0), 2
    width, kept, inner = 576, 192, 1536
    shapes = {
        "self_attn.q_proj": (width, width), "self_attn.k_proj": (kept, width),
        "self_attn.v_proj": (kept, width), "self_attn.o_proj": (width, width),
        "mlp.gate_proj": (inner, width), "mlp.up_proj": (inner, width),
        "mlp.down_proj": (width, inner),
    }  # fmt: skip
    tensors = {}
    for name, (rows, columns) in shapes.items():
        stem = f"base_model.model.model.layers.7.{name}"
        tensors[f"{stem}.lora_A.weight"] = draws.normal(size=(rank, columns))
        tensors[f"{stem}.lora_B.weight"] = draws.normal(size=(rows, rank))
    scripts["to_gguf"].write(tmp_path / "adapter.gguf", tensors, 4.0)
    written = gguf.GGUFReader(tmp_path / "adapter.gguf")
    assert written.get_field("general.type").contents() == "adapter"
    assert written.get_field("adapter.lora.alpha").contents() == 4.0
    read = {each.name: each.data for each in written.tensors}
    assert {each.dtype for each in read.values()} == {np.dtype(np.float16)}
    kinds = ("attn_q", "attn_k", "attn_v", "attn_output", "ffn_gate", "ffn_up", "ffn_down")
    for name, kind in zip(shapes, kinds, strict=True):
        for factor in "AB":
            values = read.pop(f"blk.7.{kind}.weight.lora_{factor.lower()}")
            own = tensors[f"base_model.model.model.layers.7.{name}.lora_{factor}.weight"]
            own = own.astype(np.float16)
            if (kind in ("attn_q", "attn_k")) and factor == "B":
                # Rows 0 and 32 of a head, which rotary positions turn together, come to lie side
                # by side; and so each of the others with its partner.
                partners = [row // 2 + 32 * (row % 2) for row in range(64)]
                own = np.concatenate([own[at:][partners] for at in range(0, len(own), 64)])
            np.testing.assert_array_equal(values, own)
    assert not read


def test_rows_of_weights_are_read_in_the_order_in_which_adapters_are_written(scripts):
    rows = np.arange(192.0)[:, None] + np.zeros((1, 3))
    model = scripts["base_model"]
    assert model.halves_of_heads(rows)[:3, 0].tolist() == [0.0, 2.0, 4.0]
    np.testing.assert_array_equal(model.halves_of_heads(model.pairs_of_heads(rows)), rows)
