"""The factory of sequential tests, and what it refuses."""

from __future__ import annotations

import subprocess
import sys

import pytest

from pytest_dura.core import ConfigurationError
from pytest_dura.requirements import METHODS, EProcess, FixedN, Sprt, make_test

GOOD = {"fixed": {"planned": 60}, "sprt": {"p0": 0.01}, "e-process": {}}


def test_each_method_has_its_test() -> None:
    made = {name: make_test(name, 0.05, 0.95, **GOOD[name]) for name in METHODS}
    assert {name: type(test) for name, test in made.items()} == {
        "fixed": FixedN,
        "sprt": Sprt,
        "e-process": EProcess,
    }
    assert len({test.method for test in made.values()}) == 3


@pytest.mark.parametrize("confidence, level", [(0.95, 0.05), (0.9, 0.1), (0.999, 0.001)])
def test_the_levels_of_the_sprt_are_not_rounded(confidence, level) -> None:
    assert make_test("sprt", 0.05, confidence, p0=0.01).alpha == level


def test_the_open_ended_methods_take_a_plan() -> None:
    assert make_test("sprt", 0.05, 0.95, p0=0.01, planned=100).update(False) is None
    assert make_test("e-process", 0.05, 0.95, planned=100).update(False) is None


@pytest.mark.parametrize(
    "method, change, key",
    [
        ("wald", {}, "method"),
        ("sprt", {"p0": None}, "p0"),
        ("sprt", {"p0": 0.05}, "p0"),
        ("sprt", {"p0": 0.0}, "p0"),
        ("fixed", {"p0": 0.01}, "p0"),
        ("e-process", {"p0": 0.01}, "p0"),
        ("fixed", {"planned": None}, "planned"),
        ("fixed", {"planned": 0}, "planned"),
        ("e-process", {"planned": -1}, "planned"),
        *[(method, {"limit": limit}, "limit") for method in METHODS for limit in (0.0, 1.0, -1)],
        *[(method, {"confidence": c}, "confidence") for method in METHODS for c in (0.5, 1.0)],
        ("sprt", {"confidence": float("nan")}, "confidence"),
    ],
)
def test_what_makes_no_sense_names_its_key(method, change, key) -> None:
    arguments = {"limit": 0.05, "confidence": 0.95, **GOOD.get(method, {}), **change}
    with pytest.raises(ConfigurationError) as caught:
        make_test(method, **arguments)
    assert caught.value.key == key


def test_importing_the_statistics_imports_nothing_heavy() -> None:
    code = "import sys, pytest_dura.requirements.rate_tests as s; s.make_test('e-process', 0.05)\n"
    code += "print([m for m in ('numpy', 'scipy', 'rtamt', 'pydantic') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
