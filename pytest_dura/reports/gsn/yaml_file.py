"""``assurance-case.gsn.yaml``: the argument as gsn2x reads it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from pytest_dura.evidence.model import SessionRecord
from pytest_dura.reports.gsn.argument import generated_argument
from pytest_dura.reports.wording import review_text

FILE = "assurance-case.gsn.yaml"
_MODULE = "module"
_PLAIN_KEY = re.compile(
    r"(?!(?:y|n|yes|no|on|off|true|false|null)\Z)[A-Za-z][A-Za-z0-9_-]*", re.IGNORECASE
)
_UNPRINTABLE = re.compile("[\x7f-\x9f\u2028\u2029\ud800-\udfff\ufeff\ufffe\uffff]")
"""What a YAML reader refuses or changes, and JSON leaves as it is."""


def render(record: SessionRecord) -> str:
    """The file's text."""
    elements = {id_: element.to_yaml() for id_, element in generated_argument(record).items()}
    module = {
        "name": "assurance-case",
        "brief": f"By pytest-dura, {review_text(record)}"
        + (": nothing here is asserted." if record.review is None else "."),
    }
    return "".join(_lines({_MODULE: module, **elements}))


def _lines(mapping: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    """Write a mapping in block style; PyYAML's writer takes a third of the time of a page.

    Every text is in double quotes, with which it is a text in YAML 1.1 and 1.2 alike.
    """
    for key, value in mapping.items():
        name = key if _PLAIN_KEY.fullmatch(key) else _scalar(key)
        if isinstance(value, Mapping):
            yield f"{indent}{name}:\n"
            yield from _lines(value, indent + "  ")
        elif isinstance(value, list):
            yield f"{indent}{name}:\n"
            yield from (f"{indent}- {_scalar(each)}\n" for each in value)
        else:
            yield f"{indent}{name}: {_scalar(value)}\n"


def _scalar(value: str | bool) -> str:
    return _UNPRINTABLE.sub(_escaped, json.dumps(value, ensure_ascii=False))


def _escaped(character: re.Match[str]) -> str:
    return f"\\u{ord(character[0]):04x}"
