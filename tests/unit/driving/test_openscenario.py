"""Import of OpenSCENARIO: files that another library writes, what does not map, hostile files."""

from __future__ import annotations

import itertools
import math
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from scenariogeneration import xosc

from pytest_dura import ConfigurationError, Runner
from pytest_dura.__main__ import main
from pytest_dura.driving import HighwaySimulator, route
from pytest_dura.driving.openscenario import import_openscenario
from pytest_dura.library import load_library

# The library that writes the files does so, from Python 3.12 on.
pytestmark = pytest.mark.filterwarnings("ignore:Testing an element's truth value")

DOCS = Path(__file__).parents[3] / "docs"
STEP = xosc.TransitionDynamics(xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0)
AXLE = 1.4
"""m from a car's rear axle, which a position is about, to its middle."""
BOX = xosc.BoundingBox(1.8, 4.5, 1.5, AXLE, 0, 0.75)
CAR = xosc.Vehicle(
    "hatchback",
    xosc.VehicleCategory.car,
    BOX,
    xosc.Axle(0.5, 0.6, 1.6, 2.7, 0.3),
    xosc.Axle(0, 0.6, 1.6, 0, 0.3),
    60,
    10,
    10,
)
PERSON = xosc.Pedestrian(
    "walker", 80, xosc.PedestrianCategory.pedestrian, xosc.BoundingBox(0.5, 0.5, 1.8, 0, 0, 0.9)
)
ISLAND = xosc.MiscObject("isle", 100, xosc.MiscObjectCategory.obstacle, BOX)
INWARDS = {"south": math.pi / 2, "west": 0.0, "north": -math.pi / 2, "east": math.pi}


def at(arm, distance, beside=2.0, turned=0.0, ahead=AXLE):
    """A position in the world, so many metres before the stop line of an arm."""
    heading = INWARDS[arm]
    c, s = math.cos(heading), math.sin(heading)
    out = 11.0 + distance + ahead
    x, y = -c * out + s * beside, -s * out - c * beside
    return xosc.WorldPosition(x, y, h=heading + turned)


def leaving(arm):
    return at(arm, 40.0, beside=-2.0, turned=math.pi)


class File:
    """An OpenSCENARIO file in the making."""

    def __init__(self) -> None:
        self.parameters, self.entities = xosc.ParameterDeclarations(), xosc.Entities()
        self.init, self.events = xosc.Init(), []
        self.stop = 20.0

    def add(self, name, kind=CAR, position=None, speed=None, to=None):
        self.entities.add_scenario_object(name, kind)
        if position is not None:
            self.init.add_init_action(name, xosc.TeleportAction(position))
        if speed is not None:
            self.init.add_init_action(name, xosc.AbsoluteSpeedAction(speed, STEP))
        if to is not None:
            way = xosc.Route("way")
            way.add_waypoint(at("south", 30.0), xosc.RouteStrategy.shortest)
            way.add_waypoint(to, xosc.RouteStrategy.shortest)
            self.init.add_init_action(name, xosc.AssignRouteAction(way))
        return self

    def parameter(self, name, value, *rules):
        declared = xosc.Parameter(name, xosc.ParameterType.double, str(value))
        group = xosc.ValueConstraintGroup()
        for rule, bound in rules:
            group.add_value_constraint(xosc.ValueConstraint(rule, str(bound)))
        if rules:
            declared.add_value_constraint_group(group)
        self.parameters.add_parameter(declared)
        return self

    def write(self, file):
        stop = xosc.ValueTrigger(
            "end",
            0,
            xosc.ConditionEdge.none,
            xosc.SimulationTimeCondition(self.stop, xosc.Rule.greaterThan),
            "stop",
        )
        story = xosc.StoryBoard(self.init, stop)
        for name, time, speed in self.events:
            event = xosc.Event("go", xosc.Priority.override)
            event.add_action("go", xosc.AbsoluteSpeedAction(speed, STEP))
            condition = xosc.SimulationTimeCondition(time, xosc.Rule.greaterThan)
            event.add_trigger(xosc.ValueTrigger("at", 0, xosc.ConditionEdge.none, condition))
            maneuver = xosc.Maneuver("walk")
            maneuver.add_event(event)
            story.add_maneuver(maneuver, name)
        xosc.Scenario(
            "A crossing", "them", self.parameters, self.entities, story,
            xosc.RoadNetwork("road.xodr"), xosc.Catalog(), osc_minor_version=2,
        ).write_xml(str(file))  # fmt: skip
        return file


