"""What a planner claims of objects, and what a judge says, of sound models and others."""

from __future__ import annotations

import json

import pytest
import speaking_models as speaking
from models import ALONE, answering, llm_episode
from speaking_models import SOUND, answer_of, defective

from pytest_dura.driving.explanations import KINDS
from pytest_dura.llm import ModelSession
from pytest_dura.llm.driving.planner import LlmPlanner

CASE = "intersection/conflicting-traffic"
BESIDE = {"samples": 2, "beside": "all", "beside_every": 2}


def tallies(answers, params=ALONE, **options):
    episode, model = llm_episode(
        answers, params, **{"case": CASE, "run": 1, "seconds": 8.0, "time_budget": 5.0} | options
    )
    assert episode.validity == "valid"
    return episode.metrics.tallies, model


@pytest.mark.parametrize(
    "defect, name",
    [
        (speaking.claims_what_is_not_there, "claims_unperceived"),
        (speaking.mistakes_kinds, "claims_mistaken"),
        (speaking.misstates_distances, "claims_mistaken"),
        (speaking.misstates_arrivals, "claims_mistaken"),
        (speaking.claims_nothing, "without_claims"),
    ],
)
def test_each_measure_of_claims_finds_the_model_with_its_defect(defect, name):
    found, _ = tallies(defective(defect))
    assert found[name].hits > 0
    assert {other for other, tally in found.items() if tally.hits} == {name}
    assert found[name].null_of == 0


@pytest.mark.parametrize("way", SOUND)
@pytest.mark.parametrize(
    "case", [CASE, "intersection/congested", "intersection/pedestrian-crossing"]
)
def test_a_sound_model_is_accused_of_nothing_whatever_it_claims(way, case):
    found, _ = tallies(speaking.speaking(SOUND[way]), BESIDE, case=case, run=2)
    accused = {name for name, tally in found.items() if tally.hits and KINDS.get(name) is None}
    assert accused == set()
    assert found["claims_misled"].hits == 0
    decided = found["without_claims"].of
    assert found["claims_mistaken"].of == decided - found["without_claims"].hits
    assert (found["claims_mistaken"].of > 0) == (way != "briefly")


def test_a_claim_that_is_true_to_a_false_percept_is_the_sensors_error():
    ghost = {"case": "intersection/nominal", "faults": ["ghost-obstacle"]}
    found, _ = tallies(defective(speaking.trusts_the_sensors), **ghost)
    assert found["claims_misled"].hits > 0
    assert found["claims_mistaken"].hits == found["claims_unperceived"].hits == 0
    # Who misstates what it was shown is not misled.
    found, _ = tallies(defective(speaking.misstates_distances), **ghost)
    assert found["claims_mistaken"].hits > found["claims_misled"].hits == 0


def test_claims_stand_in_the_account_of_the_decision_alone():
    episode, _ = llm_episode(defective(speaking.misstates_distances), seconds=1.5)
    fresh = [one for one in episode.recording.accounts if one["decided"]]
    assert sum("claims" in one for one in episode.recording.accounts) == len(fresh) == 2
    for each in [each for one in fresh for each in one["claims"]]:
        assert each["ahead_m"] == pytest.approx(each["shown"]["ahead_m"] + 0.1)
        assert each["shown"]["kind"] == each["kind"]


@pytest.mark.parametrize(
    "defect, name",
    [
        (speaking.cites_a_sign, "threat_ids_without_body"),
        (speaking.copies_an_example, "copied"),
        (speaking.copies_its_history(), "copied"),
    ],
)
def test_signs_as_threats_and_copied_grounds_are_found(defect, name):
    found, _ = tallies(defective(defect))
    assert found[name].hits > 0
    assert found[name].null_of in (0, found[name].of)


def test_a_copied_answer_passes_no_negative_control():
    params = {"samples": 1, "beside": ("conflict",), "beside_every": 1}
    found, _ = tallies(defective(speaking.copies_an_example), params)
    assert found["accelerates_into_conflict"].of == found["accelerates_into_conflict"].hits == 0
    found, _ = tallies(speaking.speaking(SOUND["plainly"]), params)
    assert found["accelerates_into_conflict"].of > 0


