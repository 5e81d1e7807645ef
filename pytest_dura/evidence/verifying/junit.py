"""Whether a JUnit file of the same session states the record's verdicts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from pytest_dura.evidence.formats.junit_results import (
    Key,
    junit_key,
    junit_outcomes,
    junit_verdicts,
)
from pytest_dura.evidence.record.session_record import SessionRecord


def junit_problems(record: SessionRecord, file: Path) -> Iterator[str]:
    """Everything in which the file differs from the record.

    An undecided verdict may lack in it: the item of a worker that died reports nothing. And it may
    be more in it: what two runs of one episode that differ make undecided is known at the end.
    """
    try:
        xml = file.read_text(encoding="utf-8")
        stated, outcomes = junit_verdicts(xml), junit_outcomes(xml)
    except (OSError, ValueError, LookupError) as error:
        yield f"{file.name}: cannot be read back ({type(error).__name__}: {error})"
        return
    held: dict[Key, list[str]] = defaultdict(list)
    for one in record["verdicts"]:
        key = junit_key(one["case"], one["requirement"], one["item"])
        name = f"{file.name}: {one['requirement']} on {one['case']}"
        if key in outcomes:
            told, run = outcomes[key]["violated"], outcomes[key].total()
            if (told, run) != (one["violations"], one["run"]):
                yield (
                    f"{name}: {told} of {run} violated it, and the record says "
                    f"{one['violations']} of {one['run']}"
                )
        else:
            held[key].append(one["verdict"])
    for key in sorted({*stated, *held}):
        words, known = stated.get(key, ()), sorted(held.get(key, []))
        decided = [one for one in known if one != "undecided"]
        left = list(words)
        for word in decided:
            if word in left:
                left.remove(word)
            else:
                yield f"{file.name}: {key[1]} on {key[0]} is {word} in the record, and not here"
        if len(left) > known.count("undecided"):
            yield f"{file.name}: {key[1]} on {key[0]} is {left[0]}, and not in the record"
        elif "violated" in left:
            yield f"{file.name}: {key[1]} on {key[0]} is violated, and undecided in the record"
