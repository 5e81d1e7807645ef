"""Stored: what a cassette holds, checked before anything rests on it.

A cassette may come from anywhere. What is wrong with it must not pass for what a model answered,
nor come up as an error of the component that asked.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, get_args

from pytest_dura.llm.port import Answer, Request, WireFailure

_ANSWER = Answer().to_json()
_REQUEST = Request("", ()).to_json()
_FAILURES = get_args(WireFailure)


def answer_of(data: Mapping[str, Any]) -> Answer:
    """The answer that plain data holds.

    Raises:
        ValueError: If it is none.
    """
    _need(set(data) == set(_ANSWER), "an answer has other entries")
    for name, usual in _ANSWER.items():
        if isinstance(usual, str):
            _need(isinstance(data[name], str), f"{name} of an answer is no text")
    _need(data["failure"] in _FAILURES, "an answer has a failure of no known class")
    seconds, usage = data["seconds"], data["usage"]
    fits = type(seconds) in (int, float) and math.isfinite(seconds) and seconds >= 0.0
    _need(fits, "seconds of an answer are no time")
    counts = isinstance(usage, dict) and all(type(one) is int for one in usage.values())
    _need(counts, "usage of an answer holds no counts")
    return Answer.from_json(data)


def check_request(data: Mapping[str, Any]) -> None:
    """See that plain data is a request whose texts are digests or texts.

    Raises:
        ValueError: If it is none.
    """
    _need(set(data) == set(_REQUEST), "a request has other entries")
    _need(isinstance(data["messages"], list), "a request has no list of messages")
    for one in data["messages"]:
        _need(
            isinstance(one, dict)
            and set(one) == {"role", "text", "images"}
            and isinstance(one["text"], str)
            and isinstance(one["images"], list)
            and all(isinstance(image, dict) and "name" in image for image in one["images"]),
            "a message of a request is none",
        )


def check_description(data: Mapping[str, Any]) -> None:
    """See that plain data describes a model.

    Raises:
        ValueError: If it does not.
    """
    for name, value in data.items():
        kind = dict if name == "capabilities" else str
        _need(isinstance(value, kind), f"{name} of a model is no {kind.__name__}")
    _need("model" in data and "base_url" in data, "a model has no name or no server")


def _need(met: bool, otherwise: str) -> None:
    if not met:
        raise ValueError(otherwise)
