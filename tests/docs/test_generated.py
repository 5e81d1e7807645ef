"""What is generated and committed is what its source makes of it now."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from prompt_views import GOLDEN, golden

from pytest_dura.domains import DOMAINS
from pytest_dura.evidence import schema as record
from pytest_dura.library import domain_reference, fault_reference, hazards, read_yaml, scenario
from pytest_dura.plugin.commands import option_reference

REPOSITORY = Path(__file__).parents[2]
DOCS, SCENARIOS = REPOSITORY / "docs", REPOSITORY / "scenarios"


def options():
    return {DOCS / option_reference.PAGE: option_reference.reference_page()}


def faults():
    page = fault_reference.reference_page(DOMAINS["driving"].fault_targets)
    return {DOCS / fault_reference.PAGE: page}


def domains():
    page = domain_reference.reference_page(domain_reference.builtin_domains())
    return {DOCS / domain_reference.PAGE: page}


def keys_of_a_record():
    schema = json.dumps(record.generate_schema(), indent=1, ensure_ascii=False)
    return {
        DOCS / record.PAGE: record.updated_page((DOCS / record.PAGE).read_text("utf-8")),
        Path(record.__file__).with_name(record.SCHEMA_FILE): f"{schema}\n",
    }


def scenarios():
    schema = json.dumps(scenario.scenario_schema(), indent=2, sort_keys=True)
    return {SCENARIOS / scenario.SCHEMA_FILE: f"{schema}\n"}


def hazard_files():
    schema = json.dumps(hazards.hazard_schema(), indent=2, sort_keys=True)
    return {SCENARIOS / hazards.SCHEMA_FILE: f"{schema}\n"}


def public_names():
    reference = importlib.import_module("reference_pages")
    pages = reference.reference_pages()
    return {reference.FOLDER / name: text for name, text in pages.items()}


def forged_fields():
    """The list of fields that a hash or a signature alone protects."""
    fields = importlib.import_module("forged_fields")
    return {fields.PAGE: fields.updated_page(fields.PAGE.read_text("utf-8"))}


def prompts():
    """Prompts of real episodes, as they are put before a model, byte by byte."""
    texts = golden()
    assert {file.name for file in GOLDEN.iterdir()} == set(texts)
    return {GOLDEN / name: text for name, text in texts.items()}


GENERATED = {
    options: "python -m pytest_dura.plugin.commands.option_reference",
    faults: "python -m pytest_dura.library.fault_reference",
    domains: "python -m pytest_dura.library.domain_reference",
    keys_of_a_record: "python -m pytest_dura.evidence.schema",
    scenarios: "python -m pytest_dura.library.scenario",
    hazard_files: "python -m pytest_dura.library.hazards",
    public_names: "python docs/reference_pages.py",
    prompts: "python tests/support/prompt_views.py",
    forged_fields: "python tests/support/forged_fields.py",
}
"""What makes the texts of some files, and the command that writes them."""


def check_page(text, command):
    assert f"<!-- Written by `{command}`; do not edit. -->" in text
    for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        widths = {len(re.findall(r"(?<!\\)\|", row)) for row in table.splitlines()}
        assert len(widths) == 1, f"rows of other widths under {table.splitlines()[0]}"


def check_schema(text):
    """Editors and validators can use it: each key has a meaning, and another is refused."""
    schema = json.loads(text)
    Draft202012Validator.check_schema(schema)
    assert all(len(each["description"]) > 3 for each in schema["properties"].values())
    references = set(re.findall(r'"#/\$defs/([^"]+)"', text))
    assert references <= set(schema.get("$defs", ()))
    for part in parts(schema):
        if part.get("type") == "object" and isinstance(part.get("properties"), dict):
            assert part["additionalProperties"] is False


def parts(value):
    """Yield a part of a schema, and those within it."""
    if isinstance(value, dict):
        yield value
    if isinstance(value, (dict, list)):
        for each in value.values() if isinstance(value, dict) else value:
            yield from parts(each)


@pytest.mark.parametrize("generate", GENERATED, ids=lambda generate: generate.__name__)
def test_what_is_committed_is_what_is_generated(generate, monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    texts = generate()
    assert texts
    for file, text in texts.items():
        assert file.read_text("utf-8") == text, f"{file.name} is old: `{GENERATED[generate]}`"
        if file.suffix == ".md":
            check_page(text, GENERATED[generate])
        elif file.suffix == ".json":
            check_schema(text)


def changed(data, path, value):
    """Copy plain data with another value at a path."""
    first, *rest = path
    copied = data.copy()
    copied[first] = changed(copied[first], rest, value) if rest else value
    return copied


def test_an_editor_accepts_built_in_files_and_refuses_what_is_spelled_otherwise():
    of_scenarios, of_hazards = (
        Draft202012Validator(json.loads((SCENARIOS / module.SCHEMA_FILE).read_text("utf-8")))
        for module in (scenario, hazards)
    )
    read = {file: read_yaml(file).data for file in SCENARIOS.rglob("*.yaml")}
    found = [data for data in read.values() if {"name", "simulator"} <= set(data)]
    assert len(found) > 3
    for data in found:
        assert of_scenarios.is_valid(data)
        assert not of_scenarios.is_valid(changed(data, ["duratoin"], 1.0))
        assert not of_scenarios.is_valid(changed(data, ["world"], {**data["world"], "trafic": {}}))
        if data.get("faults"):
            assert not of_scenarios.is_valid(changed(data, ["faults", 0, "type"], "gost"))
    data = read[SCENARIOS / "hazards.yaml"]
    assert of_hazards.is_valid(data)
    assert not of_hazards.is_valid(changed(data, ["hazards", 0, "severity"], "fatal"))
