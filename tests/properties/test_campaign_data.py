"""Laws of scenarios, cases and verdicts: what is written and read back is equal, and so on."""

from __future__ import annotations

import json
import string
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura import ConfigurationError, EpisodeSpec, RoleSpec
from pytest_dura.core.codec import decode, encode
from pytest_dura.library import Scenario, expand_cases, parse_yaml
from pytest_dura.requirements import (
    CampaignVerdict,
    EpisodeVerdict,
    Requirement,
    judge_campaign,
    lower_bound,
    runs_needed,
    upper_bound,
)
from pytest_dura.requirements.campaign_judge import CampaignJudge

relaxed = settings(derandomize=True, deadline=None, max_examples=60)
fewer = settings(relaxed, max_examples=30)

words = st.text(string.ascii_letters + string.digits, min_size=1, max_size=6)
numbers = st.floats(-1e9, 1e9) | st.integers(-(2**40), 2**40)
texts = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Zl", "Zp"]), max_size=8)
scalars = st.none() | st.booleans() | numbers | texts
plain = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=8,
)
positive = st.floats(0.2, 1e4)
paths = words.map(lambda name: f"package.module:{name}")


@st.composite
def scenario_data(draw: st.DrawFn) -> dict[str, Any]:
    low, high = sorted((draw(st.floats(-1e3, 1e3)), draw(st.floats(-1e3, 1e3))))
    data: dict[str, Any] = {
        "name": draw(st.lists(words, min_size=1, max_size=3).map("/".join)),
        "simulator": {"path": "package.module:Sim", "params": draw(st.dictionaries(words, plain))},
        "duration": draw(positive),
        "world": {"some": draw(st.floats(-1e3, 1e3)), **draw(st.dictionaries(words, plain))},
        "variation": {"world.some": {"min": low, "max": high}},
        "roles": {
            "generator": "package.module:Mine",
            "watch": draw(st.none() | st.fixed_dictionaries({"path": paths})),
        },
        "requirements": draw(st.lists(words, unique=True, max_size=3)),
    }
    optional = {
        "description": texts,
        "runs": st.integers(1, 999),
        "policy": st.sampled_from(["recover", "halt", "log_only", "refine(3)"]),
        "time_budget": st.none() | positive,
        "time_step": st.floats(0.001, 0.2),
        "end_at_violation": st.booleans(),
    }
    chosen = draw(st.sets(st.sampled_from(sorted(optional))))
    return data | {key: draw(optional[key]) for key in sorted(chosen)}


def read(data: Any) -> Scenario:
    return Scenario.from_document(parse_yaml(json.dumps(data, ensure_ascii=False), "some.yaml"))


@fewer
@given(plain)
def test_plain_data_reads_back_equal_with_its_types(value: Any) -> None:
    text = json.dumps({"key": value}, ensure_ascii=False)
    assert json.dumps(parse_yaml(text, "f").data["key"]) == json.dumps(value)


@fewer
@given(scenario_data())
def test_a_scenario_reads_back_equal(data: dict[str, Any]) -> None:
    scenario = read(data)
    assert read(scenario.plain()) == scenario
    assert Scenario.model_validate(scenario.model_dump(mode="json")) == scenario


@relaxed
@given(scenario_data(), st.integers(0, 2**40), st.integers(0, 50))
def test_a_spec_is_a_function_of_its_inputs_and_reads_back_equal(
    data: dict[str, Any], base_seed: int, run: int
) -> None:
    data["simulator"] = "thermostat:Thermostat"
    specs = []
    for scenario in (read(data), read(read(data).plain())):
        (case,) = expand_cases([scenario])
        specs.append(case.spec(run, base_seed, {"watch": RoleSpec("a:Watch")}))
    assert specs[0] == specs[1]
    assert specs[0].key == specs[1].key
    assert EpisodeSpec.from_json(json.loads(json.dumps(specs[0].to_json()))) == specs[0]
    low, high = data["variation"]["world.some"].values()
    assert low <= specs[0].scenario["world"]["some"] <= high


@relaxed
@given(st.text(max_size=80) | st.text("a:-[]{}&*!#'\"|> \n0", max_size=80))
def test_any_text_is_data_or_one_clear_error(text: str) -> None:
    error = None
    try:
        document = parse_yaml(text, "some.yaml")
    except ConfigurationError as caught:
        error = caught
    if error is not None:
        assert error.file == "some.yaml"
        assert error.line is not None
        assert error.remedy is not None
    else:
        json.dumps(document.data, allow_nan=False)
        assert set(document.data) <= set(document.lines)


@st.composite
def verdicts(draw: st.DrawFn) -> list[EpisodeVerdict]:
    found = draw(
        st.lists(st.sampled_from(["satisfied", "violated", "invalid", "missing"]), max_size=30)
    )
    margins = st.none() | st.floats(-10, 10)
    return [
        EpisodeVerdict("R", f"c#{run}", "P", word, draw(margins), None, "", 10, 10)  # type: ignore[arg-type]
        for run, word in enumerate(found)
    ]


rates = st.none() | st.floats(0.01, 0.9)


@relaxed
@given(verdicts(), st.integers(0, 40), rates)
def test_the_counts_of_a_campaign_add_up(
    found: list[EpisodeVerdict], planned: int, at_most: float | None
) -> None:
    verdict = judge_campaign(Requirement("R", at_most=at_most), "c", found, planned=planned)
    assert verdict.run == len(found) == verdict.episodes + verdict.invalid + verdict.missing
    assert verdict.violations == len(verdict.counterexamples) <= verdict.episodes
    assert decode(CampaignVerdict, json.loads(json.dumps(encode(verdict)))) == verdict
    if verdict.verdict == "supported":
        assert not verdict.missing
        assert verdict.run >= planned
        assert verdict.episodes > 0


@relaxed
@given(verdicts(), st.integers(0, 40), rates)
def test_the_status_alone_is_that_of_the_whole_verdict(
    found: list[EpisodeVerdict], planned: int, at_most: float | None
) -> None:
    judge = CampaignJudge(Requirement("R", at_most=at_most), "c", planned=planned)
    for each in found:
        judge.add(each)
    assert judge.status == judge.verdict().verdict


@relaxed
@given(verdicts(), st.integers(0, 40), rates)
def test_the_gate_fails_closed_whatever_is_lost(
    found: list[EpisodeVerdict], planned: int, at_most: float | None
) -> None:
    planned = max(planned, len(found))
    whole = judge_campaign(Requirement("R", at_most=at_most), "c", found, planned=planned)
    part = judge_campaign(Requirement("R", at_most=at_most), "c", found[:-1], planned=planned)
    if found:
        assert part.verdict != "supported"
    if at_most is None and part.verdict == "violated":
        assert whole.verdict == "violated"


@relaxed
@given(st.integers(0, 300), st.integers(1, 300), st.floats(0.5, 0.999))
def test_the_bounds_enclose_the_observed_rate(k: int, n: int, confidence: float) -> None:
    k = min(k, n)
    assert lower_bound(k, n, confidence) <= k / n <= upper_bound(k, n, confidence)
    assert upper_bound(k, n + 1, confidence) <= upper_bound(k, n, confidence)


@relaxed
@given(st.floats(0.005, 0.9), st.floats(0.5, 0.99), st.integers(0, 5))
def test_the_runs_needed_are_the_least(at_most: float, confidence: float, violations: int) -> None:
    n = runs_needed(at_most, confidence, violations)
    assert upper_bound(violations, n, confidence) <= at_most
    assert n == violations + 1 or upper_bound(violations, n - 1, confidence) > at_most
