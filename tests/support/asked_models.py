"""What a record in plain data says of the language models that its session asked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.llm.record import CASSETTE, NAME


def asked_models(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The counts of each process, as the record has them."""
    facts = (fact for fact in record.get("facts", ()) if fact["table"] == NAME)
    return [fact["data"] for fact in facts if fact["about"] != CASSETTE]