@pytest.fixture
def crossing():
    file = File().add("Ego", CAR, at("south", 45.0), 7.5, leaving("north"))
    return file.add("Crossing car", CAR, at("west", 52.0), 6.5, leaving("south"))


def imported(file, tmp_path, **options):
    result = import_openscenario(file.write(tmp_path / "made.xosc"), options)
    (text,) = result.files.values()
    return yaml.safe_load(text), result.remarks


def test_what_another_library_writes_loads_runs_and_is_where_it_was(crossing, tmp_path) -> None:
    crossing.add("Walker", PERSON, at("south", 6.0, beside=5.0, ahead=0.0), 1.25)
    crossing.add("Isle", ISLAND, at("north", 20.0, beside=0.0, ahead=0.0))
    out = tmp_path / "scenarios"
    file = crossing.write(tmp_path / "made.xosc")
    assert main(["import-openscenario", str(file), f"--out={out}"]) == 0
    library = load_library([out])
    scenario = library.scenarios["openscenario/made"]
    assert scenario.duration == 20.0
    assert scenario.description == "A crossing"

    simulator = HighwaySimulator()
    simulator.reset({"world": scenario.world, "duration": 20.0}, 1)
    expected = route(0, "straight").pose(100.0 - 45.0)
    assert np.allclose(simulator._ego.position, [float(v) for v in expected[:2]], atol=1e-6)
    assert simulator._ego.speed == 7.5
    others = {car.body_id: car for car in simulator._road.vehicles if car is not simulator._ego}
    car = others["CROSSING_CAR"]
    assert np.allclose(car.position, [-63.0, 2.0], atol=1e-6)
    assert car.speed == 6.5
    walker = next(o for o in simulator._road.objects if o.body_id == "WALKER")
    assert np.allclose(walker.position, [5.0, 17.0])
    assert walker.walking == 1.25

    runner = Runner(lambda: library)
    episode = runner.run("openscenario/made", seed=1)
    assert episode.failure is None
    assert episode.signal("speed")[0] == 7.5
    assert episode.ticks > 50


@pytest.mark.parametrize(
    "ego, to, turn", [(a, b, t) for a, b, t in [
        ("south", "west", "left"), ("south", "north", "straight"), ("south", "east", "right"),
        ("east", "south", "left"), ("west", "south", "right"), ("north", "south", "straight"),
    ]]
)  # fmt: skip
def test_the_ego_s_arm_becomes_our_south_and_its_route_a_turn(ego, to, turn, tmp_path) -> None:
    file = File().add("Ego", CAR, at(ego, 45.0), 8, leaving(to))
    file.add("Other", CAR, at(to, 50.0), 8, leaving(ego))
    scenario, _ = imported(file, tmp_path)
    arms = {"left": "west", "straight": "north", "right": "east"}
    assert scenario["world"]["ego"] == {"distance": 45.0, "speed": 8.0, "turn": turn}
    (other,) = scenario["world"]["vehicles"]
    assert other["arm"] == arms[turn]
    back = {"left": "right", "straight": "straight", "right": "left"}
    assert other["turn"] == back[turn]


def test_the_junction_may_lie_anywhere_and_be_turned(tmp_path) -> None:
    x, y, heading = 120.0, -40.0, 0.3
    c, s = math.cos(heading), math.sin(heading)
    here = at("south", 30.0)
    place = xosc.WorldPosition(
        x + c * here.x - s * here.y, y + s * here.x + c * here.y, h=here.h + heading
    )
    file = File().add("Ego", CAR, place, 5)
    scenario, _ = imported(file, tmp_path, junction=f"{x},{y},{heading}")
    assert scenario["world"]["ego"]["distance"] == pytest.approx(30.0, abs=1e-3)
    with pytest.raises(ConfigurationError, match="is on no lane towards our junction"):
        imported(file, tmp_path)


