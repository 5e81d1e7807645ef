"""What an item decided goes on without secrets, and as it is where there are none."""

from __future__ import annotations

from pytest_dura.evidence import Redactor
from pytest_dura.plugin.items.outcomes import Decided, ItemResult
from pytest_dura.requirements import EpisodeVerdict, Requirement

SECRET = "f0f1f2f3f4f5a6a7"


def decided(detail: str) -> Decided:
    verdict = EpisodeVerdict("R", "c#0", "P", "violated", -1.0, 0.5, detail, 10, 10)
    results = [ItemResult(Requirement("R", text="It holds.")), ItemResult(Requirement("S"))]
    return Decided([ItemResult(Requirement("R", text=detail), judged=verdict), *results], {"S"})


def test_no_part_of_a_result_keeps_a_secret() -> None:
    redactor = Redactor.of_environment({"RIG_KEY": SECRET})
    found = decided(f"the key {SECRET} is gone").without_secrets(redactor.redact)
    first, *others = found.results
    expected = "the key [redacted: RIG_KEY] is gone"
    assert first.judged is not None
    assert (first.requirement.text, first.judged.detail) == (expected, expected)
    assert (first.judged.margin, first.judged.episode) == (-1.0, "c#0")
    assert (others, found.searched) == (decided("").results[1:], {"S"})


def test_what_has_no_secret_stays_the_same_object() -> None:
    redactor, known = Redactor.of_environment({"RIG_KEY": SECRET}), decided("all is well")
    assert known.without_secrets(redactor.redact) is known
