"""Examples before the question: blocks, and the answer to them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.llm.answers import read_answer
from pytest_dura.llm.port import Answer
from pytest_dura.llm.prompts.perceived import PerceivedText
from pytest_dura.llm.prompts.prompt import Block

PERCEIVED = "perceived"
"""``{perceived: ...}`` stands for a text of the scene."""


@dataclass(frozen=True)
class Example:
    """A pair of question and answer.

    Args:
        blocks: Of the question.
        answer: JSON, on one line.
        line: Where it begins in its file.
    """

    blocks: tuple[Block, ...]
    answer: str
    line: int


def read_examples(text: str, file: str, schema: Mapping[str, Any]) -> tuple[Example, ...]:
    """The pairs of a file: a list of ``blocks`` (facts by name) and ``answer``.

    Raises:
        ConfigurationError: For what is no such list, and an answer that a model might not give;
            with file and line.
    """
    import yaml

    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        data = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        told = getattr(error, "problem", None) or str(error)
        raise _refused(f"no YAML: {told}", file, mark and mark.line + 1) from None
    if data is None or node is None:
        return ()
    if not isinstance(data, list):
        raise _refused("the examples are no list", file, 1)
    return tuple(
        _example(one, file, start.start_mark.line + 1, schema)
        for one, start in zip(data, node.value, strict=True)
    )


def _example(data: Any, file: str, line: int, schema: Mapping[str, Any]) -> Example:
    if not isinstance(data, dict) or set(data) != {"blocks", "answer"}:
        raise _refused("an example has `blocks` and `answer`, and nothing else", file, line)
    blocks, said = data["blocks"], data["answer"]
    if not isinstance(blocks, dict) or not all(
        isinstance(name, str) and isinstance(facts, dict) for name, facts in blocks.items()
    ):
        raise _refused("`blocks` are facts by the block's name", file, line)
    try:
        answer = json.dumps(said, ensure_ascii=False)
    except (TypeError, ValueError) as error:
        raise _refused(f"the answer is no JSON: {error}", file, line) from None
    reading = read_answer(Answer(answer), schema)
    if not reading.answered:
        raise _refused(f"the answer is {reading.outcome}: {reading.detail}", file, line)
    made = tuple(Block(name, _with_texts(facts)) for name, facts in blocks.items())
    return Example(made, answer, line)


def _with_texts(value: Any) -> Any:
    """Plain data with the texts of the scene marked as such."""
    if isinstance(value, dict):
        if set(value) == {PERCEIVED}:
            return PerceivedText(value[PERCEIVED])
        return {key: _with_texts(one) for key, one in value.items()}
    if isinstance(value, list):
        return tuple(map(_with_texts, value))
    return value


def _refused(problem: str, file: str, line: int | None) -> ConfigurationError:
    return ConfigurationError(
        problem,
        file=file,
        line=line,
        expected="- {blocks: {NAME: facts}, answer: an object that the answer's schema accepts}",
        remedy="correct the example, or remove the file for the built-in ones",
    )
