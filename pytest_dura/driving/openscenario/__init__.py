"""Import of OpenSCENARIO files (``.xosc``, versions 1.x) as scenarios at our junction."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.domains import Imported
from pytest_dura.driving.openscenario.document import Element, read_document
from pytest_dura.driving.openscenario.mapping import World, world_of
from pytest_dura.driving.openscenario.parameters import Parameters, declared, distributed
from pytest_dura.driving.openscenario.place import Frame
from pytest_dura.driving.openscenario.roads import RoadNetwork

_DURATION = 40.0
_RUNS = 15
_REQUIREMENTS = ["SAF-1", "SAF-2"]
_REASONS = {
    "LanePosition": "of a route the end alone is read, and places on a road network that is there",
    "RoadPosition": "of a route the end alone is read, and places on a road network that is there",
    "WorldPosition": "of a route the end alone is read",
    "Waypoint": "of a route the end alone is read",
    "Route": "a name or a return to the beginning has no counterpart",
    "Condition": "names and edges of conditions have no counterpart",
    "RoadNetwork": "the road is our junction",
    "LogicFile": "the road is our junction",
    "GlobalAction": "weather, signals and other global actions have no counterpart",
    "Story": "what happens during the scenario is not read: the others drive by our driver model",
    "CatalogLocations": "catalogues are not read",
    "Performance": "the others accelerate and brake as our driver model does",
    "Axles": "a car here has no axles",
    "Dimensions": "cars are 5 m by 2 m, pedestrians 0.6 m wide",
    "Properties": "properties have no counterpart",
    "ObjectController": "the ego is driven by the component under test, the others by our model",
}
_NO_COUNTERPART = "has no counterpart"


@dataclass
class _Remarks:
    """What is said of elements, each thing once."""

    texts: dict[tuple[str, int, str], None] = field(default_factory=dict)

    def add(self, element: Element, text: str) -> None:
        """Say something of an element that is used."""
        line = (element.file, element.line, f"{element.tag}: {text}")
        self.texts.setdefault(line)

    def add_unused(self, root: Element) -> None:
        """Name each element and attribute that was not used."""
        for element, attributes, within in root.unused():
            given = "".join(f" {name}={element.attributes[name]!r}" for name in attributes)
            given += f" {element.text[:40]!r}" if element.text else ""
            reason = f"within {within}" if within else _REASONS.get(element.tag, _NO_COUNTERPART)
            self.texts.setdefault((element.file, element.line, f"{element.tag}{given}: {reason}"))

    @property
    def lines(self) -> list[str]:
        """The remarks by file and line."""
        return [f"{file}:{line}: {text}" for file, line, text in sorted(self.texts)]


def import_openscenario(file: Path, options: Mapping[str, str]) -> Imported:
    """Make a scenario of a file, and name line by line what of it does not map.

    Args:
        file: A scenario, or a ParameterValueDistribution, whose scenario is read as well.
        options: ``junction``: ``X,Y`` or ``X,Y,HEADING``, where our junction lies in the world of
            the file, in m and rad; by default at its origin.

    Raises:
        ConfigurationError: If it is no such file, or has no ego at the junction.
    """
    remarks, frame = _Remarks(), _frame(options)
    root = read_document(file)
    plan: dict[str, int] = {}
    distribution = root.find("ParameterValueDistribution")
    described = root
    if distribution is not None:
        path = distribution.find("ScenarioFile")
        if path is None:
            distribution.refuse("a distribution names its scenario", expected="a ScenarioFile")
        described = read_document(file.parent / path.require("filepath"))
    _check_version(described)
    parameters = declared(described, remarks.add)
    if distribution is not None:
        _check_version(root)
        plan = distributed(distribution, parameters, remarks.add)
    network = _network(described)
    make = partial(world_of, described, frame=frame, network=network, remark=remarks.add)
    world = make(parameters)
    variation = dict(_variation(make, parameters, world, remarks))
    text = _text(file, described, world, variation, plan)
    for each in {id(described): described, id(root): root}.values():
        remarks.add_unused(each)
    return Imported({f"{_slug(file)}.yaml": text}, tuple(remarks.lines))


def _frame(options: Mapping[str, str]) -> Frame:
    unknown = sorted(set(options) - {"junction"})
    try:
        numbers = [float(part) for part in options.get("junction", "0,0").split(",")]
        usable = len(numbers) in (2, 3) and all(abs(number) < 1e9 for number in numbers)
    except ValueError:
        usable = False
    if unknown or not usable:
        raise ConfigurationError(
            "this says not where the junction lies",
            key="--set",
            found=unknown[0] if unknown else options["junction"],
            expected="junction=X,Y or junction=X,Y,HEADING, in m and rad",
        )
    x, y, heading = (*numbers, 0.0)[:3]
    return Frame(x, y, heading)


def _network(root: Element) -> RoadNetwork | None:
    """Read the road network that a file names; ``None`` if there is no such file."""
    elements = [element for child in root.children for element in child.children]
    logic = next((element for element in elements if element.tag == "LogicFile"), None)
    name = None if logic is None else logic.attributes.get("filepath")
    file = None if name is None else Path(root.file).parent / name
    if file is None or logic is None or not os.path.isfile(file):  # noqa: PTH113 - never raises
        return None
    root.find("RoadNetwork", "LogicFile")
    logic.get("filepath")
    return RoadNetwork.read(file)


def _check_version(root: Element) -> None:
    header = root.find("FileHeader")
    if root.tag != "OpenSCENARIO" or header is None:
        root.refuse(
            "this is no OpenSCENARIO file",
            found=root.tag,
            expected="OpenSCENARIO XML 1.x",
            remedy="name an .xosc file",
        )
    if header.get("revMajor") != "1":
        header.refuse(
            "this version of OpenSCENARIO is not read",
            found=header.attributes.get("revMajor", "none"),
            expected="revMajor 1",
        )
    for name in ("revMinor", "author", "date", "description"):
        header.get(name)


def _variation(
    make: Callable[[Parameters], World], parameters: Parameters, world: World, remarks: _Remarks
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what each parameter with a spread sets, by trying its values."""
    nominal = dict(_leaves(world.data))
    owners: dict[str, str] = {}
    for name, spread in parameters.spreads.items():
        worlds = [make(parameters.with_value(name, sample)) for sample in spread.samples]
        columns = [dict(_leaves(each.data)) for each in worlds]
        if any(column.keys() != nominal.keys() for column in columns):
            remarks.add(spread.where, f"{name} changes who is there: it is held")
            continue
        if len({each.duration for each in worlds}) > 1:
            remarks.add(spread.where, f"{name} changes the duration, which is held")
        paths = [path for path in nominal if len({str(column[path]) for column in columns}) > 1]
        if not paths:
            remarks.add(spread.where, f"{name} sets nothing that is mapped")
        if len(paths) > 1:
            listed = ", ".join(f"world.{path}" for path in paths)
            remarks.add(spread.where, f"{name} sets {listed}, which vary independently here")
        for path in paths:
            values = [column[path] for column in columns]
            if path in owners:
                remarks.add(spread.where, f"world.{path} varies with {owners[path]} alone")
            elif spread.values:
                owners[path] = name
                yield f"world.{path}", {"choice": list(dict.fromkeys(values))}
            elif isinstance(values[0], float):
                owners[path] = name
                yield f"world.{path}", {"min": min(values), "max": max(values)}
            else:
                remarks.add(spread.where, f"{name} changes world.{path}, which is held")


