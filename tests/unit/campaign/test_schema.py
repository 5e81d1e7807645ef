"""The JSON Schema that ships with the scenarios."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pytest_dura.library import Scenario, builtin_paths
from pytest_dura.library.scenario import SCHEMA_FILE, scenario_schema, write_schema


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    return scenario_schema()


def test_the_committed_file_is_up_to_date(schema: dict[str, Any]) -> None:
    committed = json.loads((builtin_paths()[0] / SCHEMA_FILE).read_text("utf-8"))
    assert committed == schema, "run `python -m pytest_dura.library.scenario`"


def test_every_key_is_described(schema: dict[str, Any]) -> None:
    assert list(schema["properties"]) == list(Scenario.model_fields)
    assert all(one.get("description") for one in schema["properties"].values())
    assert "seconds" in schema["properties"]["duration"]["description"]


def test_unknown_keys_are_refused_by_editors_too(schema: dict[str, Any]) -> None:
    assert schema["additionalProperties"] is False
    assert schema["required"] == ["name", "simulator", "duration"]


def test_a_driving_world_and_a_fault_have_their_own_schemas(schema: dict[str, Any]) -> None:
    (condition,) = schema["allOf"]
    assert condition["if"]["properties"] == {"simulator": {"const": "driving"}}
    assert condition["then"]["properties"]["world"] == {"$ref": "#/$defs/DrivingWorld"}
    assert "headway" in schema["$defs"]["Traffic"]["properties"]
    fault = schema["$defs"]["FaultEntry"]
    assert "ghost-obstacle" in fault["properties"]["type"]["enum"]


def test_every_reference_has_a_target(schema: dict[str, Any]) -> None:
    text = json.dumps(schema)
    targets = {part.split('"')[0] for part in text.split("#/$defs/")[1:]}
    assert targets <= set(schema["$defs"])
    assert len(targets) > 5


def test_writing_is_reproducible(tmp_path: Path) -> None:
    write_schema(tmp_path / "a")
    write_schema(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