def test_a_range_of_a_parameter_becomes_variation_through_expressions(tmp_path) -> None:
    file = File().parameter(
        "fast", 8.0, (xosc.Rule.greaterOrEqual, 7), (xosc.Rule.lessOrEqual, 9.5)
    )
    file.parameter("gap", 40, (xosc.Rule.greaterOrEqual, 30), (xosc.Rule.lessOrEqual, 50))
    place = at("south", 0.0)
    place.y = "${-11 - 1.4 - $gap}"
    file.add("Ego", CAR, place, "$fast", leaving("north"))
    scenario, _ = imported(file, tmp_path)
    assert scenario["world"]["ego"] == {"distance": 40.0, "speed": 8.0, "turn": "straight"}
    assert scenario["variation"] == {
        "world.ego.speed": {"min": 7.0, "max": 9.5},
        "world.ego.distance": {"min": 30.0, "max": 50.0},
    }
    assert scenario["runs"] > 1


def test_a_distribution_file_gives_choices_ranges_runs_and_seed(crossing, tmp_path) -> None:
    crossing.parameter("fast", 8.0).parameter("slow", 5.0)
    crossing.add("Third", CAR, at("north", 40.0), "$slow", leaving("south"))
    crossing.add("Fourth", CAR, at("east", 40.0), "$fast", leaving("west"))
    crossing.write(tmp_path / "made.xosc")
    stochastic = xosc.Stochastic(40, 7)
    stochastic.add_distribution("slow", xosc.UniformDistribution(xosc.Range(3, 6)))
    chances = xosc.ProbabilityDistributionSet()
    chances.add_set("6.0", 0.2)
    chances.add_set("9.0", 0.8)
    stochastic.add_distribution("fast", chances)
    file = tmp_path / "spread.xosc"
    xosc.ParameterValueDistribution(
        "spread", "them", "made.xosc", stochastic, osc_minor_version=2
    ).write_xml(str(file))
    result = import_openscenario(file, {})
    (text,) = result.files.values()
    scenario = yaml.safe_load(text)
    assert (scenario["runs"], scenario["seed"]) == (40, 7)
    assert scenario["variation"] == {
        "world.vehicles.1.speed": {"min": 3.0, "max": 6.0},
        "world.vehicles.2.speed": {"choice": [6.0, 9.0]},
    }
    assert any("spread.xosc" in remark and "as likely" in remark for remark in result.remarks)


def test_a_pedestrian_that_an_event_sets_off_starts_then(crossing, tmp_path) -> None:
    crossing.add("Walker", PERSON, at("south", 6.0, beside=-8.0, turned=-1.57, ahead=0.0), 0)
    crossing.events = [("Walker", 2.0, 1.5)]
    scenario, _ = imported(crossing, tmp_path)
    (walker,) = scenario["world"]["pedestrians"]
    assert walker == {
        "id": "WALKER", "arm": "south", "side": "left", "offset": 6.0, "start": 4.0, "speed": 1.5,
    }  # fmt: skip


def test_the_kind_of_what_is_in_a_catalogue_follows_from_its_name(crossing, tmp_path) -> None:
    def entry(name):
        return xosc.CatalogReference(f"{name}Catalog", "adult")

    crossing.add("Walker", entry("Pedestrian"), at("south", 6.0, beside=5.0, ahead=0.0), 1.0)
    crossing.add("Box", entry("MiscObject"), at("south", 20.0, ahead=0.0))
    crossing.add("Third", entry("Vehicle"), at("north", 20.0, ahead=0.0), 4.0)
    scenario, remarks = imported(crossing, tmp_path)
    world = scenario["world"]
    assert [body["id"] for body in world["pedestrians"]] == ["WALKER"]
    assert [(car["id"], car["arm"]) for car in world["vehicles"][1:]] == [("THIRD", "north")]
    assert "obstacles" not in world
    assert sum("catalogues are not read" in remark for remark in remarks) == 3 + 1


