"""Parameters of OpenSCENARIO: references and expressions, constraints and distributions."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.driving.openscenario.document import Element

_REFERENCE = re.compile(r"\$([A-Za-z_]\w*)")
_LONGEST = 500
MAX_RUNS = 1_000_000
_BINARY: Mapping[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: math.fmod,
}
_FUNCTIONS: Mapping[str, Callable[[float], float]] = {
    "round": lambda x: float(round(x)),
    "floor": math.floor,
    "ceil": math.ceil,
    "sqrt": math.sqrt,
    "abs": abs,
}


@dataclass(frozen=True)
class Spread:
    """Values that a parameter may take.

    Args:
        where: The element that says so.
        low: Least value of a range.
        high: Greatest value of a range.
        values: Or the values themselves, as texts.
    """

    where: Element
    low: float = 0.0
    high: float = 0.0
    values: tuple[str, ...] = ()

    @property
    def samples(self) -> tuple[str, ...]:
        """The values; of a range its ends and its middle."""
        return self.values or tuple(map(repr, (self.low, (self.low + self.high) / 2, self.high)))


@dataclass
class Parameters:
    """Values of the parameters by name, and what spreads them.

    Args:
        values: Texts by name.
        spreads: By name.
        elements: Where each is declared.
    """

    values: dict[str, str] = field(default_factory=dict)
    spreads: dict[str, Spread] = field(default_factory=dict)
    elements: dict[str, Element] = field(default_factory=dict)

    def with_value(self, name: str, value: str) -> Parameters:
        """Copy with another value of a parameter."""
        return Parameters({**self.values, name: value}, self.spreads, self.elements)

    def text(self, element: Element, name: str) -> str:
        """Return a required attribute with its references replaced.

        Raises:
            ConfigurationError: For an unknown parameter.
        """
        return self._replaced(element, element.require(name))

    def number(self, element: Element, name: str, default: float | None = None) -> float:
        """Return an attribute as a finite number, evaluated if it is an expression.

        Args:
            element: The element.
            name: Of the attribute.
            default: Its value where it is missing; by default it is required.

        Raises:
            ConfigurationError: If it is missing or no number.
        """
        if default is not None and element.get(name) is None:
            return default
        given = element.require(name)
        text = self._replaced(element, given).strip()
        if text.startswith("${") and text.endswith("}"):
            text = text[2:-1]
        try:
            value = _evaluate(text)
        except (ValueError, SyntaxError, ArithmeticError, RecursionError, MemoryError):
            value = math.nan
        if not math.isfinite(value):
            element.refuse(
                f"{name} of {element.tag} is no number",
                key=f"{element.tag}.{name}",
                found=given,
                expected="a finite number, a parameter, or an expression of them",
            )
        return value

    def _replaced(self, element: Element, text: str) -> str:
        def value(match: re.Match[str]) -> str:
            if match[1] not in self.values:
                element.refuse(
                    f"there is no parameter {match[1]!r}",
                    key=element.tag,
                    found=text[:_LONGEST],
                    expected=", ".join(sorted(self.values)) or "a declared parameter",
                )
            return self.values[match[1]]

        return _REFERENCE.sub(value, text)


def _evaluate(text: str) -> float:
    """Evaluate arithmetic on numbers."""
    if len(text) > _LONGEST:
        raise ValueError(text)
    try:
        return float(text)
    except ValueError:
        return float(_value(ast.parse(text, mode="eval").body))


def _value(node: Any) -> float:
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return float(number)
        case ast.Name(id="pi"):
            return math.pi
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=inner):
            return -_value(inner) if isinstance(sign, ast.USub) else _value(inner)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _BINARY[type(op)](_value(left), _value(right))
        case ast.Call(func=ast.Name(id=name), args=[inner], keywords=[]) if name in _FUNCTIONS:
            return _FUNCTIONS[name](_value(inner))
        case ast.Call(func=ast.Name(id="pow"), args=[base, exponent], keywords=[]):
            return math.pow(_value(base), _value(exponent))
    raise ValueError(ast.dump(node)[:_LONGEST])


def declared(root: Element, remark: Callable[[Element, str], None]) -> Parameters:
    """Read the parameters that a scenario declares, and the ranges of their constraints."""
    parameters = Parameters()
    declarations = root.find("ParameterDeclarations")
    for element in declarations.all("ParameterDeclaration") if declarations else []:
        name = element.require("name")
        element.get("parameterType")
        value = parameters.text(element, "value")
        if value.startswith("${"):
            with suppress(ConfigurationError):  # it is one where the parameter is used
                value = repr(parameters.number(element, "value"))
        parameters.values[name] = value
        parameters.elements[name] = element
        spread = _constrained(element, parameters, remark)
        if spread is not None:
            parameters.spreads[name] = spread
    return parameters


def _constrained(
    element: Element, parameters: Parameters, remark: Callable[[Element, str], None]
) -> Spread | None:
    groups = element.all("ConstraintGroup")
    rules = [
        [(rule.require("rule"), rule.require("value")) for rule in group.all("ValueConstraint")]
        for group in groups
    ]
    if not groups:
        return None
    if all([rule for rule, _ in group] == ["equalTo"] for group in rules):
        return Spread(element, values=tuple(value for ((_, value),) in rules))
    low = [value for rule, value in rules[0] if rule.startswith("greater")]
    high = [value for rule, value in rules[0] if rule.startswith("less")]
    if len(groups) > 1 or len(low) != 1 or len(high) != 1 or len(rules[0]) != 2:
        remark(element, "its constraints are neither one range nor a list of values: held")
        return None
    for rule, value in rules[0]:
        if not rule.endswith("OrEqual"):
            remark(element, f"the bound {value} itself may be drawn")
    ends = [
        parameters.with_value("_", value).number(_with_value(element, value), "value")
        for value in (low[0], high[0])
    ]
    return Spread(element, min(ends), max(ends))


def _with_value(element: Element, value: str) -> Element:
    return Element(element.file, element.line, element.tag, {"value": value})


def distributed(
    root: Element, parameters: Parameters, remark: Callable[[Element, str], None]
) -> dict[str, int]:
    """Read a ParameterValueDistribution into the spreads of a scenario's parameters.

    Returns:
        What it says of runs: ``runs`` and ``seed``, where it does.
    """
    plan: dict[str, int] = {}
    deterministic, stochastic = root.find("Deterministic"), root.find("Stochastic")
    if deterministic is not None:
        for single in deterministic.all("DeterministicSingleParameterDistribution"):
            _take(single, parameters, remark)
    if stochastic is not None:
        runs = parameters.number(stochastic, "numberOfTestRuns")
        plan["runs"] = int(min(max(runs, 1.0), MAX_RUNS))
        seed = parameters.number(stochastic, "randomSeed", -1.0)
        if 0.0 <= seed < 2.0**53:
            plan["seed"] = int(seed)
        if plan["runs"] != runs or (stochastic.get("randomSeed") and "seed" not in plan):
            remark(stochastic, f"runs are whole numbers from 1 to {MAX_RUNS}, seeds at least 0")
        for single in stochastic.all("StochasticDistribution"):
            _take(single, parameters, remark)
    return plan


def _take(single: Element, parameters: Parameters, remark: Callable[[Element, str], None]) -> None:
    name = single.require("parameterName")
    if name not in parameters.values:
        single.refuse(f"the scenario declares no parameter {name!r}", key=single.tag)
    if (chosen := single.find("DistributionSet")) is not None:
        values = tuple(element.require("value") for element in chosen.all("Element"))
        parameters.spreads[name] = Spread(single, values=values)
        return
    if (chosen := single.find("ProbabilityDistributionSet")) is not None:
        elements = chosen.all("Element")
        remark(chosen, "each value is as likely as the others here, whatever its weight")
        parameters.spreads[name] = Spread(
            single, values=tuple(element.require("value") for element in elements)
        )
        return
    for tag in ("DistributionRange", "UniformDistribution", "NormalDistribution"):
        bounds = single.find(tag, "Range")
        if bounds is not None:
            low, high = (parameters.number(bounds, f"{end}Limit") for end in ("lower", "upper"))
            parameters.spreads[name] = Spread(single, min(low, high), max(low, high))
            if tag != "UniformDistribution":
                element = single.find(tag)
                assert element is not None
                remark(element, "drawn uniformly from its range here")
            return
    remark(single, f"its kind of distribution has no counterpart: {name} is held")
