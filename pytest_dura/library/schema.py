"""The JSON Schema of scenario files; ``python -m pytest_dura.campaign.schema`` writes it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from pytest_dura.domains import DOMAINS
from pytest_dura.faults.catalogue import FAULT_TYPES, fault_class
from pytest_dura.library.loading import SCHEMA_FILE
from pytest_dura.library.scenario import FaultEntry, Scenario, world_model

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def scenario_schema() -> dict[str, Any]:
    """The scenario's own keys, each domain's world, and each fault type's parameters."""
    worlds = {alias: model for alias, domain in DOMAINS.items() if (model := world_model(domain))}
    faults = {name: fault_class(name) for name in sorted(FAULT_TYPES)}
    models: list[type[BaseModel]] = [Scenario, FaultEntry, *worlds.values(), *faults.values()]
    references, combined = models_json_schema([(model, "validation") for model in models])
    definitions = combined["$defs"]

    def definition(model: Any) -> dict[str, Any]:
        definition: dict[str, Any] = definitions[_name(references[model, "validation"])]
        return definition

    scenario = definitions.pop(_name(references[Scenario, "validation"]))
    scenario["allOf"] = [
        _when_clause("simulator", alias, {"world": references[model, "validation"]})
        for alias, model in worlds.items()
    ]
    entry = definition(FaultEntry)
    entry["properties"]["type"]["enum"] = list(faults)
    entry["allOf"] = [
        _when_clause("type", name, _own_parts(definition(model))) for name, model in faults.items()
    ]
    for model in faults.values():
        definitions.pop(_name(references[model, "validation"]))
    return {"$schema": _DIALECT, **scenario, "$defs": definitions}


def write_schema(path: Path) -> None:
    """Write the schema to a file, the same bytes for the same schema."""
    path.write_text(json.dumps(scenario_schema(), indent=2, sort_keys=True) + "\n", "utf-8")


def _name(reference: dict[str, Any]) -> str:
    return str(reference["$ref"]).rpartition("/")[2]


def _when_clause(key: str, value: str, properties: dict[str, Any]) -> dict[str, Any]:
    condition = {"properties": {key: {"const": value}}, "required": [key]}
    return {"if": condition, "then": {"properties": properties}}


def _own_parts(fault: dict[str, Any]) -> dict[str, Any]:
    return {part: fault["properties"][part] for part in ("activation", "parameters")}


if __name__ == "__main__":
    write_schema(Path(__file__).resolve().parents[2] / "scenarios" / SCHEMA_FILE)
