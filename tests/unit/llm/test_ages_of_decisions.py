"""How old a language model's decisions are when they come into force, from answer to metrics."""

from __future__ import annotations

from models import llm_episode, said

from pytest_dura.llm import Answer

REALTIME = {"clock": "realtime", "decide_every": 10}


def taking(*seconds, failure=None, failing=()):
    """Answers that take so long, in turn; those with these numbers fail."""

    def answers(_, number):
        took = seconds[number % len(seconds)]
        if number in failing:
            return Answer(failure=failure, detail="it did", seconds=took)
        return Answer(said(), seconds=took)

    return answers


def test_in_real_time_an_action_is_as_old_as_the_first_tick_after_its_answer():
    episode, _ = llm_episode(taking(0.35, 0.6, 0.0, 0.9), REALTIME, seconds=4.0)
    assert episode.failure is None
    assert episode.metrics.answer_ages == [0.4, 0.6, 0.0, 0.9]
    assert episode.metrics.answer_seconds == [0.35, 0.6, 0.0, 0.9]


def test_in_frozen_time_an_action_is_never_old():
    episode, _ = llm_episode(taking(0.35, 2.0), {"decide_every": 5}, seconds=1.5)
    assert episode.metrics.answer_ages == [0.0, 0.0, 0.0]


def test_a_decision_that_never_lands_has_no_age():
    episode, model = llm_episode(taking(0.3, 4.0), REALTIME, seconds=2.0)
    assert len(model.requests) == 2
    assert episode.metrics.answer_ages == [0.3]


def test_the_fallback_after_a_failure_has_no_age():
    answers = taking(0.3, failure="timeout", failing=(1,))
    episode, _ = llm_episode(answers, REALTIME, seconds=3.0)
    assert episode.metrics.tallies["timeout"].hits == 1
    assert episode.metrics.answer_seconds == [0.3, 0.3, 0.3]
    assert episode.metrics.answer_ages == [0.3, 0.3]


def test_equal_answers_give_equal_ages_and_digests():
    one, two, slower = (
        llm_episode(taking(took), REALTIME, seconds=2.0)[0] for took in (0.3, 0.3, 0.4)
    )
    assert one.metrics.answer_ages == two.metrics.answer_ages != slower.metrics.answer_ages
    assert one.digest == two.digest != slower.digest