def test_one_beyond_the_arm_s_end_enters_later_and_one_beside_the_lane_is_parked(
    crossing, tmp_path
) -> None:
    crossing.add("Late", CAR, at("north", 130.0), 6.0, leaving("south"))
    crossing.add("Parked", CAR, at("east", 40.0, beside=5.5), 0)
    scenario, _ = imported(crossing, tmp_path)
    late = scenario["world"]["vehicles"][1]
    assert (late["id"], late["enters"]) == ("LATE", 5.0)
    assert scenario["world"]["obstacles"] == [
        {"id": "PARKED", "kind": "parked_car", "arm": "east", "offset": 40.0, "beside": 5.5}
    ]


@pytest.mark.parametrize(
    "entity, text",
    [
        (
            ("Fast", CAR, at("east", 40.0), 14.0),
            "14 m/s is outside of what there is, 0 to 10: it is 10",
        ),
        (("Aside", CAR, at("east", 40.0, beside=3.0), 5.0), "1.00 m to its left"),
        (("Back", CAR, at("east", 40.0, turned=math.pi), 5.0), "'Back' is left out: 4"),
        (("Inside", CAR, xosc.WorldPosition(2, 2), 5.0), "begins inside the junction"),
        (
            ("Laned", CAR, xosc.LanePosition(10, 0, -1, 1), 5.0),
            "places on a road network that is there",
        ),
        (("Aimless", CAR, at("east", 40.0), 5.0), "has no route: it goes straight on"),
        (("r2", CAR, at("east", 40.0), 5.0), "is called X_R2 here"),
    ],
)
def test_what_is_not_just_as_it_was_is_named_with_its_line(
    entity, text, crossing, tmp_path
) -> None:
    crossing.add(*entity)
    _, remarks = imported(crossing, tmp_path)
    lines = (tmp_path / "made.xosc").read_text().splitlines()
    (remark,) = [remark for remark in remarks if text in remark]
    number, tag = re.search(r":(\d+): (\w+)", remark).groups()
    assert f"<{tag}" in lines[int(number) - 1]


ROADS = """<?xml version="1.0"?>
<OpenDRIVE><header revMajor="1" revMinor="6"/>
{roads}
</OpenDRIVE>
"""
ROAD = """<road id="{id}" length="{length}" junction="-1">
<planView><geometry s="0" x="{x}" y="{y}" hdg="{heading}" length="{length}">
{shape}</geometry></planView>
<lanes><laneOffset s="0" a="0.5" b="0" c="0" d="0"/><laneSection s="0">
<left><lane id="1" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane></left>
<center><lane id="0" type="none"/></center>
<right><lane id="-1" type="shoulder"><width sOffset="0" a="1" b="0.01" c="0" d="0"/></lane>
<lane id="-2" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/></lane></right>
</laneSection></lanes></road>"""


def write_roads(folder):
    roads = [
        # From the south to the junction: 0.5 m to the left of what lanes are counted from.
        ROAD.format(id="1", length=100, x=0, y=-100, heading=math.pi / 2, shape="<line/>"),
        # From the junction to the west, which its left lane comes back from.
        ROAD.format(id="2", length=100, x=0, y=-0.5, heading=math.pi, shape="<line/>"),
        # A quarter of a circle of 60 m, which ends at (0, 60), driving south.
        ROAD.format(
            id="3", length=60 * math.pi / 2, x=60, y=120, heading=math.pi,
            shape=f'<arc curvature="{1 / 60}"/>',
        ),
    ]  # fmt: skip
    (folder / "road.xodr").write_text(ROADS.format(roads="".join(roads)))


def test_places_on_lanes_are_found_in_the_road_network(tmp_path) -> None:
    write_roads(tmp_path)
    file = File().add("Ego", CAR, xosc.LanePosition(50, 0.0, -2, 1), 5.0, leaving("west"))
    file.add("Left", CAR, xosc.LanePosition(60, 0, 1, 2), 5.0)
    file.add("Arc", CAR, xosc.RoadPosition(60 * math.pi / 2, -2.0, 3), 5.0)
    scenario, remarks = imported(file, tmp_path)
    world = scenario["world"]
    # The lanes right of the reference line are 1.5 m and 3 m wide there: 0.5 - 1.5 - 1.5 m.
    assert any("'Ego' begins in the middle" in r and "0.50 m to its left" in r for r in remarks)
    assert world["ego"]["distance"] == pytest.approx(50.0 - 11.0 - AXLE, abs=1e-3)
    left, arc = world["vehicles"]
    assert (left["arm"], left["distance"]) == ("west", pytest.approx(60 - 11 - AXLE, abs=1e-3))
    assert (arc["arm"], arc["distance"]) == ("north", pytest.approx(60 - 11 - AXLE, abs=1e-3))
    assert not any("LogicFile" in remark for remark in remarks)


