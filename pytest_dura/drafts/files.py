"""Files of drafts: written with their provenance, and signed by a person."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from yaml import SafeDumper

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.text import one_line
from pytest_dura.evidence.signing import Review
from pytest_dura.library.documents import RESOLVERS, parse_yaml, read_yaml, validate
from pytest_dura.library.requirements import read_requirements
from pytest_dura.requirements.drafts import (
    DRAFTED,
    NOT_REVIEWED,
    is_rejected,
    signed_source,
    unsigned_reason,
)
from pytest_dura.requirements.model import Requirement


@dataclass(frozen=True)
class Passed:
    """A draft that passed all checks.

    Args:
        requirement: The requirement.
        scenarios: Names of those in which it judges something.
        earned: What it catches, in words.
        prompt: SHA-256 of the messages that led to it.
    """

    requirement: Requirement
    scenarios: Sequence[str]
    earned: str
    prompt: str


ABOUT = (
    "Requirements that a language model drafted. A gate leaves each undecided until a person",
    "has signed it: python -m pytest_dura review FILE REVIEW.yaml",
)


def draft_file(
    passed: Sequence[Passed], sentence: str, model: str, server: str, about: Sequence[str] = ABOUT
) -> str:
    """Text of a requirement file: each requirement says that it is a draft, and whose.

    Args:
        passed: The drafts.
        sentence: That they were made of.
        model: Name of the model.
        server: Fingerprint of its server.
        about: What the drafts are, in the first lines.
    """
    head = [
        *about,
        f"Sentence: {one_line(sentence, 500)}",
        f"Model: {one_line(model)}, server {server}",
    ]
    entries = []
    for each in passed:
        source = (
            f"{NOT_REVIEWED}{model}, server {server[:12]}, prompt sha256:{each.prompt}; "
            f"{each.earned}"
        )
        entry = {name: getattr(each.requirement, name) for name in ("id", "text", "kind")}
        entry["source"] = " ".join(source.split())
        entry |= {name: getattr(each.requirement, name) for name in ("check", "reason")}
        entry["applies_to"] = list(each.scenarios)
        entries.append(entry)
    text = _text([f"# {line}" for line in head], {"requirements": entries})
    read_requirements(parse_yaml(text, "drafts"))  # as the session that uses the file will
    return text


class _Dumper(yaml.SafeDumper):
    """Quotes what any reader would take for something other than text, ours among them."""


_Dumper.yaml_implicit_resolvers = {
    first: [*SafeDumper.yaml_implicit_resolvers.get(first, ()), *RESOLVERS.get(first, ())]
    for first in {*SafeDumper.yaml_implicit_resolvers, *RESOLVERS}
}


def _text(head: Sequence[str], data: Mapping[str, Any]) -> str:
    body = yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)
    return "\n".join([*head, body])


def sign_drafts(file: Path, review: Review, only: Collection[str]) -> tuple[str, list[str]]:
    """Text of a file of drafts with a person's decision, and the ids that it is on.

    Args:
        file: The file.
        review: Who decided what, and when.
        only: Ids of drafts; by default all on which no person has decided, or that were changed.

    Raises:
        ConfigurationError: For a file without such a draft, and an id that is none.
    """
    document = read_yaml(file)
    located = read_requirements(document)
    known = {each.requirement.id: each.requirement for each in located}
    open_ones = [
        name for name, each in known.items()
        if each.source.startswith(DRAFTED) and unsigned_reason(each)
    ]  # fmt: skip
    waiting = [name for name in open_ones if not is_rejected(known[name])]
    unknown = sorted(set(only) - set(open_ones))
    if unknown or not (only or waiting):
        raise ConfigurationError(
            "there is no such draft to decide on",
            file=str(file),
            key="--only" if unknown else "requirements",
            found=", ".join(unknown) or "no draft that waits for a person",
            expected=", ".join(open_ones) or "a requirement whose source begins with `drafted, `",
            remedy="name one of these by --only, or another file",
        )
    chosen = [name for name in open_ones if name in only] if only else waiting
    if len(located) > len(known):
        twice = next(
            each for each in known if sum(place.requirement.id == each for place in located) > 1
        )
        raise ConfigurationError(
            f"the requirement {twice!r} stands in the file twice",
            file=str(file),
            key="requirements",
            found=twice,
            expected="each id once",
            remedy="remove or rename one of them",
        )
    lines = file.read_text("utf-8").splitlines()
    head = list(itertools.takewhile(lambda line: line.startswith("#"), lines))
    entries = [dict(each) for each in document.data["requirements"]]
    for entry in entries:
        if entry["id"] in chosen:
            entry["source"] = signed_source(
                known[entry["id"]],
                one_line(review.who, 200),
                review.when,
                one_line(review.what, 500),
                accepted=review.decision == "accepted",
            )
    return _text(head, {**document.data, "requirements": entries}), chosen


def read_review(file: Path) -> Review:
    """Read a review, as `sign --review` reads it.

    Raises:
        ConfigurationError: For what is none.
    """
    return validate(Review, read_yaml(file))
