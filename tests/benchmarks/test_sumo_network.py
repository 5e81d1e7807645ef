"""The files that the SUMO adapter ships are those that the script makes."""

from __future__ import annotations

import runpy
from pathlib import Path

from pytest_dura.adapters import sumo

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "sumo_network.py"


def test_types_and_routes_are_those_of_the_script() -> None:
    script = runpy.run_path(str(SCRIPT))
    shipped = Path(sumo.__file__).with_name(sumo.TYPES).read_text()
    assert shipped == script["document"]("additional", script["types"]())
