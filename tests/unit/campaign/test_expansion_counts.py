"""How often what is costly is done while cases are made; no clock is looked at."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from pytest_dura.library import expand_cases, load_library, planned_faults
from pytest_dura.library.planned_faults import FaultReader

SCENARIO = """\
name: scale/grid
simulator: driving
duration: 50.0
campaigns:
  - fault: {{type: ghost-obstacle, activation: {{at: 2.0}}, duration: 4.0}}
    grid: {{parameters.ahead: {values}}}
"""


@pytest.mark.parametrize("number", [1, 10, 40])
def test_each_fault_of_a_grid_is_read_and_validated_once(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: Counter[str] = Counter()

    def count(owner: object, name: str) -> None:
        real = getattr(owner, name)

        def counted(*args: object) -> object:
            done[name] += 1
            return real(*args)

        monkeypatch.setattr(owner, name, counted)

    count(FaultReader, "read")
    count(planned_faults, "fault_form")
    count(planned_faults, "check_target")
    values = [5.0 + step for step in range(number)]
    (tmp_path / "grid.yaml").write_text(SCENARIO.format(values=values), encoding="utf-8")
    library = load_library([tmp_path], builtin=False)
    cases = expand_cases(library.scenarios, read=library.faults)
    assert len({case.id for case in cases}) == number
    assert done == {"read": number, "fault_form": number, "check_target": 1}
    assert cases == expand_cases(library.scenarios)
