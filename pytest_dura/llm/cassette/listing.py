"""A cassette as text: one JSON object a line, for those who want to read or search it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pytest_dura.llm.cassette.exchanges import Cassette


def listing(file: Path) -> Iterator[str]:
    """Lines of JSON in ASCII: the models that were described, then the exchanges, in their order.

    Whatever a model answered, no character of it acts on a terminal.

    Args:
        file: The cassette, which stays as it is.

    Raises:
        ConfigurationError: If it is none, or cannot be read.
    """
    cassette = Cassette(file, writable=False)
    try:
        for one in cassette.descriptions():
            yield _line({"described": one})
        for exchange in cassette.exchanges():
            told = {key: value for key, value in vars(exchange).items() if key != "answer"}
            yield _line({**told, "answer": exchange.answer.to_json()})
    finally:
        cassette.close()


def _line(value: Any) -> str:
    return json.dumps(value, sort_keys=True)
