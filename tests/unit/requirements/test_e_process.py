"""The e-process against numerical integration, and the proofs of its docstring on grids."""

from __future__ import annotations

import math

import numpy as np
import pytest
from characteristics import operating_characteristics
from scipy.integrate import quad

from pytest_dura.core import ConfigurationError
from pytest_dura.requirements import EProcess
from pytest_dura.requirements.rate_tests import log_e_value


def integrated(k, n, rate, side):
    """The e-value by quadrature over x = arcsin(sqrt(q)), in which Jeffreys' prior is uniform."""
    turn = math.asin(math.sqrt(rate))
    low, high = (0.0, turn) if side == "below" else (turn, math.pi / 2)

    def ratio(x):
        q = math.sin(x) ** 2
        return (q / rate) ** k * ((1 - q) / (1 - rate)) ** (n - k)

    return quad(ratio, low, high, epsabs=0, epsrel=1e-10, limit=200)[0] / (high - low)


@pytest.mark.parametrize("side", ["below", "above"])
def test_the_e_value_is_the_averaged_likelihood_ratio(side) -> None:
    for k, n in [(0, 1), (1, 1), (0, 74), (3, 60), (9, 60), (20, 200)]:
        for rate in (0.01, 0.05, 0.1, 0.5, 0.9):
            expected = math.log(integrated(k, n, rate, side))
            assert log_e_value(k, n, rate, side) == pytest.approx(expected, rel=1e-8, abs=1e-8)


def test_before_any_episode_the_e_value_is_one() -> None:
    for side in ("below", "above"):
        assert log_e_value(0, 0, 0.05, side) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("limit", [0.02, 0.05, 0.4])
@pytest.mark.parametrize("side", ["below", "above"])
def test_the_e_value_does_not_grow_in_the_mean_at_any_rate_of_the_hypothesis(limit, side) -> None:
    outwards = [limit, *(np.linspace(limit, 1.0 if side == "below" else 0.0, 6)[1:])]
    for n in (0, 1, 7, 50):
        for k in range(0, n + 1, max(1, n // 5)):
            now = math.exp(log_e_value(k, n, limit, side))
            bad, clean = (math.exp(log_e_value(k + j, n + 1, limit, side)) for j in (1, 0))
            means = [p * bad + (1 - p) * clean for p in outwards]
            assert means[0] == pytest.approx(now, rel=1e-9)
            assert all(mean < now for mean in means[1:])


@pytest.mark.parametrize(
    "limit, confidence, runs",
    [(0.05, 0.95, 74), (0.1, 0.95, 36), (0.05, 0.9, 59), (0.05, 0.99, 109)],
)
def test_the_clean_runs_that_certify_a_limit(limit, confidence, runs) -> None:
    test = EProcess(limit, confidence)
    decisions = [test.update(False) for _ in range(runs)]
    assert decisions == [None] * (runs - 1) + ["supported"]
    assert integrated(0, runs, limit, "below") >= 1 / (1 - confidence)
    assert integrated(0, runs - 1, limit, "below") < 1 / (1 - confidence)
    assert test.upper <= limit


@pytest.mark.parametrize("side", ["below", "above"])
def test_the_rejected_rates_are_those_past_the_bound(side) -> None:
    rates = np.linspace(0.001, 0.999, 400)
    for n in (1, 2, 3, 10, 60):
        for k in sorted({0, 1, n // 3, n - 1, n}):
            values = np.array([log_e_value(k, n, rate, side) for rate in rates])
            rejected = values >= math.log(2.0)
            one_way = rejected if side == "below" else rejected[::-1]
            assert np.all(np.diff(one_way.astype(int)) >= 0), (k, n)


def test_the_bounds_invert_the_tests() -> None:
    test, looks = EProcess(0.15, 0.95), []
    for violated in [True] + [False] * 12 + [True, True] + [False] * 4 + [True]:
        assert test.update(violated) is None
        looks.append((test.violations, test.episodes))

        def greatest(rate, side):
            return max(log_e_value(k, n, rate, side) for k, n in looks)

        if not violated:
            assert greatest(test.upper * (1 - 1e-9), "below") < math.log(20)
            assert greatest(test.upper, "below") >= math.log(20)
        if test.lower > 0.0:
            assert greatest(test.lower * (1 + 1e-9), "above") < math.log(20)
            assert greatest(test.lower, "above") >= math.log(20)
    assert 0.0 < test.lower < 0.15 < test.upper < 0.5


@pytest.mark.parametrize("stretches", [[29], [0, 37], [0, 50, 55]])
def test_decision_and_bound_agree_at_limits_that_differ_in_the_last_digit(stretches) -> None:
    """Around the bound, rounding makes the e-value rise and fall from one number to the next."""
    *before, last = stretches
    episodes = [violated for clean in before for violated in [*[False] * clean, True]]
    episodes += [False] * last
    anywhere = EProcess(0.07, 0.95)
    for violated in episodes:
        anywhere.update(violated)
    limit, decisions = anywhere.upper, set()
    for _ in range(15):
        limit = math.nextafter(limit, 0.0)
    for _ in range(30):
        test = EProcess(limit, 0.95)
        for violated in episodes:
            decision = test.update(violated)
        assert (decision == "supported") == (test.upper <= limit)
        decisions.add(decision)
        limit = math.nextafter(limit, 1.0)
    assert decisions == {None, "supported"}


def test_the_upper_bound_keeps_what_earlier_looks_have_shown() -> None:
    test = EProcess(0.02, 0.95)
    for _ in range(40):
        test.update(False)
    shown = test.upper
    test.update(True)
    assert test.upper == shown < EProcess(0.02, 0.95).upper == 1.0


def test_the_lower_bound_keeps_what_earlier_looks_have_shown() -> None:
    test = EProcess(0.9, 0.95)
    for _ in range(3):
        test.update(True)
    shown = test.lower
    test.update(False)
    assert test.lower == shown > 0.2


@pytest.mark.parametrize("rate", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("confidence", [0.9, 0.95])
def test_looking_always_at_the_upper_bound_keeps_its_confidence(rate, confidence) -> None:
    """Some bound ever falls to the true rate or below exactly if that rate is ever supported."""
    found = operating_characteristics(EProcess(rate, confidence), rate, budget=250)
    assert 0.0 < found.supported <= 1 - confidence
    assert 0.0 < found.violated <= 1 - confidence


def test_a_share_that_underflows_is_no_evidence() -> None:
    assert log_e_value(4000, 4000, 0.001) == -math.inf
    assert log_e_value(0, 400_000, 0.5, "above") == -math.inf
    assert math.isfinite(log_e_value(3, 400_000, 1e-5))


@pytest.mark.parametrize(
    "limit, confidence, key", [(0.0, 0.95, "limit"), (0.05, 0.5, "confidence")]
)
def test_parameters_that_make_no_sense(limit, confidence, key) -> None:
    with pytest.raises(ConfigurationError) as caught:
        EProcess(limit, confidence)
    assert caught.value.key == key
