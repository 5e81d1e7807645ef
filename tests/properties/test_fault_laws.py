"""The law of each fault type that knows no domain, through the injector.

A test's name begins with the type that it is about. Where the values are 0.0, 1.0, 2.0, ... what
is shown tells which message it is.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fault_runs import CHANNEL, commanded, fault, through
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.core import Lazy
from pytest_dura.faults import FAULT_TYPES

law = settings(derandomize=True, deadline=None, max_examples=40)

TICKS = 30
MESSAGES = [float(index) for index in range(TICKS)]
numbers = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=12)
magnitudes = st.floats(-1e3, 1e3)
ticks = st.integers(0, 12)
steps = st.sampled_from([0.1, 0.05, 0.02])
seeds = st.integers(0, 1000)


def bits_of(value: float) -> int:
    return int(np.float64(value).view(np.uint64))


def is_noop(values: list[Any], *faults: dict[str, Any], **given: Any) -> None:
    found = through(values, *faults, **given)
    assert all(one is other for one, other in zip(found, values, strict=True))


# Numbers


@law
@given(numbers, magnitudes, magnitudes)
def test_bias_adds_its_offset_and_its_percentage(values, offset, percent) -> None:
    found = through(values, fault("bias", offset=offset, percent=percent))
    expected = [value + offset + value * percent / 100.0 for value in values]
    assert found == pytest.approx(expected, abs=1e-6)
    is_noop(values, fault("bias", offset=0.0))


@law
@given(numbers, magnitudes, ticks, steps)
def test_drift_grows_in_proportion_to_the_time_since_its_activation(values, rate, k, dt) -> None:
    found = through(values, fault("drift", rate=rate, at=k * dt), dt=dt)
    for index, (value, shown) in enumerate(zip(values, found, strict=True)):
        assert shown == pytest.approx(value + rate * dt * max(index - k, 0), abs=1e-6)
    is_noop(values, fault("drift", rate=0.0))


@pytest.mark.parametrize("distribution", ["gaussian", "uniform", "laplace"])
def test_noise_has_mean_zero_the_sigma_and_the_shape_that_it_says(distribution) -> None:
    noise = fault("noise", sigma=2.0, distribution=distribution)
    errors = np.array(through([5.0] * 4000, noise)) - 5.0
    assert abs(errors.mean()) < 4 * 2.0 / math.sqrt(4000)
    assert errors.std() == pytest.approx(2.0, rel=0.06)
    kurtosis = float(np.mean(errors**4) / np.var(errors) ** 2)
    assert kurtosis == pytest.approx(
        {"gaussian": 3, "uniform": 1.8, "laplace": 6}[distribution], rel=0.2
    )
    assert len(set(errors)) == 4000, "drawn anew at each tick"


@law
@given(numbers, st.floats(0.01, 100.0), seeds, st.sampled_from(["gaussian", "uniform", "laplace"]))
def test_noise_is_in_proportion_to_sigma(values, sigma, seed, shape) -> None:
    one, two = (
        through(values, fault("noise", sigma=sigma * factor, distribution=shape), seed=seed)
        for factor in (1.0, 2.0)
    )
    for value, single, double in zip(values, one, two, strict=True):
        assert double - value == pytest.approx(2.0 * (single - value), abs=1e-6)
    is_noop(values, fault("noise", sigma=0.0, distribution=shape), seed=seed)


@law
@given(numbers, st.floats(-100.0, 100.0))
def test_gain_scales(values, factor) -> None:
    assert through(values, fault("gain", factor=factor)) == [value * factor for value in values]
    is_noop(values, fault("gain", factor=1.0))


@law
@given(st.lists(st.floats(), min_size=1, max_size=8), magnitudes)
def test_stuck_at_is_its_value_whatever_is_true(values, value) -> None:
    assert through(values, fault("stuck-at", value=value)) == [value] * len(values)


@law
@given(
    st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1),
    st.integers(0, 32),
    seeds,
)
def test_bit_flip_inverts_so_many_bits_and_stays_finite(values, bits, seed) -> None:
    found = through(values, fault("bit-flip", bits=bits), seed=seed)
    for value, flipped in zip(values, found, strict=True):
        assert math.isfinite(flipped)
        differing = (bits_of(value) ^ bits_of(flipped)).bit_count()
        # The zeros are equal: a flipped sign of zero changes nothing.
        assert differing == bits or (value == flipped == 0.0 and bits == 1)


def test_bit_flip_reaches_every_bit_but_those_that_make_infinity() -> None:
    found = through([3.0] * 3000, fault("bit-flip"))
    assert {bits_of(3.0) ^ bits_of(one) for one in found} == {1 << n for n in range(64)}
    # 1.0 is all ones in its exponent but the highest bit, which would make infinity.
    found = through([1.0] * 3000, fault("bit-flip"))
    assert {bits_of(1.0) ^ bits_of(one) for one in found} == {1 << n for n in range(64) if n != 62}


@law
@given(
    numbers,
    magnitudes,
    st.floats(0.0, 1e3),
    st.floats(0.1, 1e3),
    st.sampled_from(["above", "below"]),
)
def test_out_of_range_is_beyond_the_limit_whatever_is_true(
    values, low, width, excess, side
) -> None:
    limits = {"low": low, "high": low + width, "excess": excess, "side": side}
    for shown in through(values, fault("out-of-range", **limits)):
        beyond = shown - (low + width) if side == "above" else low - shown
        assert beyond == pytest.approx(excess)


# Values that come late, seldom or not at all


@law
@given(ticks)
def test_freeze_holds_the_value_of_its_activation(k) -> None:
    found = through(MESSAGES, fault("freeze", at=k * 0.1))
    assert found == [min(message, k) for message in MESSAGES]


def dropped(found: list[float], start: int) -> list[int]:
    """The ticks at which nothing arrived; what was shown is checked to be what arrived last."""
    last, lost = MESSAGES[max(start - 1, 0)], []
    assert found[:start] == MESSAGES[:start]
    for index in range(start, TICKS):
        if found[index] == MESSAGES[index]:
            last = MESSAGES[index]
        else:
            lost.append(index)
        assert found[index] == last
    return lost


@pytest.mark.parametrize("kind", ["omission", "loss"])
@law
@given(st.floats(0.0, 1.0), ticks, seeds)
def test_omission_keeps_the_last_value_delivered(kind, p, k, seed) -> None:
    dropped(through(MESSAGES, fault(kind, p=p, at=k * 0.1), seed=seed), k)


@pytest.mark.parametrize("kind", ["omission", "loss"])
def test_omission_is_as_frequent_as_it_says(kind) -> None:
    found = through([float(i) for i in range(3000)], fault(kind, p=0.3))
    share = sum(one != i for i, one in enumerate(found)) / 3000
    assert share == pytest.approx(0.3, abs=0.035)  # four standard deviations


@law
@given(ticks, seeds)
def test_loss_of_nothing_is_the_identity_and_loss_of_all_is_a_freeze(k, seed) -> None:
    for kind in ("loss", "omission"):
        is_noop(MESSAGES, fault(kind, p=0.0, at=k * 0.1), seed=seed)
        # What is lost at k leaves the receiver with the message of k - 1.
        frozen = through(MESSAGES, fault("freeze", at=max(k - 1, 0) * 0.1))
        assert through(MESSAGES, fault(kind, p=1.0, at=k * 0.1), seed=seed) == frozen


@law
@given(ticks, ticks, steps, st.floats(0.0, 0.9))
def test_delay_of_k_ticks_shifts_by_k(k, at, dt, part) -> None:
    delay = fault("delay", s=k * dt, at=at * dt)
    found = through(MESSAGES, delay, dt=dt)
    assert found == [max(i - k, 0) if i >= at else i for i in range(TICKS)]
    if k:  # parts of a tick count as a whole one
        less = fault("delay", s=(k - part) * dt, at=at * dt)
        assert through(MESSAGES, less, dt=dt) == found
    else:
        is_noop(MESSAGES, delay, dt=dt)


@law
@given(ticks, ticks, steps)
def test_delay_twice_is_one_of_the_sum(one, two, dt) -> None:
    both = fault("delay", s=one * dt, id="a"), fault("delay", s=two * dt, id="b")
    assert through(MESSAGES, *both, dt=dt) == through(
        MESSAGES, fault("delay", s=(one + two) * dt), dt=dt
    )


@law
@given(st.integers(1, 8), ticks, steps)
def test_slow_refreshes_at_its_rate_from_the_activation_on(every, at, dt) -> None:
    found = through(MESSAGES, fault("slow", hz=1.0 / (every * dt), at=at * dt), dt=dt)
    assert found == [i if i < at else i - (i - at) % every for i in range(TICKS)]
    is_noop(MESSAGES, fault("slow", hz=1.0 / dt), dt=dt)
    is_noop(MESSAGES, fault("slow", hz=3.3 / dt), dt=dt)


def test_slow_keeps_a_rate_that_is_no_whole_number_of_ticks() -> None:
    found = through([float(i) for i in range(300)], fault("slow", hz=3.0))
    assert len(set(found)) == 90


@law
@given(st.integers(1, 5), st.integers(0, 5), ticks, steps)
def test_intermittent_delivers_by_turns(on, off, at, dt) -> None:
    contact = fault("intermittent", on=on * dt, off=off * dt, at=at * dt)
    found = through(MESSAGES, contact, dt=dt)
    lost = [i for i in range(max(at, 1), TICKS) if (i - at) % (on + off) < off]
    assert dropped(found, at) == lost
    if not off:
        is_noop(MESSAGES, contact, dt=dt)


# Communication


@law
@given(st.integers(0, 900), st.integers(0, 900), ticks, seeds, steps)
def test_latency_keeps_the_order_and_its_bounds(latency, jitter, at, seed, dt) -> None:
    late = fault("latency", latency_ms=float(latency), jitter_ms=float(jitter), at=at * dt)
    found = through(MESSAGES, late, seed=seed, dt=dt)
    assert found == sorted(found), "no message overtakes another"
    assert found[:at] == MESSAGES[:at]
    least = math.ceil(latency / 1e3 / dt - 1e-9)
    most = math.ceil((latency + jitter) / 1e3 / dt - 1e-9)
    for index in range(at, TICKS):
        assert found[index] <= max(index - least, at - 1, 0)
        assert found[index] >= index - most or found[index] == max(at - 1, 0)


@law
@given(ticks, ticks, steps)
def test_latency_of_k_ticks_is_a_delay_once_it_has_passed(k, at, dt) -> None:
    found = through(MESSAGES, fault("latency", latency_ms=k * dt * 1e3, at=at * dt), dt=dt)
    delayed = through(MESSAGES, fault("delay", s=k * dt, at=at * dt), dt=dt)
    assert found[at + k :] == delayed[at + k :]
    assert set(found[at : at + k]) <= {max(at - 1, 0)}
    is_noop(MESSAGES, fault("latency", latency_ms=0.0))


def test_latency_jitters() -> None:
    found = through(MESSAGES, fault("latency", latency_ms=0.0, jitter_ms=500.0))
    assert len({i - one for i, one in enumerate(found)}) > 2


@law
@given(st.floats(0.0, 1.0), ticks, seeds)
def test_reorder_swaps_a_message_with_its_successor(p, at, seed) -> None:
    found = through(MESSAGES, fault("reorder", p=p, at=at * 0.1), seed=seed)
    assert found[:at] == MESSAGES[:at]
    late = False
    for index in range(max(at, 1), TICKS):
        # The late one overwrites; without one, either this message or nothing new arrives.
        if late:
            assert found[index] == index - 1
            late = False  # whether this one is late as well shows at the next tick
        elif found[index] != index:
            before = found[index - 1] if index > at else index - 1
            assert found[index] in (before, index - 1)
            late = found[index] == before != index - 1
    assert all(index - one <= 2 for index, one in enumerate(found))


def test_reorder_of_one_message_is_as_it_is_written() -> None:
    draws = [one for one in range(200) if _reordered(one)[3] == 2.0 and _reordered(one)[4] == 3.0]
    found = _reordered(draws[0])
    assert found[3:5] == [2.0, 3.0], "nothing at 3, then the late message over its successor"


def _reordered(seed: int) -> list[float]:
    return through(MESSAGES[:8], fault("reorder", p=0.3), seed=seed)


@law
@given(ticks, seeds)
def test_reorder_of_none_is_the_identity_and_of_all_a_delay_of_a_tick(at, seed) -> None:
    is_noop(MESSAGES, fault("reorder", p=0.0, at=at * 0.1), seed=seed)
    found = through(MESSAGES, fault("reorder", p=1.0, at=at * 0.1), seed=seed)
    assert found == through(MESSAGES, fault("delay", s=0.1, at=at * 0.1))


@law
@given(st.integers(0, 6), st.integers(1, 12), ticks, steps)
def test_duplicate_builds_up_a_queue_up_to_its_bound(n, held, at, dt) -> None:
    copies = fault("duplicate", n=n, queue_s=held * dt, at=at * dt)
    found = through(MESSAGES, copies, dt=dt)
    for index in range(at, TICKS):
        head = at + (index - at) // (n + 1)
        assert found[index] == max(head, index - held)
    assert found[:at] == MESSAGES[:at]
    if not n:
        is_noop(MESSAGES, copies, dt=dt)


@law
@given(numbers, st.integers(0, 32), seeds)
def test_corruption_inverts_so_many_bits_of_a_number(values, bits, seed) -> None:
    found = through(values, fault("corruption", p=1.0, bits=bits), seed=seed)
    for value, one in zip(values, found, strict=True):
        assert math.isfinite(one)
        differing = (bits_of(value) ^ bits_of(one)).bit_count()
        assert differing == bits or (value == one == 0.0 and bits == 1)
    is_noop(values, fault("corruption", p=0.0), seed=seed)
    is_noop(values, fault("corruption", p=1.0, bits=0), seed=seed)


@law
@given(st.integers(1, 8), st.integers(1, 6), seeds)
def test_corruption_changes_one_number_of_an_array(rows, bits, seed) -> None:
    message = np.arange(3.0 * rows).reshape(rows, 3) + 0.5
    message.flags.writeable = False
    (found,) = through([message], fault("corruption", p=1.0, bits=bits), seed=seed)
    assert found.shape == message.shape
    assert np.isfinite(found).all()
    assert (found != message).sum() == 1


@law
@given(ticks)
def test_denial_is_the_loss_of_all(at) -> None:
    found = through(MESSAGES, fault("denial", at=at * 0.1))
    assert found == through(MESSAGES, fault("loss", p=1.0, at=at * 0.1))
    assert found == [min(message, max(at - 1, 0)) for message in MESSAGES]


@law
@given(st.integers(1, 8), st.integers(1, 12), steps)
def test_replay_repeats_what_came_before_in_a_loop(k, at, dt) -> None:
    found = through(MESSAGES, fault("replay", s=k * dt, at=at * dt), dt=dt)
    period = min(k, at)
    assert found[at : at + period] == MESSAGES[at - period : at]
    for index in range(at + period, TICKS):
        assert found[index] == found[index - period]


def test_replay_waits_until_there_is_something_to_replay() -> None:
    assert through(MESSAGES[:4], fault("replay", s=1.0)) == [0.0, 0.0, 0.0, 0.0]


@law
@given(ticks, magnitudes)
def test_masquerade_repeats_the_message_of_its_activation_with_forged_fields(at, speed) -> None:
    messages = [{"speed": one, "heading": -one} for one in MESSAGES]
    forger = fault("masquerade", forged={"speed": speed}, at=at * 0.1)
    found = through(messages, forger)
    assert found[:at] == messages[:at]
    assert found[at:] == [{"speed": speed, "heading": -float(at)}] * (TICKS - at)
    assert through(messages, fault("masquerade", at=at * 0.1)) == through(
        messages, fault("freeze", at=at * 0.1)
    )
    field = fault("masquerade", target=f"{CHANNEL}.speed", value=speed, at=at * 0.1)
    assert through(messages, field)[at:] == [{**one, "speed": speed} for one in messages[at:]]


# Commands


@law
@given(numbers, st.floats(0.0, 100.0))
def test_loss_of_effectiveness_scales_the_command(values, percent) -> None:
    weak = fault("loss-of-effectiveness", target="command", percent=percent)
    expected = [value * (1.0 - percent / 100.0) for value in values]
    assert commanded(values, weak) == pytest.approx(expected)
    for share, left in ((0.0, 1.0), (100.0, 0.0)):
        weak = fault("loss-of-effectiveness", target="command", percent=share)
        assert commanded(values, weak) == [value * left for value in values]


@law
@given(st.floats(0.05, 3.0), st.integers(1, 10), magnitudes, magnitudes, steps)
def test_lag_leaves_an_exponential_of_a_step(s, at, start, end, dt) -> None:
    values = [start] * at + [end] * (TICKS - at)
    found = commanded(values, fault("lag", target="command", s=s, at=at * dt), dt=dt)
    assert found[:at] == values[:at]
    for passed, value in enumerate(found[at:], 1):
        assert value == pytest.approx(end + (start - end) * math.exp(-passed * dt / s), abs=1e-9)
    assert commanded(values, fault("lag", target="command", s=0.0), dt=dt) == values


@law
@given(numbers, st.floats(0.0, 3.0))
def test_lag_stays_within_the_commands(values, s) -> None:
    for found in commanded(values, fault("lag", target="command", s=s)):
        assert min(values) - 1e-6 <= found <= max(values) + 1e-6


@law
@given(ticks)
def test_stuck_command_holds_the_command_of_its_activation(at) -> None:
    found = commanded(MESSAGES, fault("stuck-command", target="command", at=at * 0.1))
    assert found == [min(message, at) for message in MESSAGES]


@law
@given(numbers)
def test_inversion_twice_is_the_identity(values) -> None:
    one = fault("inversion", target="command", id="a")
    assert commanded(values, one) == [-value for value in values]
    assert commanded(values, one, fault("inversion", target="command", id="b")) == values


# Pictures


@st.composite
def pictures(draw: Any) -> Any:
    height, width = draw(st.integers(1, 9)), draw(st.integers(1, 9))
    rng = np.random.default_rng(draw(seeds))
    picture = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    picture.flags.writeable = False
    return picture


def seen(picture: Any, *faults: dict[str, Any], seed: int = 1) -> Any:
    """The picture after the faults: the same, whether it was lazy or not."""
    (eager,) = through([picture], *faults, seed=seed)
    (lazy,) = through([Lazy(lambda: picture)], *faults, seed=seed)
    assert eager.dtype == lazy.dtype == np.uint8
    assert eager.shape == lazy.shape == picture.shape
    assert np.array_equal(eager, lazy)
    return lazy


@law
@given(pictures(), st.floats(-255.0, 255.0), st.floats(0.0, 4.0))
def test_brightness_adds_and_clips(picture, levels, gain) -> None:
    found = seen(picture, fault("brightness", levels=levels, gain=gain))
    exact = np.clip(picture * gain + levels, 0.0, 255.0)
    assert np.abs(found - exact).max() <= 0.5
    is_noop([picture], fault("brightness", levels=0.0))
    assert not seen(picture, fault("brightness", levels=-255.0)).any()


@law
@given(pictures(), st.floats(0.0, 1.0), seeds)
def test_salt_and_pepper_hits_its_share_of_pixels(picture, share, seed) -> None:
    grey = np.full_like(picture, 128)
    found = seen(grey, fault("salt-and-pepper", share=share), seed=seed)
    hit = (found != 128).any(axis=2)
    assert hit.sum() == math.ceil(share * hit.size - 1e-6)
    pixels = found[hit]
    assert ((pixels == 0).all(axis=1) | (pixels == 255).all(axis=1)).all()
    is_noop([picture], fault("salt-and-pepper", share=0.0))


def test_salt_and_pepper_is_salt_as_often_as_pepper() -> None:
    found = seen(np.full((60, 60, 3), 128, np.uint8), fault("salt-and-pepper", share=1.0))
    assert (found == 255).mean() == pytest.approx(0.5, abs=0.035)


@law
@given(pictures(), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.01, 1.0))
def test_patch_covers_a_square_and_nothing_else(picture, x, y, size) -> None:
    grey = np.full_like(picture, 128)
    found = seen(grey, fault("patch", x=x, y=y, size=size, colour=[1, 2, 3]))
    hit = (found != 128).all(axis=2)
    assert (found[hit] == [1, 2, 3]).all()
    assert (found[~hit] == 128).all()
    rows, columns = np.flatnonzero(hit.any(axis=1)), np.flatnonzero(hit.any(axis=0))
    side = max(round(size * min(hit.shape)), 1)
    assert 1 <= len(rows) <= side
    assert 1 <= len(columns) <= side
    assert hit.sum() == len(rows) * len(columns), "a rectangle"
    is_noop([picture], fault("patch", size=0.0))


@law
@given(pictures(), st.integers(1, 255), seeds)
def test_perturbation_is_what_its_function_makes_of_the_picture(picture, level, seed) -> None:
    shift = {"function": "perturbations:shifted", "params": {"level": level}}
    found = seen(picture, fault("perturbation", **shift), seed=seed)
    assert np.array_equal(found, picture + np.uint8(level))
    is_noop([picture], fault("perturbation", function="perturbations:shifted", params={"level": 0}))
    noise = fault("perturbation", function="perturbations:random_bits")
    assert np.array_equal(seen(picture, noise, seed=seed), seen(picture, noise, seed=seed))


# All of them


def test_after_a_rest_the_last_message_is_that_of_the_rest() -> None:
    turns = {"on": 0.2, "off": 0.2}
    for kind in ("loss", "omission"):
        found = through(MESSAGES[:8], fault(kind, p=1.0, duration=turns))
        assert found == [0, 0, 2, 3, 3, 3, 6, 7]
    late = fault("latency", latency_ms=100.0, duration=turns)
    assert through(MESSAGES[:8], late) == [0, 0, 2, 3, 3, 4, 6, 7]
    assert through(MESSAGES[:8], fault("denial", duration=turns)) == [0, 0, 2, 3, 3, 3, 6, 7]


def test_every_type_of_the_catalogue_has_a_law() -> None:
    written = "".join(
        file.read_text("utf-8") for file in sorted(Path(__file__).parent.glob("*fault_laws.py"))
    )
    stems = {name.replace("-", "_"): name for name in FAULT_TYPES}
    found = set()
    for test in re.findall(r"^def test_(\w+)", written, re.MULTILINE):
        about = [stem for stem in stems if test.startswith(f"{stem}_")]
        if about:  # loss_of_effectiveness is no loss
            found.add(stems[max(about, key=len)])
    assert found == set(FAULT_TYPES)