@pytest.mark.parametrize(
    "place", [(50, 0, -3, 1), (150, 0, -2, 1), (50, 0, -2, 7), (50, 0, "left", 1)]
)
def test_a_place_that_the_road_network_lacks_is_named(place, crossing, tmp_path) -> None:
    write_roads(tmp_path)
    crossing.add("Lost", CAR, xosc.LanePosition(*place), 5.0)
    scenario, remarks = imported(crossing, tmp_path)
    assert len(scenario["world"]["vehicles"]) == 1
    assert any("LanePosition: there is no such place" in remark for remark in remarks)


def test_a_hostile_road_network_is_an_error(crossing, tmp_path) -> None:
    (tmp_path / "road.xodr").write_text("<!DOCTYPE a []><OpenDRIVE/>")
    with pytest.raises(ConfigurationError, match="document type") as caught:
        imported(crossing, tmp_path)
    assert caught.value.file.endswith("road.xodr")


def test_every_element_and_attribute_is_used_or_named(crossing, tmp_path) -> None:
    """Whatever is added to a file anywhere is named, with its line."""
    file = crossing.write(tmp_path / "made.xosc")
    lines = file.read_text().splitlines()
    before = import_openscenario(file, {})
    checked = 0
    for number, line in enumerate(lines):
        if not re.match(r"\s*<[A-Z]", line) or "xmlns" in line:
            continue
        # An attribute that nobody knows, then an element.
        new = re.sub(r"^(\s*<\w+)", r'\1 strange="1"', line)
        file.write_text("\n".join([*lines[:number], new, *lines[number + 1 :]]))
        attributes = import_openscenario(file, {})
        (named,) = {remark.split(": ")[0] for remark in attributes.remarks if "strange" in remark}
        assert named == f"{file}:{number + 1}"
        assert attributes.files == before.files
        checked += 1
        if not line.rstrip().endswith("/>"):
            inner = [*lines[: number + 1], "<Strange/>", *lines[number + 1 :]]
            file.write_text("\n".join(inner))
            elements = [r for r in import_openscenario(file, {}).remarks if "Strange" in r]
            assert [r.split(": ")[0] for r in elements] == [f"{file}:{number + 2}"]
    assert checked > 50


