"""Laws of the sequential tests of a rate, whatever the episodes say."""

from __future__ import annotations

from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pytest_dura.requirements import (
    METHODS,
    SequentialTest,
    compare_counts,
    make_test,
    mcnemar,
    mcnemar_one_sided,
)

law = settings(derandomize=True, deadline=None, max_examples=120)
brief = settings(law, max_examples=60)

PLANNED = 90
parameters = st.tuples(
    st.sampled_from(METHODS), st.floats(0.02, 0.9), st.sampled_from([0.6, 0.9, 0.95, 0.99])
)
outcomes = st.one_of(
    st.lists(st.booleans(), min_size=1, max_size=PLANNED),
    st.lists(st.sampled_from([False] * 12 + [True]), min_size=1, max_size=PLANNED),
)


def fresh(chosen: tuple[str, float, float]) -> SequentialTest:
    method, limit, confidence = chosen
    p0 = limit / 4 if method == "sprt" else None
    return make_test(method, limit, confidence, p0=p0, planned=PLANNED)


def fed(chosen: tuple[str, float, float], episodes: list[bool]) -> SequentialTest:
    """The test after these episodes, or after those up to its decision."""
    test = fresh(chosen)
    for violated in episodes:
        if test.update(violated) is not None:
            break
    return test


@law
@given(parameters, outcomes)
def test_the_decision_agrees_with_the_bounds_after_every_episode(chosen, episodes) -> None:
    (method, limit, _), test = chosen, fresh(chosen)
    for violated in episodes:
        decision = test.update(violated)
        assert (decision == "supported") == (test.upper is not None and test.upper <= limit)
        if method == "fixed":
            assert (decision == "violated") == (test.lower > limit)
        elif method == "e-process":
            assert (decision == "violated") == (test.lower >= limit)
        else:
            assert (decision == "violated") == (test.lower == limit / 4)
        if decision:
            break


@brief
@given(parameters, outcomes)
def test_bounds_only_become_sharper(chosen, episodes) -> None:
    assume(chosen[0] != "sprt")
    test = fresh(chosen)
    upper, lower = test.upper, test.lower
    assert (upper, lower) == (1.0, 0.0)
    for violated in episodes:
        decision = test.update(violated)
        assert 0.0 <= lower <= test.lower <= 1.0
        assert 1.0 >= upper >= test.upper >= 0.0
        upper, lower = test.upper, test.lower
        if decision:
            break


@brief
@given(st.floats(0.02, 0.5), st.sampled_from([0.6, 0.95]), outcomes)
def test_a_long_clean_stretch_lowers_the_upper_bound(limit, confidence, episodes) -> None:
    test = fed(("e-process", limit, confidence), episodes)
    assume(test.decision is None)
    before = test.upper
    while test.decision is None:
        test.update(False)
    assert test.decision == "supported"
    assert test.upper <= limit < before


@brief
@given(parameters, outcomes, st.randoms(use_true_random=False))
def test_order_matters_up_to_the_crossing_only(chosen, episodes, random) -> None:
    other = list(episodes)
    random.shuffle(other)
    one, two = fed(chosen, episodes), fed(chosen, other)
    assume(one.episodes == two.episodes == len(episodes))
    assert one.violations == two.violations
    assert one.decision == two.decision


@brief
@given(parameters, outcomes, st.data())
def test_a_clean_episode_in_place_of_a_violating_one_never_hurts(chosen, episodes, data) -> None:
    index = data.draw(st.integers(0, len(episodes) - 1))
    better = fed(chosen, [*episodes[:index], False, *episodes[index + 1 :]])
    worse = fed(chosen, [*episodes[:index], True, *episodes[index + 1 :]])
    if worse.decision == "supported":
        assert better.decision == "supported"
        assert better.episodes <= worse.episodes
    if better.decision == "violated":
        assert worse.decision == "violated"
        assert worse.episodes <= better.episodes


@law
@given(st.floats(0.02, 0.9), st.sampled_from([0.6, 0.95]), outcomes)
def test_a_fixed_design_is_hopeless_where_the_best_rest_does_not_help(
    limit, confidence, episodes
) -> None:
    test = fed(("fixed", limit, confidence), episodes)
    hopeless = test.hopeless
    while test.decision is None and test.episodes < PLANNED:
        test.update(False)
    assert hopeless == (test.decision != "supported")


@law
@given(parameters, outcomes)
def test_a_decision_takes_no_further_episode(chosen, episodes) -> None:
    test = fed(chosen, episodes)
    assume(test.decision is not None)
    before = (test.violations, test.episodes, test.decision, test.upper, test.lower)
    for violated in (True, False):
        try:
            test.update(violated)
        except RuntimeError:
            continue
        raise AssertionError("an episode after the decision was counted")
    assert before == (test.violations, test.episodes, test.decision, test.upper, test.lower)


counts = st.integers(0, 60).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


@law
@given(counts, counts)
def test_what_is_better_one_way_is_worse_the_other_way(one, two) -> None:
    there, back = compare_counts(*one, *two), compare_counts(*two, *one)
    assert (there.p_better, there.p_worse) == (back.p_worse, back.p_better)
    opposite = {"better": "worse", "worse": "better"}
    assert back.status == opposite.get(there.status, there.status)
    assert there.p_better + there.p_worse >= 1.0


@law
@given(st.integers(0, 200), st.integers(0, 200))
def test_mcnemar_does_not_know_which_comes_first(first, second) -> None:
    assert mcnemar(first, second) == mcnemar(second, first)
    assert mcnemar_one_sided(first, second) + mcnemar_one_sided(second, first) >= 1.0
    assert mcnemar_one_sided(first + 1, second) <= mcnemar_one_sided(first, second)