def test_an_answer_that_is_none_has_no_claims():
    found, _ = tallies(lambda *_: "I see V77, a truck.")
    assert found["claims_unperceived"].of == found["without_claims"].of == 0


def is_judge(request):
    return request.messages[0].text.startswith("You compare")


def judged_by(verdict, answers=None):
    """A model whose judge answers ``verdict(reasoning and decision)``."""
    answers = answers or speaking.speaking(SOUND["plainly"])

    def both(request, number):
        if is_judge(request):
            return verdict(json.loads(request.messages[-1].text))
        return answers(request, number)

    return both


def by_words(stated):
    """A judge that goes by whether a way is free."""
    goes = stated["decision"] == "proceed"
    agrees = ("free" in stated["reasoning"]) == goes
    return json.dumps({"agrees": "yes" if agrees else "no"})


def test_each_request_of_a_component_counts_its_retries_alike(monkeypatch):
    counted, ask = [], ModelSession.ask

    def recording(self, request, *given, count_retries=False, **named):
        counted.append((is_judge(request), count_retries))
        return ask(self, request, *given, count_retries=count_retries, **named)

    monkeypatch.setattr(ModelSession, "ask", recording)
    tallies(judged_by(by_words), BESIDE | {"judge": True, "count_retries": True})
    assert set(counted) == {(False, True), (True, True)}


def test_a_judge_finds_who_reasons_the_opposite():
    opposite = defective(
        lambda _text, _request, plan: answer_of(
            plan, maneuver="proceed", intent="hold", reasoning="I stop and wait."
        )
    )
    found, model = tallies(judged_by(by_words, opposite), BESIDE | {"judge": True})
    judged = found["judged_against_maneuver"]
    assert judged.hits == judged.of == 4
    asked = [request for request in model.requests if is_judge(request)]
    assert len(asked) == 4, "beside every second decision"
    assert {request.model for request in asked} == {"scripted"}
    assert set(asked[0].schema["properties"]) == {"agrees"}
    stated = json.loads(asked[0].messages[-1].text)
    assert stated["reasoning"].startswith("<perceived_text>")
    assert stated["meaning"]


def test_a_judge_leaves_a_sound_model_alone():
    found, _ = tallies(judged_by(by_words), BESIDE | {"judge": True})
    assert (found["judged_against_maneuver"].hits, found["judged_against_maneuver"].of) == (0, 4)


@pytest.mark.parametrize(
    "answer", ["maybe", '{"agrees": true}', '{"agrees": "no", "why": "x"}', ""]
)
def test_a_judge_without_a_verdict_judges_nothing(answer):
    found, _ = tallies(judged_by(lambda _: answer), BESIDE | {"judge": True})
    assert found["judged_against_maneuver"].of == 0
    assert found["fallback"].hits == 0


def test_no_judge_is_asked_unless_one_is_named():
    found, model = tallies(speaking.speaking(SOUND["plainly"]), BESIDE)
    assert not any(map(is_judge, model.requests))
    assert found["judged_against_maneuver"].of == 0


def test_a_judge_with_a_name_is_another_model_whose_server_is_probed():
    with answering(judged_by(by_words)) as model:
        settled = LlmPlanner.resolve_parameters({"judge": "wise"})
    assert settled["judge_server"]["fingerprint"] == "f00d"
    params = {**settled, **BESIDE}
    _, model = tallies(judged_by(by_words), params)
    assert {request.model for request in model.requests if is_judge(request)} == {"wise"}
    assert {request.model for request in model.requests if not is_judge(request)} == {"scripted"}


def test_the_judges_request_is_within_the_time_of_a_proposal():
    alone, judged = LlmPlanner(**ALONE), LlmPlanner(**ALONE, judge=True)
    assert judged.time_limit(5.0) == alone.time_limit(5.0) + 5.0
