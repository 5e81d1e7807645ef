"""Laws of the split of a session into shards."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.evidence import ShardUnit, plan_digest, split_units

lawful = settings(derandomize=True, deadline=None, max_examples=50)
units = st.lists(
    st.builds(
        ShardUnit.of,
        st.sampled_from(["case", "test"]),
        st.text(min_size=1, max_size=6),
        st.lists(st.text(max_size=8), min_size=1, max_size=4),
        st.integers(0, 500),
    ),
    unique_by=lambda one: one.key,
    max_size=30,
)
counts = st.integers(1, 9)


@lawful
@given(units, counts)
def test_each_unit_is_in_exactly_one_shard(all_units, count):
    shards = split_units(all_units, count)
    assert len(shards) == count
    found = [unit for shard in shards for unit in shard]
    assert sorted(found, key=lambda one: one.key) == sorted(all_units, key=lambda one: one.key)


@lawful
@given(units, counts, st.randoms(use_true_random=False))
def test_the_order_of_the_units_changes_nothing(all_units, count, random):
    shuffled = list(all_units)
    random.shuffle(shuffled)
    assert split_units(shuffled, count) == split_units(all_units, count)
    assert plan_digest(shuffled) == plan_digest(all_units)


@lawful
@given(units, counts)
def test_no_shard_has_more_than_its_share_and_one_unit(all_units, count):
    loads = [sum(one.episodes for one in shard) for shard in split_units(all_units, count)]
    largest = max((one.episodes for one in all_units), default=0)
    assert max(loads) <= sum(loads) / count + largest * (1 - 1 / count) + 1e-9
    if len(all_units) >= count and all(one.episodes for one in all_units):
        assert max(loads) - min(loads) <= largest


@lawful
@given(units, counts)
def test_a_shard_is_empty_only_if_there_are_fewer_units_than_shards(all_units, count):
    empty = sum(not shard for shard in split_units(all_units, count))
    assert empty == max(0, count - len(all_units))


@lawful
@given(units.filter(bool), st.data())
def test_whatever_changes_is_another_plan(all_units, data):
    place = data.draw(st.integers(0, len(all_units) - 1))
    one = all_units[place]
    key, value = data.draw(
        st.sampled_from(
            [("episodes", one.episodes + 1), ("items", one.items + 1), ("digest", "0" * 64),
             ("name", one.name + "x")]
        )
    )  # fmt: skip
    rest = all_units[:place] + all_units[place + 1 :]
    assert plan_digest([*rest, replace(one, **{key: value})]) != plan_digest(all_units)
    assert plan_digest(rest) != plan_digest(all_units)
