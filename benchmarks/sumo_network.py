"""Makes the network that the SUMO adapter ships, from the junction's own geometry.

    pip install eclipse-sumo          # 440 MB, for netconvert alone; running needs libsumo
    python benchmarks/sumo_network.py [NETCONVERT]

Arms, stop lines, lanes and the lines of all twelve routes are those of `driving/junction.py`; the
east-west road has priority. `four_way.net.xml` comes from `netconvert`, `four_way.add.xml`, the
types of drivers and the routes, from here. Both go beside `pytest_dura/adapters/sumo.py`.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from pytest_dura.adapters import sumo
from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH
from pytest_dura.driving.junction import (
    ARM_LENGTH,
    ARMS,
    SPEED_LIMIT,
    all_routes,
)
from pytest_dura.driving.roads import FOUR_WAY

WIDTH = 2 * FOUR_WAY.arms[0].offset
STOP_LINE = FOUR_WAY.arms[0].stop_line
FAR = ARM_LENGTH + STOP_LINE
ENDS = {"south": (0, -FAR), "west": (-FAR, 0), "north": (0, FAR), "east": (FAR, 0)}
"""Outer ends of the arms; in SUMO y points north."""
DRIVER = (
    'carFollowModel="IDM" accel="4.0" decel="3.0" emergencyDecel="8.0" tau="1.5" minGap="2.0" '
    f'maxSpeed="{SPEED_LIMIT}" speedFactor="1.0" speedDev="0" impatience="0.5"'
)
"""As driving's drivers: IDM with 4 and 3 m/s2, 1.5 s and 2 m. Without impatience a driver on the
minor road waits for minutes in dense traffic, which driving's do not."""


def nodes() -> Iterator[str]:
    corners = [(WIDTH, -STOP_LINE), (STOP_LINE, -WIDTH), (STOP_LINE, WIDTH), (WIDTH, STOP_LINE)]
    shape = " ".join(f"{x},{y}" for x, y in [*corners, *((-x, -y) for x, y in corners)])
    yield f'<node id="centre" x="0" y="0" type="priority" shape="{shape}"/>'
    for arm, (x, y) in ENDS.items():
        yield f'<node id="{arm}" x="{x}" y="{y}" type="dead_end"/>'


def edges() -> Iterator[str]:
    for number, arm in enumerate(ARMS):
        lane = (
            f'numLanes="1" speed="{SPEED_LIMIT}" width="{WIDTH}" priority="{1 + 2 * (number % 2)}"'
        )
        yield f'<edge id="{arm}_in" from="{arm}" to="centre" {lane}/>'
        yield f'<edge id="{arm}_out" from="centre" to="{arm}" {lane}/>'


def connections() -> Iterator[str]:
    for route in all_routes():
        x, y, _ = route.pose(
            np.linspace(ARM_LENGTH, route.exit, 2 if route.turn == "straight" else 25)
        )
        shape = " ".join(f"{a:.3f},{-b:.3f}" for a, b in zip(x, y, strict=True))
        ends = f'from="{ARMS[route.origin]}_in" to="{ARMS[route.destination]}_out"'
        lanes = f'fromLane="0" toLane="0" speed="{SPEED_LIMIT}"'
        yield f'<connection {ends} {lanes} shape="{shape}"/>'


def types() -> Iterator[str]:
    size = f'length="{CAR_LENGTH}" width="{CAR_WIDTH}"'
    yield f'<vType id="{sumo.EGO}" {size} minGap="0" sigma="0" maxSpeed="30"/>'
    least, greatest = sumo.EXPONENTS
    for tenths in range(round(10 * least), round(10 * greatest) + 1):
        name = sumo.type_name(tenths / 10)
        yield f'<vType id="{name}" {size} {DRIVER} delta="{tenths / 10}"/>'
    for route in all_routes():
        roads = f"{ARMS[route.origin]}_in {ARMS[route.destination]}_out"
        yield f'<route id="{sumo.route_name(route)}" edges="{roads}"/>'


def document(root: str, elements: Iterable[str]) -> str:
    return "\n".join([f"<{root}>", *(f"    {element}" for element in elements), f"</{root}>", ""])


def main(netconvert: str) -> None:
    target = Path(sumo.__file__).parent
    (target / sumo.TYPES).write_text(document("additional", types()))
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        inputs = {"node": document("nodes", nodes()), "edge": document("edges", edges()),
                  "connection": document("connections", connections())}  # fmt: skip
        arguments = []
        for kind, text in inputs.items():
            (folder / f"{kind}.xml").write_text(text)
            arguments += [f"--{kind}-files", f"{kind}.xml"]
        arguments += ["--no-turnarounds", "--offset.disable-normalization", "--precision", "3",
                      "--junctions.corner-detail", "0", "--output-file", "net.xml"]  # fmt: skip
        subprocess.run([netconvert, *arguments], cwd=folder, check=True)
        network = (folder / "net.xml").read_text()
    # The comment holds the time: without it the same inputs give the same bytes.
    network = re.sub(r"<!--.*?-->\n*", "", network, flags=re.DOTALL)
    (target / sumo.NETWORK).write_text(network)
    for name in (sumo.NETWORK, sumo.TYPES):
        print(f"{target / name}: {(target / name).stat().st_size} bytes")


if __name__ == "__main__":
    program = sys.argv[1] if len(sys.argv) > 1 else shutil.which("netconvert")
    if program is None:
        sys.exit("netconvert is not installed: pip install eclipse-sumo, or give its path")
    main(program)
