"""Faults of pictures: laziness, what is no picture, and perturbations that go wrong."""

from __future__ import annotations

import numpy as np
import pytest
from fault_runs import CHANNEL, fault, through

from pytest_dura.core import ConfigurationError, Lazy, RoleContext
from pytest_dura.faults import CampaignInjector, parse_fault

DRAWN = ["brightness", "salt-and-pepper", "patch"]
GREY = np.full((4, 6, 3), 100, np.uint8)


@pytest.mark.parametrize("kind", DRAWN)
def test_a_picture_is_changed_only_when_it_is_read_and_stays_so(kind: str) -> None:
    injector, made = CampaignInjector(), list[int]()
    injector.reset(RoleContext(1, 0.1, {}, (fault(kind),)))

    def frame(index: int) -> Lazy:
        return Lazy(lambda: made.append(index) or GREY)

    shown = [injector.corrupt({CHANNEL: frame(i)}, i * 0.1)[0][CHANNEL] for i in range(4)]
    assert made == [0], "one is looked at where the fault begins"
    late = shown[3].get()
    assert made == [0, 3]
    assert shown[3].get() is late
    assert not late.flags.writeable
    again = through([GREY] * 4, fault(kind))
    assert np.array_equal(late, again[3]), "when it is read does not matter"
    assert (GREY == 100).all()


@pytest.mark.parametrize(
    "name, found",
    [
        ("cropped", "uint8 of shape (3, 6, 3)"),
        ("as_floats", "float64 of shape (4, 6, 3)"),
        ("as_text", "str"),
    ],
)
def test_a_perturbation_that_returns_no_such_picture_is_named(name: str, found: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        through([GREY], fault("perturbation", function=f"perturbations:{name}"))
    message = str(caught.value)
    assert f"perturbations:{name} returned no picture" in message
    assert f"found:    {found!r}" in message
    assert "expected: uint8 of shape (4, 6, 3)" in message


@pytest.mark.parametrize(
    "path, told",
    [
        ("perturbations:missing", "cannot import"),
        ("no_such_module:f", "cannot import"),
        ("perturbations", "package.module:Name"),
        ("perturbations:NO_FUNCTION", "is not a function"),
    ],
)
def test_a_function_that_cannot_be_had_is_refused_before_anything_runs(path, told) -> None:
    data = {"type": "perturbation", "target": CHANNEL, "activation": {"at": 1.0}}
    with pytest.raises(ConfigurationError) as caught:
        parse_fault({**data, "parameters": {"function": path}})
    assert caught.value.key == "parameters.function"
    assert told in str(caught.value)


def test_a_perturbation_may_write_on_its_picture_and_no_other() -> None:
    shift = fault("perturbation", function="perturbations:shifted", params={"level": 5})
    found = through([Lazy(lambda: GREY)] * 2, shift)
    assert all((one == 105).all() for one in found)
    assert (GREY == 100).all()


def test_the_noise_that_is_the_example_has_the_sigma_that_it_says() -> None:
    noise = {"function": "pytest_dura.faults.types.perturbation:gaussian_noise"}
    picture = np.full((80, 80, 3), 128, np.uint8)
    (found,) = through([picture], fault("perturbation", **noise, params={"sigma": 20.0}))
    errors = found.astype(float) - 128.0
    assert abs(errors.mean()) < 1.0
    assert errors.std() == pytest.approx(20.0, rel=0.05)


def test_a_patch_lies_where_it_says() -> None:
    patch = fault("patch", x=0.0, y=1.0, size=0.5, colour=[9, 8, 7])
    (found,) = through([GREY], patch)
    hit = (found == [9, 8, 7]).all(axis=2)
    assert np.argwhere(hit).tolist() == [[2, 0], [3, 0]] or hit[3, 0]
    assert not hit[:2].any()
    assert not hit[:, 2:].any()
