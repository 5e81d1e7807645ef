"""What is drawn: an argument of hundreds of verdicts is folded, so that a picture stays one.

Violations stay to be seen, a few of each requirement; everything else is folded by its word.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from pytest_dura.evidence.formats.gsn.element import Argument, Element

MOST_CELLS = 150
"""Verdicts and untested cells that are drawn one by one."""
MOST_REQUIREMENTS = 60
_SHOWN_VIOLATED = 3
_SHOWN_REQUIREMENTS = 8
_COUNTED = ("supported", "violated", "undecided", "waived", "requirements")
_CELLS = ("verdict", "untested")


@dataclass(frozen=True)
class View:
    """An argument to draw.

    Args:
        argument: Its elements, folded ones in place of others.
        counts: By id, what an element stands for.
        folded: Sentences that say what was folded.
        against: By id, what challenges an element.
    """

    argument: Argument
    counts: dict[str, Counter[str]]
    folded: list[str] = field(default_factory=list)
    against: dict[str, list[str]] = field(default_factory=dict)


def view_of(argument: Argument) -> View:
    """The argument, or what is drawn of a large one."""
    counts = {id_: _counts(one) for id_, one in argument.items()}
    view = View(dict(argument), counts)
    for id_, one in argument.items():
        if one.challenges:
            view.against.setdefault(one.challenges, []).append(id_)
    cells = sum(what(one) in _CELLS for one in argument.values())
    if cells > MOST_CELLS:
        _fold_cells(view)
        view.folded.append(f"{cells} verdicts and untested cells are folded by requirement.")
    requirements = sum(what(one) == "requirement" for one in argument.values())
    if requirements > MOST_REQUIREMENTS:
        _fold_requirements(view)
        view.folded.append(f"{requirements} requirements are folded by kind, violated ones last.")
    return view


def what(element: Element) -> str:
    """What an element is about, by its alias."""
    return element.alias.partition(":")[0]


def _counts(one: Element) -> Counter[str]:
    kind = what(one)
    if kind == "verdict":
        return Counter({str(one.layers["verdict"]): 1})
    if kind in {"requirement", "waiver"}:
        return Counter({"requirements" if kind == "requirement" else "waived": 1})
    if kind == "unused":
        return Counter({key: int(one.layers.get(key, 0)) for key in _COUNTED})
    return Counter()


def _fold_cells(view: View) -> None:
    for parent in list(view.argument.values()):
        groups: dict[str, list[Element]] = {}
        violated = 0
        for id_ in parent.supported_by:
            child = view.argument.get(id_)
            if child is None or what(child) not in _CELLS:
                continue
            word = str(child.layers.get("verdict", "untested"))
            violated += word == "violated"
            if word != "violated" or violated > _SHOWN_VIOLATED:
                groups.setdefault(word, []).append(child)
        for word, found in groups.items():
            if len(found) > 1:
                _fold(view, parent.id, word, found)


def _fold_requirements(view: View) -> None:
    for parent in list(view.argument.values()):
        children = [view.argument[one] for one in parent.supported_by if one in view.argument]
        found = [one for one in children if what(one) == "requirement"]
        found.sort(key=lambda one: not one.defeated)
        rest = found[_SHOWN_REQUIREMENTS:]
        if len(rest) > 1:
            _fold(view, parent.id, "requirements", rest)


def _fold(view: View, parent: str, word: str, found: list[Element]) -> None:
    """Put one goal in the place of several, with the counts of all that is below them."""
    id_ = f"G/{parent}/{word}"
    counts: Counter[str] = Counter()
    for one in found:
        for below in _below(view, one.id):
            counts += view.counts.pop(below, Counter())
            view.argument.pop(below, None)
    told = ", ".join(f"{counts[key]} {key}" for key in _COUNTED[:3] if counts[key])
    several = len(found)
    text = f"{several} {word}" if word == "requirements" else f"{several} cells, {word}"
    detail = (told,) if word == "requirements" and told else ()
    view.argument[id_] = Element(
        id_,
        f"{text}: folded here, each is in assurance-case.gsn.yaml. {told}",
        undeveloped=word in {"undecided", "untested"},
        defeated=word == "violated",
        alias=f"folded:{word}",
        layers={"verdict": word},
        brief=(text, *detail, "folded"),
    )
    view.counts[id_] = counts
    gone = {one.id for one in found}
    for other in list(view.argument.values()):
        if gone & set(other.supported_by):
            kept = tuple(one for one in other.supported_by if one not in gone)
            view.argument[other.id] = replace(other, supported_by=(*kept, id_))


def _below(view: View, start: str) -> Iterator[str]:
    """The element and all below it, with what challenges those."""
    waiting, seen = [start], set[str]()
    while waiting:
        one = waiting.pop()
        if one in seen or one not in view.argument:
            continue
        seen.add(one)
        element = view.argument[one]
        waiting += [*element.supported_by, *element.in_context_of, *view.against.get(one, ())]
    yield from seen