def _leaves(data: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _leaves(value, f"{path}.{key}" if path else str(key))
    elif isinstance(data, list):
        for index, value in enumerate(data):
            yield from _leaves(value, f"{path}.{index}")
    else:
        yield path, data


def _text(
    file: Path, root: Element, world: World, variation: dict[str, Any], plan: Mapping[str, int]
) -> str:
    header = root.find("FileHeader")
    about = {} if header is None else header.attributes
    origin = [file.name, *(about[key] for key in ("author", "date") if about.get(key))]
    comments = [f"From {', '.join(origin)}."]
    comments += [f"{theirs} is {ours} here." for theirs, ours in world.ids.items()]
    scenario: dict[str, Any] = {"name": f"openscenario/{_slug(file)}"}
    if about.get("description"):
        scenario["description"] = " ".join(about["description"].split())[:200]
    scenario |= {"simulator": "driving", "duration": world.duration or _DURATION}
    scenario["runs"] = plan.get("runs", _RUNS if variation else 1)
    if "seed" in plan:
        scenario["seed"] = plan["seed"]
    scenario["world"] = world.data
    if variation:
        scenario["variation"] = variation
    scenario["requirements"] = _REQUIREMENTS
    heading = "".join(f"# {' '.join(line.split())}\n" for line in comments)
    dumped = yaml.safe_dump(scenario, sort_keys=False, default_flow_style=None, width=100)
    return heading + dumped


def _slug(file: Path) -> str:
    slug = re.sub(r"[^A-Za-z0-9_-]+", "-", file.stem).strip("-_")
    return slug or "scenario"


__all__ = ["import_openscenario"]
