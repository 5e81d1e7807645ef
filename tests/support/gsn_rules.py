"""The rules of gsn2x, checked on plain data, so that a file is judged as it stands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pytest_dura.reports import root_ids
from pytest_dura.reports.gsn.element import kind_of

Node = Mapping[str, Any]

_CONTEXTS = frozenset({"Context", "Assumption", "Justification"})
_COUNTER = frozenset({"CounterGoal", "CounterSolution"})
_ALLOWED_SUPPORT = {
    "Goal": frozenset({"Goal", "Strategy", "Solution"}) | _COUNTER,
    "Strategy": frozenset({"Goal", "Strategy", "Solution"}) | _COUNTER,
    "CounterGoal": _COUNTER,
}
_LIST_KEYS = ("supportedBy", "inContextOf", "defeatedRelation")
_FLAG_KEYS = ("undeveloped", "defeated")
_TEXT_KEYS = ("text", "url", "challenges")
_MODULE_KEY = "name"
"""gsn2x takes whatever has this key for the description of a module, and not for an element."""


def rule_problems(elements: Mapping[str, Any]) -> list[str]:
    """The rules that an argument breaks, a line each; ``elements`` are without the module."""
    shape_problems = [text for id_, node in elements.items() for text in _shape_problems(id_, node)]
    if shape_problems:
        return shape_problems  # the other rules presuppose the shape of an argument
    disputed = {
        end for node in elements.values() for end in _challenged_element(_challenged_id(node))
    }
    problems: list[str] = []
    for id_, node in elements.items():
        problems += _element_problems(id_, node, elements)
        problems += _challenge_problems(id_, node, elements)
        if node.get("defeated") and id_ not in disputed:
            problems.append(f"V10 {id_}: it is marked as defeated, and nothing challenges it")
    return problems + list(_argument_problems(elements))


def _referenced_ids(node: Node, key: str) -> list[str]:
    """The ids under a key: gsn2x accepts a single one without a list."""
    value = node.get(key, [])
    return [value] if isinstance(value, str) else list(value)


def _challenged_id(node: Node) -> list[str]:
    """The id that an element challenges, both ends of a relation, or nothing."""
    return [end.strip() for end in node.get("challenges", "").split("->") if end.strip()]


def _challenged_element(ends: list[str]) -> list[str]:
    """The end of a challenge to an element: one to a relation defeats neither of its ends."""
    return ends if len(ends) == 1 else []


def _shape_problems(id_: str, node: Any) -> Iterator[str]:
    if not isinstance(node, Mapping):
        yield f"{id_}: an element is a mapping"
        return
    if _MODULE_KEY in node:
        yield f"{id_}: the key `{_MODULE_KEY}` makes gsn2x take it for a module"
    for key in _LIST_KEYS:
        value = node.get(key, [])
        references = [value] if isinstance(value, str) else value
        if not isinstance(references, list) or not all(
            isinstance(reference, str) for reference in references
        ):
            yield f"{id_}: {key} is a list of ids"
    for key in _FLAG_KEYS:
        if not isinstance(node.get(key, False), bool):
            yield f"{id_}: {key} is true or false"
    for key in _TEXT_KEYS:
        if not isinstance(node.get(key, ""), str):
            yield f"{id_}: {key} is text"
    if not node.get("text"):
        yield f"{id_}: an element has a text"


def _element_problems(id_: str, node: Node, elements: Mapping[str, Node]) -> Iterator[str]:
    kind = kind_of(id_)
    if kind is None:
        yield f"V01 {id_}: the id begins with no known prefix"
        return
    support = _referenced_ids(node, "supportedBy")
    yield from _list_problems(id_, support, "supportedBy", _ALLOWED_SUPPORT.get(kind, frozenset()))
    around = _referenced_ids(node, "inContextOf")
    argued = kind in {"Goal", "Strategy"}
    yield from _list_problems(id_, around, "inContextOf", _CONTEXTS if argued else frozenset[str]())
    yield from _development_problems(id_, node, argued=argued)
    if node.get("challenges") and kind not in _COUNTER:
        yield f"V12 {id_}: only a counter goal or a counter solution challenges"
    related = {*support, *around, *_challenged_id(node)[:1]}
    for reference in _referenced_ids(node, "defeatedRelation"):
        if reference not in related:
            yield f"V13 {id_}: its relation to {reference} is marked as defeated, and there is none"
    for reference in [*support, *around]:
        if reference not in elements:
            yield f"C03 {id_}: {reference} does not exist"


def _development_problems(id_: str, node: Node, *, argued: bool) -> Iterator[str]:
    support, undeveloped = _referenced_ids(node, "supportedBy"), node.get("undeveloped", False)
    if argued and not support and not undeveloped:
        yield f"V02 {id_}: nothing supports it, and it is not marked as undeveloped"
    if undeveloped and support:
        yield f"V03 {id_}: it is marked as undeveloped, and something supports it"
    if undeveloped and not argued:
        yield f"V03 {id_}: only a goal or a strategy is undeveloped"


def _list_problems(id_: str, listed: list[str], key: str, allowed: frozenset[str]) -> Iterator[str]:
    for reference in sorted(set(listed)):
        if listed.count(reference) > 1:
            yield f"V05 {id_}: {reference} stands twice under {key}"
        if reference == id_:
            yield f"V06 {id_}: it refers to itself under {key}"
        elif kind_of(reference) not in allowed:
            yield f"V04 {id_}: {reference} is of no kind that may stand under {key}"


def _challenge_problems(id_: str, node: Node, elements: Mapping[str, Node]) -> Iterator[str]:
    ends = _challenged_id(node)
    for end in ends:
        if end not in elements:
            yield f"C14 {id_}: it challenges {end}, which does not exist"
        if end == id_:
            yield f"C13 {id_}: it challenges itself"
    if len(ends) == 2 and ends[0] in elements:
        first, second = elements[ends[0]], ends[1]
        if ends[0] == second:
            yield f"C15 {id_}: both ends of the relation that it challenges are {second}"
        elif second not in _referenced_ids(first, "supportedBy") + _referenced_ids(
            first, "inContextOf"
        ):
            yield f"C16 {id_}: it challenges a relation of {ends[0]} to {second}: there is none"


def _argument_problems(elements: Mapping[str, Node]) -> Iterator[str]:
    top = root_ids(elements)
    if len(top) != 1:
        names = ", ".join(top) or "none"
        yield f"C01: there is exactly one element that no other refers to, and here: {names}"
    for element in top:
        if kind_of(element) != "Goal":
            yield f"C02 {element}: the element that no other refers to is a goal"
    cycle = _first_cycle(elements)
    if cycle:
        yield f"C04: {' -> '.join(cycle)} is a circle"
    for element in sorted(set(elements) - _reachable_ids(elements, top)):
        yield f"C08 {element}: it cannot be reached from the top"


def _reachable_ids(elements: Mapping[str, Node], start: list[str]) -> set[str]:
    """Ids that are reached from others: what they refer to, and what challenges them."""
    challengers: dict[str, list[str]] = {}
    for id_, node in elements.items():
        for end in _challenged_id(node):
            challengers.setdefault(end, []).append(id_)
    seen: set[str] = set()
    waiting = list(start)
    while waiting:
        current = waiting.pop()
        if current in seen or current not in elements:
            continue
        seen.add(current)
        waiting += _referenced_ids(elements[current], "supportedBy")
        waiting += _referenced_ids(elements[current], "inContextOf")
        waiting += challengers.get(current, [])
    return seen


def _first_cycle(elements: Mapping[str, Node]) -> list[str]:
    """The first circle of ``supportedBy``; not recursive, as an argument may be deep."""
    done: set[str] = set()
    for start in elements:
        path: list[str] = []
        on_path: set[str] = set()
        waiting = [(start, False)]
        while waiting:
            current, leaving = waiting.pop()
            if leaving:
                path.pop()
                on_path.discard(current)
                done.add(current)
            elif current in on_path:
                return [*path[path.index(current) :], current]
            elif current not in done and current in elements:
                path.append(current)
                on_path.add(current)
                waiting.append((current, True))
                waiting += [
                    (child, False) for child in _referenced_ids(elements[current], "supportedBy")
                ]
    return []
