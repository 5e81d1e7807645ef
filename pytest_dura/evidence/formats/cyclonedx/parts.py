"""References and descriptions that several parts of the CycloneDX document share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.formats.stated import sha256
from pytest_dura.evidence.text import name, visible

PREFIX = "pytest-dura:"
NAME_LIMIT = 400
Data = dict[str, Any]


def requirement_ref(number: int) -> str:
    """``bom-ref`` of a requirement, by its place in the record: ids may hold anything."""
    return f"requirement/{number}"


def properties(told: Mapping[str, str]) -> list[Data]:
    """Name-value pairs under our prefix."""
    return [{"name": f"{PREFIX}{key}", "value": value} for key, value in told.items()]


def described(component: Mapping[str, Any], ref: str) -> Data:
    """A component under test, with version and digest as far as the record has them."""
    found: Data = {
        "type": "application",
        "bom-ref": ref,
        "name": name(component["name"] or "unknown", NAME_LIMIT),
    }
    if component.get("version"):
        found["version"] = name(str(component["version"]), NAME_LIMIT)
    if digest := sha256(component.get("digest")):
        found["hashes"] = [{"alg": "SHA-256", "content": digest}]
    told = {"path": visible(component["path"])} if component.get("path") else {}
    if component.get("opaque"):
        told["opaque"] = "true"
    return found | ({"properties": properties(told)} if told else {})
