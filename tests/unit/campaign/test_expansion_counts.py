"""How often what is costly is done while cases are made; no clock is looked at."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from pytest_dura.faults.model import FaultEffect
from pytest_dura.library import expand_cases, load_library, planned_faults
from pytest_dura.library.planned_faults import FaultReader, parse_fault

SCENARIO = """\
name: scale/grid
simulator: lift_dura.domain:Lift
domain: shaft:SHAFT
duration: 50.0
campaigns:
  - fault: {{type: bias, activation: {{at: 2.0}}, duration: 4.0}}
    grid: {{parameters.offset: {values}}}
"""


def _counter(done: Counter[str], monkeypatch: pytest.MonkeyPatch) -> Callable[[object, str], None]:
    """Have the calls of functions counted from now on."""

    def count(owner: object, name: str) -> None:
        real = getattr(owner, name)

        def counted(*args: object) -> object:
            done[name] += 1
            return real(*args)

        monkeypatch.setattr(owner, name, counted)

    return count


@pytest.mark.parametrize("number", [1, 10, 40])
def test_each_fault_of_a_grid_is_read_and_validated_once(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = _counter(done := Counter(), monkeypatch)
    count(FaultReader, "read_parts")
    count(planned_faults, "fault_form")
    count(planned_faults, "check_target")
    values = [5.0 + step for step in range(number)]
    (tmp_path / "grid.yaml").write_text(SCENARIO.format(values=values), encoding="utf-8")
    library = load_library([tmp_path], builtin=False)
    cases = expand_cases(library.scenarios, read=library.faults)
    assert len({case.id for case in cases}) == number
    assert done == {"read_parts": number, "fault_form": number, "check_target": 1}
    assert cases == expand_cases(library.scenarios)


TWO_PARTS = """\
name: scale/grid
simulator: lift_dura.domain:Lift
domain: shaft:SHAFT
duration: 50.0
campaigns:
  - fault: {type: loss, target: encoder, activation: {by: security_assessor}, duration: 4.0}
    grid:
      parameters.p: [0.5, 1.0]
      activation.at: [1.0, 2.0, 3.0]
      activation.by: [security_assessor, fault_injector]
"""


def test_a_grid_validates_each_value_of_a_part_once_and_checks_each_combination(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = _counter(done := Counter(), monkeypatch)
    count(planned_faults, "fault_form")
    count(FaultEffect, "check_parameters")
    (tmp_path / "grid.yaml").write_text(TWO_PARTS, encoding="utf-8")
    library = load_library([tmp_path], builtin=False)
    cases = expand_cases(library.scenarios, read=library.faults)
    assert done == {"fault_form": 2 + 3 * 2 - 1, "check_parameters": 2 * 3 * 2}
    drawn = itertools.product([0.5, 1.0], [1.0, 2.0, 3.0], ["security_assessor", "fault_injector"])
    for case, (probability, at, by) in zip(cases, drawn, strict=True):
        (fault,) = case.faults
        assert fault.parameters is not None
        assert fault.parameters["p"] == probability
        assert (fault.activation["at"], fault.activation["by"]) == (at, by)
        assert fault == parse_fault(case.scenario, fault.in_file())
        assert fault.by_chance is (probability == 0.5)
    assert [case.id for case in cases][:3] == [
        "scale/grid+loss-p=0.5-at=1-by=security_assessor",
        "scale/grid+loss-p=0.5-at=1-by=fault_injector",
        "scale/grid+loss-p=0.5-at=2-by=security_assessor",
    ]
