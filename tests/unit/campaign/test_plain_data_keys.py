"""Plain data of verdicts and searches have the keys of the record."""

from __future__ import annotations

from support.searches import falsification

from pytest_dura.requirements import EpisodeVerdict

VERDICT = EpisodeVerdict(
    "R", "a#0", "C", "satisfied", 1.0, None, "", 2, 2, not_manifested=("ghost",)
)
SEARCH = falsification("falsified", "nothing found")


def test_plain_data_keep_the_keys_of_the_record():
    plain = SEARCH.to_json()
    assert list(plain)[6:9] == ["unknown", "idle", "rule"]
    assert [list(outcome)[1:4] for outcome in plain["outcomes"]] == [
        ["check", "word", "simulations"]
    ] * 2
    assert VERDICT.to_json()["idle"] == ("ghost",)
    assert EpisodeVerdict.from_json(VERDICT.to_json()) == VERDICT
