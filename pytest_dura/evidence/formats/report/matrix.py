"""A matrix of requirements and places, laid out so that it is not wider than it needs to be."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

Heading = Mapping[str, Any]
"""``label``, ``below`` (a second line, or empty) and ``anchor`` (or ``None``)."""


def heading(label: str, below: str = "", anchor: str | None = None) -> Heading:
    """What a row or column is."""
    return {"label": label, "below": below, "anchor": anchor}


def matrix(
    requirements: Sequence[Heading],
    places: Sequence[Heading],
    cell: Callable[[int, int], Any],
    place: str,
) -> Mapping[str, Any]:
    """``corner``, ``columns`` and ``rows``; whichever there is less of stands in the columns.

    Args:
        requirements: Their headings.
        places: Headings of what they are held against.
        cell: What stands at the numbers of a requirement and a place.
        place: What a place is called.
    """
    if len(places) <= len(requirements):
        rows = [
            {**one, "cells": [cell(i, j) for j in range(len(places))]}
            for i, one in enumerate(requirements)
        ]
        return {"corner": "Requirement", "columns": places, "rows": rows}
    rows = [
        {**one, "cells": [cell(i, j) for i in range(len(requirements))]}
        for j, one in enumerate(places)
    ]
    return {"corner": place, "columns": requirements, "rows": rows}
