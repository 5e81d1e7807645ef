"""Binding: the numbers in the payloads of a link, in a YAML file, with their units.

A payload holds the numbers of its list in order, then a text: of a reset the seed and the time step
before the scenario as JSON, of a tick its status before why it is critical, of a command why it was
chosen. A peer in C reads the numbers and leaves the text.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from functools import cached_property
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr

from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.trust import check_names
from pytest_dura.domains import Domain, domain_of
from pytest_dura.library.documents import Document, read_yaml, validate

_FORMATS = {"f64": "d", "f32": "f"}
RESET = struct.Struct("<Qd")
"""Seed and time step in s, of a reset."""
STATUS = struct.Struct("<B")
"""Status of a tick: 0 to go on, 1 goal, 2 critical, 3 truncated."""


class Number(BaseModel):
    """A number on the wire."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )

    name: str = Field(min_length=1)
    """A channel or a field of one (`gauge.level`), an action, or a signal of the truth."""
    unit: str = Field(min_length=1)
    """Unit on the wire; where the domain has another one, `scale` or `offset` convert it."""
    type: Literal["f64", "f32"] = "f64"
    """IEEE 754, in 8 or 4 bytes."""
    scale: float = 1.0
    """The number on the wire is ours times `scale`, plus `offset`."""
    offset: float = 0.0
    """See `scale`."""


Numbers = Annotated[tuple[Number, ...], Field(strict=False)]


