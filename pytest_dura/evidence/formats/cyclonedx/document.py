"""The CycloneDX document around the declarations: metadata, packages, the standard."""

from __future__ import annotations

import hashlib
import json
import uuid
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from pytest_dura.evidence.formats.cyclonedx.declarations import declarations
from pytest_dura.evidence.formats.cyclonedx.parts import (
    NAME_LIMIT,
    PREFIX,
    described,
    properties,
    requirement_ref,
)
from pytest_dura.evidence.formats.stated import UNREVIEWED
from pytest_dura.evidence.plain import plain
from pytest_dura.evidence.record.counts import Counts
from pytest_dura.evidence.record.session_record import SessionRecord, components_under_test
from pytest_dura.evidence.text import name, visible

FILE = "cyclonedx.json"
Data = dict[str, Any]
_SCHEMA = "http://cyclonedx.org/schema/bom-1.6.schema.json"
_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, "urn:pytest-dura")


def render(record: SessionRecord) -> str:
    """The document as text.

    Raises:
        ValueError: If a verdict names a requirement that the record does not list.
    """
    document = {
        "$schema": _SCHEMA,
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{_serial_number(record)}",
        "version": 1,
        "metadata": _metadata(record),
        "components": _packages(record["environment"]["packages"]),
        "definitions": {"standards": [_standard(record["requirements"])]},
        "declarations": declarations(record),
    }
    return json.dumps(document, indent=1) + "\n"


def _serial_number(record: SessionRecord) -> uuid.UUID:
    """The same for the same record: from all of it, of episodes their digests."""
    state = hashlib.sha256(json.dumps(plain(record.head), sort_keys=True).encode())
    for one in record.episodes():
        told = [one[key] for key in ("id", "component", "digest", "validity")]
        state.update(json.dumps(told).encode())
    return uuid.uuid5(_NAMESPACE, state.hexdigest())


def _metadata(record: SessionRecord) -> Data:
    tool = record["tool"]
    counts = {key: str(value) for key, value in Counts.of(record).to_json().items()}
    told = {
        **counts,
        "status": record["status"],
        "review": UNREVIEWED,
        "command": visible(record["command"]),
        "base_seed": str(record["base_seed"]),
    }
    return {
        "timestamp": record["created"],
        "tools": {
            "components": [
                {
                    "type": "application",
                    "bom-ref": "tool",
                    "name": name(tool["name"], NAME_LIMIT),
                    "version": name(tool["version"], NAME_LIMIT),
                }
            ]
        },
        "component": described(components_under_test(record)[0], "component-under-test"),
        "properties": properties(told),
    }


def _packages(packages: Mapping[str, str]) -> list[Data]:
    found = []
    for number, package in enumerate(sorted(packages)):
        shown = name(package, NAME_LIMIT)
        version = name(packages[package] or "unknown", NAME_LIMIT)
        # The purl of PyPI has lower case, and a dash for an underscore.
        purl = (
            f"pkg:pypi/{quote(shown.lower().replace('_', '-'), safe='')}@{quote(version, safe='')}"
        )
        found.append(
            {
                "type": "library",
                "bom-ref": f"package/{number}",
                "name": shown,
                "version": version,
                "purl": purl,
            }
        )
    return found


def _standard(requirements: list[Data]) -> Data:
    return {
        "bom-ref": "standard",
        "name": "Requirements of the session",
        "description": f"The requirements that the session judged; {UNREVIEWED}.",
        "requirements": [_requirement(number, one) for number, one in enumerate(requirements)],
    }


def _requirement(number: int, one: Data) -> Data:
    at_most = "every valid episode satisfies it"
    if one["at_most"] is not None:
        at_most = f"at most {one['at_most']:g} of episodes violate it, at {one['confidence']:g}"
    texts = (
        ("check", one["check"]),
        ("criterion", at_most),
        ("reason", one["reason"]),
        ("source", one["source"]),
    )
    return {
        "bom-ref": requirement_ref(number),
        "identifier": name(one["id"], NAME_LIMIT),
        "title": visible(one["text"] or one["id"], 200),
        "text": visible(one["text"]),
        "descriptions": [f"{label}: {visible(text)}" for label, text in texts if text],
        "properties": [{"name": f"{PREFIX}kind", "value": visible(one["kind"] or "")}],
    }
