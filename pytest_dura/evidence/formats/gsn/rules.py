"""The rules that gsn2x documents for an argument, and checks under the codes given here.

They are checked on plain data, so that a file is judged as it stands, whoever wrote it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pytest_dura.evidence.formats.gsn.element import kind_of

Node = Mapping[str, Any]

_CONTEXTS = frozenset({"Context", "Assumption", "Justification"})
_COUNTER = frozenset({"CounterGoal", "CounterSolution"})
_SUPPORT = {
    "Goal": frozenset({"Goal", "Strategy", "Solution"}) | _COUNTER,
    "Strategy": frozenset({"Goal", "Strategy", "Solution"}) | _COUNTER,
    "CounterGoal": _COUNTER,
}
_LISTS = ("supportedBy", "inContextOf", "defeatedRelation")
_FLAGS = ("undeveloped", "defeated")
_TEXTS = ("text", "url", "challenges")
TAKEN_FOR_MODULE = "name"
"""gsn2x takes whatever has this key for the description of a module, and not for an element."""


def problems(elements: Mapping[str, Any]) -> list[str]:
    """Everything in which an argument breaks the rules; ``elements`` are without the module."""
    shapes = [problem for id_, node in elements.items() for problem in _shape(id_, node)]
    if shapes:
        return shapes  # nothing else can be said of what is not an argument at all
    disputed = {end for node in elements.values() for end in _only(challenged(node))}
    found: list[str] = []
    for id_, node in elements.items():
        found += _element(id_, node, elements)
        found += _challenge(id_, node, elements)
        if node.get("defeated") and id_ not in disputed:
            found.append(f"V10 {id_}: it is marked as defeated, and nothing challenges it")
    return found + list(_whole(elements))


def references(node: Node, key: str) -> list[str]:
    """The ids under a key: gsn2x accepts a single one without a list."""
    value = node.get(key, [])
    return [value] if isinstance(value, str) else list(value)


def challenged(node: Node) -> list[str]:
    """The id that an element challenges, both ends of a relation, or nothing."""
    return [end.strip() for end in node.get("challenges", "").split("->") if end.strip()]


def _only(ends: list[str]) -> list[str]:
    """The end of a challenge to an element: one to a relation defeats neither of its ends."""
    return ends if len(ends) == 1 else []


def _shape(id_: str, node: Any) -> Iterator[str]:
    if not isinstance(node, Mapping):
        yield f"{id_}: an element is a mapping"
        return
    if TAKEN_FOR_MODULE in node:
        yield f"{id_}: the key `{TAKEN_FOR_MODULE}` makes gsn2x take it for a module"
    for key in _LISTS:
        value = node.get(key, [])
        items = [value] if isinstance(value, str) else value
        if not isinstance(items, list) or not all(isinstance(one, str) for one in items):
            yield f"{id_}: {key} is a list of ids"
    for key in _FLAGS:
        if not isinstance(node.get(key, False), bool):
            yield f"{id_}: {key} is true or false"
    for key in _TEXTS:
        if not isinstance(node.get(key, ""), str):
            yield f"{id_}: {key} is text"
    if not node.get("text"):
        yield f"{id_}: an element has a text"


def _element(id_: str, node: Node, elements: Mapping[str, Node]) -> Iterator[str]:
    kind = kind_of(id_)
    if kind is None:
        yield f"V01 {id_}: the id begins with no known prefix"
        return
    support = references(node, "supportedBy")
    yield from _listed(id_, support, "supportedBy", _SUPPORT.get(kind, frozenset()))
    around = references(node, "inContextOf")
    argued = kind in {"Goal", "Strategy"}
    yield from _listed(id_, around, "inContextOf", _CONTEXTS if argued else frozenset[str]())
    yield from _developed(id_, node, argued=argued)
    if node.get("challenges") and kind not in _COUNTER:
        yield f"V12 {id_}: only a counter goal or a counter solution challenges"
    related = {*support, *around, *challenged(node)[:1]}
    for one in references(node, "defeatedRelation"):
        if one not in related:
            yield f"V13 {id_}: its relation to {one} is marked as defeated, and there is none"
    for one in [*support, *around]:
        if one not in elements:
            yield f"C03 {id_}: {one} does not exist"


def _developed(id_: str, node: Node, *, argued: bool) -> Iterator[str]:
    support, undeveloped = references(node, "supportedBy"), node.get("undeveloped", False)
    if argued and not support and not undeveloped:
        yield f"V02 {id_}: nothing supports it, and it is not marked as undeveloped"
    if undeveloped and support:
        yield f"V03 {id_}: it is marked as undeveloped, and something supports it"
    if undeveloped and not argued:
        yield f"V03 {id_}: only a goal or a strategy is undeveloped"


def _listed(id_: str, listed: list[str], key: str, allowed: frozenset[str]) -> Iterator[str]:
    for one in sorted(set(listed)):
        if listed.count(one) > 1:
            yield f"V05 {id_}: {one} stands twice under {key}"
        if one == id_:
            yield f"V06 {id_}: it refers to itself under {key}"
        elif kind_of(one) not in allowed:
            yield f"V04 {id_}: {one} is of no kind that may stand under {key}"


def _challenge(id_: str, node: Node, elements: Mapping[str, Node]) -> Iterator[str]:
    ends = challenged(node)
    for one in ends:
        if one not in elements:
            yield f"C14 {id_}: it challenges {one}, which does not exist"
        if one == id_:
            yield f"C13 {id_}: it challenges itself"
    if len(ends) == 2 and ends[0] in elements:
        first, second = elements[ends[0]], ends[1]
        if ends[0] == second:
            yield f"C15 {id_}: both ends of the relation that it challenges are {second}"
        elif second not in references(first, "supportedBy") + references(first, "inContextOf"):
            yield f"C16 {id_}: it challenges a relation of {ends[0]} to {second}: there is none"


def roots(elements: Mapping[str, Node]) -> list[str]:
    """Ids of the elements that no other refers to, and that challenge nothing."""
    told = {
        one
        for node in elements.values()
        for one in references(node, "supportedBy") + references(node, "inContextOf")
    }
    return [id_ for id_, node in elements.items() if id_ not in told and not node.get("challenges")]


def _whole(elements: Mapping[str, Node]) -> Iterator[str]:
    top = roots(elements)
    if len(top) != 1:
        names = ", ".join(top) or "none"
        yield f"C01: there is exactly one element that no other refers to, and here: {names}"
    for one in top:
        if kind_of(one) != "Goal":
            yield f"C02 {one}: the element that no other refers to is a goal"
    cycle = _cycle(elements)
    if cycle:
        yield f"C04: {' -> '.join(cycle)} is a circle"
    for one in sorted(set(elements) - reachable(elements, top)):
        yield f"C08 {one}: it cannot be reached from the top"


def reachable(elements: Mapping[str, Node], start: list[str]) -> set[str]:
    """Ids that are reached from others: what they refer to, and what challenges them."""
    challengers: dict[str, list[str]] = {}
    for id_, node in elements.items():
        for end in challenged(node):
            challengers.setdefault(end, []).append(id_)
    seen: set[str] = set()
    waiting = list(start)
    while waiting:
        one = waiting.pop()
        if one in seen or one not in elements:
            continue
        seen.add(one)
        waiting += references(elements[one], "supportedBy")
        waiting += references(elements[one], "inContextOf")
        waiting += challengers.get(one, [])
    return seen


def _cycle(elements: Mapping[str, Node]) -> list[str]:
    """The first circle of ``supportedBy``; not recursive, as a user's argument may be deep."""
    done: set[str] = set()
    for start in elements:
        path: list[str] = []
        on_path: set[str] = set()
        waiting = [(start, False)]
        while waiting:
            one, leaving = waiting.pop()
            if leaving:
                path.pop()
                on_path.discard(one)
                done.add(one)
            elif one in on_path:
                return [*path[path.index(one) :], one]
            elif one not in done and one in elements:
                path.append(one)
                on_path.add(one)
                waiting.append((one, True))
                waiting += [(child, False) for child in references(elements[one], "supportedBy")]
    return []
