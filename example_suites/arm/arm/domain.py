"""What the domain declares to files, faults, searches and reports."""

from __future__ import annotations

from arm.cell import REACH, SCANNERS, TOP_RATE, World
from pytest_dura import Action, Channel, Domain, Signal

ANGLE = (-3.2, 3.2)
RATE = (-2.0, 2.0)
SCAN = Channel(
    "numbers", ("range", "bearing"), units=("m", "rad"), meaning="the person's legs",
    frame="scanner: bearing clockwise from x of the cell", ranges=((0.0, REACH), ANGLE),
    errors=(0.03, 0.01),
)  # fmt: skip

ARM = Domain(
    name="arm",
    roles={"generator": "considerate", "safety_monitor": "separation",
           "recovery_planner": "protective_stop"},
    provokers=("careless",),
    world=World,
    signals=(
        Signal("gap", "m", "between arm and person, hand included; 0 on contact", least=0.0),
        Signal("separation", "m", "gap that is left if the arm brakes now and the person goes on"),
        Signal("arm_speed", "m/s", "of tool or elbow, the faster; as a contact began", least=0.0),
        Signal("contact_force", "N", "greatest of the tick, of arm on person", least=0.0),
        Signal("contact_pressure", "N/cm2", "that force by the area that touches", least=0.0),
        Signal("parts", "1", "parts moved so far", least=0.0),
    ),
    percept_signals=tuple(
        Signal(name, "m", f"of the person from the base, by the {name} scanner")
        for name in SCANNERS
    ),
    proposal_signals=(),
    actions=(
        Action("shoulder", "rad/s", "rate of the joint at the base", -TOP_RATE, TOP_RATE),
        Action("elbow", "rad/s", "rate of the joint between the links", -TOP_RATE, TOP_RATE),
    ),
    channels={
        "joints": Channel(
            "numbers", ("shoulder", "elbow", "shoulder_rate", "elbow_rate"),
            units=("rad", "rad", "rad/s", "rad/s"), meaning="encoders of the arm",
            ranges=(ANGLE, ANGLE, RATE, RATE), errors=(0.002, 0.002, 0.01, 0.01),
        ),
        **dict.fromkeys(SCANNERS, SCAN),
    },
    fault_targets={"number": "left.range", "any": "left", "command": "command.shoulder"},
)  # fmt: skip
