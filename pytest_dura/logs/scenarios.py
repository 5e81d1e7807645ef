"""Scenarios from logs: what a log shows before it violates a formula, as a scenario file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.text import one_line
from pytest_dura.logs.episode import episode_of, log_spec, read_log_file, sampled
from pytest_dura.logs.mapping import read_mapping
from pytest_dura.logs.worlds import LOG_WORLDS
from pytest_dura.requirements.checks import read_formula
from pytest_dura.requirements.episode_verdicts import evaluate_episode

_WIDTH = 96


def scenario_file(
    file: str, mapping: Path | None, check: str, name: str, **how: Any
) -> tuple[str, list[str]]:
    """Make the text of a scenario file, and the sentences on it that stand there as well.

    Args:
        file: The log.
        mapping: Its mapping, which names a world.
        check: Formula that it violates.
        name: Of the scenario.
        how: ``before`` and ``road``, see :class:`~pytest_dura.logs.worlds.LogWorld`.

    Raises:
        ConfigurationError: For a log without poses, one that does not violate the formula, and one
            of which the domain can make no scenario.
    """
    read = read_mapping(mapping)
    if not read.world:
        raise ConfigurationError(
            "the mapping names no world",
            file=None if mapping is None else str(mapping),
            key="world",
            expected="a domain, such as `world: {driving: {}}`, and signals with poses",
            remedy="add it to the mapping",
        )
    ((world, options),) = read.world.items()
    recorded = read_log_file(file, read)
    step = read.time_step or recorded.step()
    episode = episode_of(recorded, log_spec(file, read, step))
    evaluation, problem = evaluate_episode(read_formula(check), episode)
    if evaluation is None or evaluation.status != "violated" or evaluation.time is None:
        raise ConfigurationError(
            "the log does not violate this formula",
            file=file,
            key="--check",
            found=problem if evaluation is None else evaluation.status,
            expected="a formula that the log violates at some time",
            remedy="name another one",
        )
    violated = round(evaluation.time / step)
    columns = {name: each.values for name, each in sampled(recorded, step)[1].items()}
    keys, assumed = LOG_WORLDS[world].scenario(columns, step, options, violated, **how)
    origin = f"{Path(file).name}, which violates {one_line(check)} at {evaluation.time:g} s"
    notes = [f"From {origin}.", *assumed]
    head = "".join(f"# {one_line(note)}\n" for note in notes)
    data = {"name": name, "description": f"What a log shows before a violation: {origin}."} | keys
    return head + yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=_WIDTH), notes