HOSTILE = {
    "laughs": (
        '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]><OpenSCENARIO>&b;</OpenSCENARIO>',
        "document type",
    ),
    "external": (
        '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/hostname">]><OpenSCENARIO>&a;</OpenSCENARIO>',
        "document type",
    ),
    "undefined": ("<OpenSCENARIO>&a;</OpenSCENARIO>", "undefined entity"),
    "deep": ("<a>" * 5000 + "</a>" * 5000, "nested too deeply"),
    "many": ("<a>" + "<b/>" * 100_001 + "</a>", "too many elements"),
    "huge": ("<a>" + " " * 10_000_001 + "</a>", "too large"),
    "broken": ("<OpenSCENARIO><a></OpenSCENARIO>", "mismatched tag"),
    "empty": ("", "no element found"),
    "binary": ("\0\1\2", "no well-formed XML"),
    "encoding": ('<?xml version="1.0" encoding="klingon"?><a/>', "encoding"),
    "other": ("<svg/>", "no OpenSCENARIO file"),
    "version": ('<OpenSCENARIO><FileHeader revMajor="2"/></OpenSCENARIO>', "version"),
    "bare": ('<OpenSCENARIO><FileHeader revMajor="1"/></OpenSCENARIO>', "no Storyboard"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_one_clear_error(name, tmp_path, capsys) -> None:
    content, problem = HOSTILE[name]
    file = tmp_path / "hostile.xosc"
    file.write_text(content)
    assert main(["import-openscenario", str(file), f"--out={tmp_path / 'out'}"]) == 2
    captured = capsys.readouterr()
    assert problem in captured.err
    assert captured.err.startswith(str(file))
    assert captured.err.count("  remedy:   ") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "value",
    ["fast", "1e999", "nan", "$missing", "${2 ** 9}", "${(1).real}", "${" + "9" * 600 + "}"],
)
def test_a_value_that_is_no_number_is_refused_with_its_line(value, tmp_path) -> None:
    file = File().add("Ego", CAR, at("south", 45.0), "$SPEED").write(tmp_path / "made.xosc")
    file.write_text(file.read_text().replace("$SPEED", value))
    with pytest.raises(ConfigurationError, match=r"is no number|no parameter 'missing'") as caught:
        import_openscenario(file, {})
    assert "AbsoluteTargetSpeed" in file.read_text().splitlines()[caught.value.line - 1]


def test_what_is_no_file_is_refused_and_a_relative_place_may_come_first(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe.xosc")
    for name in ("pipe.xosc", "missing.xosc", ".", "x" * 300):
        with pytest.raises(ConfigurationError, match="no such file"):
            import_openscenario(tmp_path / name, {})
    file = File().add("Behind", CAR, xosc.RelativeObjectPosition("Ego", -20.0, 0.0), 4.0)
    file.add("Ego", CAR, at("south", 40.0), 5.0)
    scenario, _ = imported(file, tmp_path)
    (behind,) = scenario["world"]["vehicles"]
    assert (behind["arm"], behind["distance"]) == ("south", 60.0)


def test_expressions_are_evaluated(tmp_path) -> None:
    for text, value in {
        "${1.5 + 2 * 3}": 7.5,
        "${-(2 - 8) / 4}": 1.5,
        "${round(7.6)}": 8.0,
        "${pi * $given / +pi}": 4.0,
        "${pow(2, 3)}": 8.0,
    }.items():
        made = (
            File()
            .parameter("given", "${12 / 3}")
            .parameter("odd", "${later(1)}")
            .add("Ego", CAR, at("south", 45.0), "$SPEED")
        )
        file = made.write(tmp_path / "made.xosc")
        file.write_text(file.read_text().replace("$SPEED", text))
        (made,) = import_openscenario(file, {}).files.values()
        assert yaml.safe_load(made)["world"]["ego"]["speed"] == value


def test_a_file_that_was_changed_is_not_written_over(crossing, tmp_path, capsys) -> None:
    file, out = crossing.write(tmp_path / "made.xosc"), tmp_path / "out"
    arguments = ["import-openscenario", str(file), f"--out={out}"]
    assert [main(arguments), main(arguments)] == [0, 0]
    (out / "made.yaml").write_text("name: mine")
    assert main(arguments) == 2
    assert "already, with other content" in capsys.readouterr().err
    assert (out / "made.yaml").read_text() == "name: mine"


def test_the_command_names_what_it_does_not_know(crossing, tmp_path, capsys) -> None:
    file = str(crossing.write(tmp_path / "made.xosc"))
    for given, part in itertools.product(["place=1,2", "junction=here", "junction"], ["--set"]):
        assert main(["import-openscenario", file, f"--out={tmp_path}", "--set", given]) == 2
        assert part in capsys.readouterr().err


def test_the_page_shows_what_the_command_prints_and_writes(tmp_path, monkeypatch, capsys) -> None:
    page = (DOCS / "openscenario.md").read_text("utf-8")
    (shown,) = re.findall(r"^\$ python -m pytest_dura .*\n((?:.*\n)*?)```", page, re.MULTILINE)
    (yaml_shown,) = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    shutil.copy(DOCS / "crossing.xosc", tmp_path)
    monkeypatch.chdir(tmp_path)
    assert main(["import-openscenario", "crossing.xosc"]) == 0
    assert capsys.readouterr().out == shown
    assert (tmp_path / "scenarios" / "crossing.yaml").read_text() == yaml_shown
