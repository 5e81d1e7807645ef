"""Old public names of runner, verdicts and searches work for one version, with a warning."""

from __future__ import annotations

import pytest
from support.searches import falsification

from pytest_dura import Campaign, Runner
from pytest_dura.requirements import EpisodeVerdict

VERDICT = EpisodeVerdict(
    "R", "a#0", "C", "satisfied", 1.0, None, "", 2, 2, not_manifested=("ghost",)
)
SEARCH = falsification("falsified", "nothing found")


@pytest.mark.parametrize(
    "thing, old, new",
    [
        (VERDICT, "idle", "not_manifested"),
        (SEARCH, "idle", "not_manifested"),
        (SEARCH, "found", "violations"),
        (SEARCH.outcomes[0], "word", "status"),
        (Runner(dict), "again", "fetch"),
        (Runner(dict), "keep", "counterexamples"),
        (Campaign(Runner(dict), None, 1), "bench", "runner"),
    ],
)
def test_the_old_name_warns_and_gives_what_the_new_one_gives(thing, old, new):
    with pytest.warns(DeprecationWarning, match=rf"{type(thing).__name__}\.{old} is now {new};"):
        value = getattr(thing, old)
    assert value == getattr(thing, new)


def test_plain_data_keep_the_keys_of_the_record():
    plain = SEARCH.to_json()
    assert list(plain)[6:9] == ["unknown", "idle", "rule"]
    assert [list(outcome)[1:4] for outcome in plain["outcomes"]] == [
        ["check", "word", "simulations"]
    ] * 2
    assert VERDICT.to_json()["idle"] == ("ghost",)
    assert EpisodeVerdict.from_json(VERDICT.to_json()) == VERDICT