class Binding(BaseModel):
    """A binding file."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, use_attribute_docstrings=True
    )

    domain: str | None = None
    """A registered domain or `package.module:NAME`, against which names and units are checked."""
    percept: Numbers = ()
    """Numbers of the sensor channels: to a component, from a simulator."""
    command: Numbers = Field(default=(), min_length=1)
    """Numbers of the action: from a component, to a simulator."""
    truth: Numbers = ()
    """Signals of the truth, from a simulator."""
    action: str | None = None
    """Class `package.module:Name` that is made of the command's numbers by name. Without it an
    action is a number, or a mapping where there are several."""

    _source: Document = PrivateAttr(default_factory=Document)

    @classmethod
    def read(cls, file: str | Path) -> Binding:
        """Read a binding file.

        Raises:
            ConfigurationError: For what it must not hold, with the line.
        """
        document = read_yaml(Path(file))
        return validate(cls, document).checked(document)

    def checked(self, document: Document) -> Binding:
        """Check what no key says alone, and return itself.

        Raises:
            ConfigurationError: With the line of the document.
        """
        self._source = document
        if self.domain is not None:
            self._check_domain(domain_of("", self.domain))
        for key in ("percept", "command", "truth"):
            numbers: Sequence[Number] = getattr(self, key)
            for index, number in enumerate(numbers):
                if number.name in [before.name for before in numbers[:index]]:
                    raise self._error(f"{key}.{index}", f"{number.name!r} is there twice")
                if number.scale == 0.0:
                    raise self._error(f"{key}.{index}", f"the scale of {number.name!r} is 0")
        return self

    def pack(self, key: str, values: Any) -> bytes:
        """Pack the numbers of a list, see :meth:`numbers`."""
        numbers: Sequence[Number] = getattr(self, key)
        ours = zip(self.numbers(key, values), numbers, strict=True)
        return self._layouts[key].pack(*(v * number.scale + number.offset for v, number in ours))

    def numbers(self, key: str, values: Any) -> list[float]:
        """Return the numbers of a list, in order; NaN for what a fault removed.

        Args:
            key: ``percept``, ``command`` or ``truth``.
            values: The percept, the action, or the truth.
        """
        numbers: Sequence[Number] = getattr(self, key)
        if key == "command" and isinstance(values, Real) and len(numbers) == 1:
            values = {numbers[0].name: values}
        return [_value_at(values, number.name) for number in numbers]

    def split(self, key: str, payload: bytes) -> tuple[dict[str, float], bytes]:
        """Unpack a list; returns what comes after it, too.

        Raises:
            ValueError: If it is too short, or a number of truth or command is not finite.
        """
        layout: struct.Struct = self._layouts[key]
        if len(payload) < layout.size:
            raise ValueError(
                f"a payload of {len(payload)} bytes; the numbers of `{key}` take {layout.size}"
            )
        numbers: Sequence[Number] = getattr(self, key)
        wire = zip(layout.unpack_from(payload), numbers, strict=True)
        values = {number.name: (value - number.offset) / number.scale for value, number in wire}
        for name, value in values.items():
            if not math.isfinite(value) and key != "percept":
                raise ValueError(f"{name} is {value}")
        return values, payload[layout.size :]

    def unpack(self, key: str, payload: bytes) -> tuple[dict[str, float], str]:
        """Unpack a list, and the text after it.

        Raises:
            ValueError: See :meth:`split`; also if the text is not UTF-8.
        """
        values, rest = self.split(key, payload)
        return values, rest.decode()

    def action_of(self, values: Mapping[str, float]) -> Any:
        """Make the action of a command's numbers."""
        if self.action is not None:
            return self._action_class(**values)
        return next(iter(values.values())) if len(values) == 1 else dict(values)

    def channels_of(self, values: Mapping[str, float]) -> Mapping[str, Any]:
        """Make sensor channels of a percept's numbers: mappings of those with fields."""
        channels: dict[str, Any] = {}
        for name, value in values.items():
            channel, dot, field = name.partition(".")
            if dot:
                channels.setdefault(channel, {})[field] = value
            else:
                channels[channel] = value
        return MappingProxyType(
            {k: MappingProxyType(v) if isinstance(v, dict) else v for k, v in channels.items()}
        )

    @cached_property
    def _layouts(self) -> dict[str, struct.Struct]:
        lists = {key: getattr(self, key) for key in ("percept", "command", "truth")}
        return {
            key: struct.Struct("<" + "".join(_FORMATS[number.type] for number in numbers))
            for key, numbers in lists.items()
        }

    @cached_property
    def _action_class(self) -> Any:
        assert self.action is not None
        check_names(self.action)
        return RoleSpec(self.action).function()

    def _check_domain(self, domain: Domain | None) -> None:
        """Refuse names that the domain does not have, and other units without a conversion."""
        assert domain is not None
        channels = domain.channels or {}
        known = {
            "command": {action.name: action.unit for action in domain.actions},
            "truth": {signal.name: signal.unit for signal in domain.signals or ()},
            "percept": {
                f"{name}.{field}": unit
                for name, channel in channels.items()
                for field, unit in zip(channel.fields, channel.units, strict=False)
            },
        }
        for key, units in known.items():
            for index, number in enumerate(getattr(self, key) if units else ()):
                unit = units.get(number.name)
                is_channel = key == "percept" and number.name in channels
                if unit is None and not is_channel:
                    remedy = did_you_mean(number.name, units)
                    raise self._error(
                        f"{key}.{index}", f"{domain.name!r} has no {number.name!r}", remedy
                    )
                converted = (number.scale, number.offset) != (1.0, 0.0)
                if unit not in (None, number.unit) and not converted:
                    raise self._error(
                        f"{key}.{index}",
                        f"{number.name!r} is in {unit} in the domain {domain.name!r}, and in "
                        f"{number.unit} on the wire",
                        "give `scale`: number on the wire = ours x scale + offset",
                    )

    def _error(self, key: str, problem: str, remedy: str = "correct it") -> ConfigurationError:
        line = self._source.line_of(key)
        return ConfigurationError(
            problem, file=self._source.file, line=line, key=key, remedy=remedy
        )


def part_at(values: Any, path: str) -> Any:
    """Part at a dotted path of mappings and attributes; ``None`` where none is there."""
    for part in path.split("."):
        is_mapping = isinstance(values, Mapping)
        values = values.get(part) if is_mapping else getattr(values, part, None)
    return values


def _value_at(values: Any, path: str) -> float:
    """Number at a path; NaN where none is there."""
    value = part_at(values, path)
    return float(value) if isinstance(value, Real) else math.nan
