"""A user's own argument: read safely, with the line of each key, and laid over the generated one.

The user's file defines the top goal and strategies, and refers to generated elements by their id
or alias: ``supportedBy: [requirement:SAF-1, monitors]``. Whatever it takes up comes with all that
is below it and all that challenges it. What it does not take up is listed in contexts of its top
goal, and a violation among that challenges it: nothing is dropped.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.session_model import ArgumentEntry
from pytest_dura.evidence.text import name, one_line, visible
from pytest_dura.reports.gsn.argument import generated_argument
from pytest_dura.reports.gsn.element import (
    FLAG_KEYS,
    LIST_KEYS,
    PREFIXES,
    TEXT_KEYS,
    Argument,
    Element,
    derived_id,
    kind_of,
    reachable_ids,
    root_ids,
    rule_problems,
)
from pytest_dura.reports.gsn.requirements import COUNTEREXAMPLE_PREFIX
from pytest_dura.reports.wording import is_incomplete, names_text, shard_text

MAX_BYTES = 1024 * 1024
MAX_DEPTH = 8
_ARGUMENT_OPTION = "--dura-argument"

_REFUSED_KEYS = {
    "name": "gsn2x takes whatever has a `name` for a module; call the key otherwise",
    "nodeType": "let the id begin with the prefix of its kind instead",
    "alias": "aliases belong to the generated elements; call the key otherwise",
}


def read_user_argument(path: Path) -> ArgumentEntry:
    """Read and check a user's argument. What it refers to is checked when it is merged.

    Raises:
        ConfigurationError: If the file cannot be read, is no YAML of elements, or uses anchors,
            aliases, tags or a key twice.
    """
    file = str(path)
    try:
        raw = path.read_bytes() if path.is_file() else None
    except OSError as error:
        _file_error(f"the file cannot be read: {error.strerror}", file, expected="a readable file")
    if raw is None:
        _file_error("this is not a file", file, expected="a YAML file in the manner of gsn2x")
    if len(raw) > MAX_BYTES:
        _file_error(
            "the file is too large",
            file,
            found=f"{len(raw)} bytes",
            expected=f"at most {MAX_BYTES} bytes",
        )
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        _file_error("the file is not UTF-8 text", file, line=line, expected="YAML in UTF-8")
    reader = _Reader(file)
    elements = reader.elements(text)
    return ArgumentEntry(
        path=file,
        sha256=hashlib.sha256(raw).hexdigest(),
        elements=elements,
        lines={**reader.lines},
    )


def _argument_error(
    user: ArgumentEntry, problem: str, key: str, *, found: str = "", expected: str, remedy: str = ""
) -> NoReturn:
    """The error of something in a user's argument, with its line.

    Raises:
        ConfigurationError: Always.
    """
    line = user.lines.get(key) or user.lines.get(key.partition(".")[0])
    _file_error(
        problem, user.path, line=line, key=key, found=found, expected=expected, remedy=remedy
    )


def check_requirements(user: ArgumentEntry, requirements: Iterable[str]) -> None:
    """Check what is known before anything runs: that the requirements referred to exist.

    Raises:
        ConfigurationError: For ``requirement:ID`` of an unknown requirement.
    """
    known = sorted(requirements)
    for id_, node in user.elements.items():
        for key in (*LIST_KEYS, "challenges"):
            for reference in [node[key]] if isinstance(node.get(key), str) else node.get(key, []):
                requirement = reference.removeprefix("requirement:")
                if requirement != reference and requirement not in known:
                    _argument_error(
                        user,
                        "this requirement is not part of the session",
                        f"{id_}.{key}",
                        found=reference,
                        expected=f"one of {', '.join(known) or 'none'}",
                        remedy="correct the id, or select the scenarios that judge it",
                    )


def _file_error(
    problem: str,
    file: str,
    *,
    line: int | None = None,
    key: str = _ARGUMENT_OPTION,
    found: str = "",
    expected: str,
    remedy: str = "",
) -> NoReturn:
    raise ConfigurationError(
        problem,
        file=file,
        line=line,
        key=key,
        found=found or None,
        expected=expected,
        remedy=remedy or "correct the file, or leave the option out",
    ) from None


class _Reader:
    """Turns the nodes of one file into elements, and notes their lines."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.lines: dict[str, int] = {}

    def elements(self, text: str) -> dict[str, Any]:
        import yaml

        try:
            self._events(text)
            root = yaml.compose(text, Loader=yaml.SafeLoader)
        except yaml.YAMLError as error:
            mark = getattr(error, "problem_mark", None)
            _file_error(
                "the file is not valid YAML",
                self.file,
                line=mark.line + 1 if mark is not None else 1,
                found=str(getattr(error, "problem", None) or getattr(error, "reason", error)),
                expected="valid YAML",
            )
        if not isinstance(root, yaml.MappingNode):
            _file_error(
                "the file holds no elements", self.file, line=1, expected="`G1:` and others"
            )
        mapping = self._mapping(root, "")
        mapping.pop("module", None)
        if not mapping:
            _file_error(
                "the file holds no elements", self.file, line=1, expected="`G1:` and others"
            )
        return {id_: self._element(id_, node) for id_, node in mapping.items()}

    def _events(self, text: str) -> None:
        """Refuse what could explode or make objects, before anything is built from it."""
        import yaml

        depth = 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            line = event.start_mark.line + 1 if event.start_mark is not None else 1
            anchor = getattr(event, "anchor", None)
            tag = getattr(event, "tag", None)
            if anchor is not None or tag is not None:
                _file_error(
                    "anchors, aliases and tags are not allowed here",
                    self.file,
                    line=line,
                    found=f"&{anchor}" if anchor is not None else str(tag),
                    expected="plain text, lists and mappings",
                )
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                _file_error(
                    "the file is nested too deeply",
                    self.file,
                    line=line,
                    expected=f"at most {MAX_DEPTH} levels",
                )

    def _mapping(self, node: Any, path: str) -> dict[str, Any]:
        import yaml

        mapping: dict[str, Any] = {}
        for key_node, value in node.value:
            line = key_node.start_mark.line + 1
            key = str(key_node.value)
            inner = f"{path}.{key}" if path else key
            if not isinstance(key_node, yaml.ScalarNode) or key in mapping:
                _file_error(
                    "a key stands here twice" if key in mapping else "a key is text",
                    self.file,
                    line=line,
                    key=inner if key in mapping else path,
                    expected="each key once, as text",
                )
            self.lines.setdefault(inner, line)
            mapping[key] = self._plain(value, inner)
        return mapping

    def _plain(self, node: Any, path: str) -> Any:
        import yaml

        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, path)
        if isinstance(node, yaml.SequenceNode):
            return [self._plain(element, path) for element in node.value]
        if node.style is None and node.value in ("true", "false"):
            return bool(node.value == "true")
        return node.value

    def _element(self, id_: str, node: Any) -> dict[str, Any]:
        if kind_of(id_) is None:
            self._wrong(id_, "the id begins with no known prefix", id_, ", ".join(PREFIXES))
        if name(id_) != id_ or id_ != id_.strip() or "->" in id_:
            expected = "at most 120 that can be seen, without ->"
            self._wrong(id_, "the id has odd or too many characters", id_, expected)
        if not isinstance(node, dict):
            self._wrong(id_, "an element is a mapping", str(node)[:80], "`text:` and other keys")
        for key, value in node.items():
            if key in _REFUSED_KEYS:
                self._wrong(f"{id_}.{key}", "this key cannot be used", key, _REFUSED_KEYS[key])
            if key in FLAG_KEYS and not isinstance(value, bool):
                self._wrong(f"{id_}.{key}", "no truth value", str(value)[:80], "true or false")
            if key in TEXT_KEYS and not isinstance(value, str):
                self._wrong(f"{id_}.{key}", "no text", str(value)[:80], "text")
            if key in LIST_KEYS and not _names(value):
                self._wrong(f"{id_}.{key}", "no list of ids", str(value)[:80], "[G2, S1]")
        if not node.get("text"):
            self._wrong(id_, "an element has a text", "none", "`text:`")
        return {key: [value] if key in LIST_KEYS and isinstance(value, str) else value
                for key, value in node.items()}  # fmt: skip

    def _wrong(self, key: str, problem: str, found: str, expected: str) -> NoReturn:
        line = self.lines.get(key)
        _file_error(problem, self.file, line=line, key=key, found=found, expected=expected)


def _names(value: Any) -> bool:
    return isinstance(value, str) or (
        isinstance(value, list) and all(isinstance(text, str) for text in value)
    )


"""Key of the record with the user's argument; it may be missing or null."""

_KEPT_KINDS = ("context", "assumption", "scenario")
_VERDICT_STATUSES = ("supported", "violated", "undecided")


def session_argument(record: SessionRecord) -> Argument:
    """The argument of a record, under the user's own if the record has one.

    That of a shard stands alone: the user argues over the whole, whose merged record has it on top.

    Raises:
        ConfigurationError: If the user's argument does not fit.
    """
    user = record.head.argument
    if user is None or shard_text(record):
        return generated_argument(record)
    # A user's argument may take up any leg.
    argument = generated_argument(record, over_kinds=True)
    return merge_user_argument(argument, user, whole=not is_incomplete(record))


def merge_user_argument(argument: Argument, user: ArgumentEntry, *, whole: bool = True) -> Argument:
    """The user's elements, root first, then what they take up, then what tells of the rest.

    Args:
        argument: As generated.
        user: As :func:`read_user_argument` returned it.
        whole: Whether the session is complete; if not, that challenges the user's top goal.

    Raises:
        ConfigurationError: If an id is taken, a reference leads nowhere, or a rule is broken.
    """
    own = _user_elements(argument, user)
    plain = {id_: element.to_yaml() for id_, element in own.items()}
    top = root_ids(plain)
    if len(top) != 1:
        _argument_error(
            user,
            "there is exactly one element that no other refers to, the top goal",
            top[1] if top else next(iter(own)),
            found=", ".join(top) or "none",
            expected="one top goal",
            remedy="let an element refer to the others",
        )
    everything = plain | {id_: element.to_yaml() for id_, element in argument.items()}
    taken = reachable_ids(everything, top) - set(own)
    rest = [
        *_unused_contexts(argument, taken),
        *_top_challenges(argument, taken, top[0], whole=whole),
    ]
    around = [
        element
        for element in argument.values()
        if element.id not in taken and element.alias.partition(":")[0] in _KEPT_KINDS
    ]
    contexts = (*around, *(element for element in rest if element.kind == "Context"))
    root = own.pop(top[0])
    if root.kind != "Goal":
        _argument_error(
            user, "the top element is no goal", root.id, found=root.id, expected="a goal, G..."
        )
    root = replace(root, in_context_of=(*root.in_context_of, *(element.id for element in contexts)))
    kept = [element for element in argument.values() if element.id in taken]
    merged = {element.id: element for element in [root, *own.values(), *kept, *around, *rest]}
    _check_rules(merged, user)
    return merged


def _check_rules(argument: Argument, user: ArgumentEntry) -> None:
    for problem in rule_problems({id_: element.to_yaml() for id_, element in argument.items()}):
        place, _, what = problem.partition(": ")
        _argument_error(
            user,
            "the argument breaks a rule of the notation",
            place.rpartition(" ")[2],
            found=what,
            expected="an argument that gsn2x accepts",
            remedy=f"rule {place.partition(' ')[0]} of gsn2x says what to change",
        )


def _user_elements(argument: Argument, user: ArgumentEntry) -> Argument:
    aliases = {element.alias: id_ for id_, element in reversed(argument.items()) if element.alias}
    own: Argument = {}
    for id_, node in user.elements.items():
        if id_ in argument:
            _argument_error(
                user,
                "this id is taken by a generated element",
                id_,
                found=id_,
                expected="an id of its own",
                remedy="rename it, or refer to the generated element",
            )
        own[id_] = _user_element(id_, node, {**aliases, **dict.fromkeys(argument)}, user)
    return own


def _user_element(
    id_: str, node: Mapping[str, Any], known: Mapping[str, str | None], user: ArgumentEntry
) -> Element:
    def resolved(names: Iterable[str], key: str) -> tuple[str, ...]:
        return tuple(_resolved_ids(reference, f"{id_}.{key}", known, user) for reference in names)

    keys = ("text", "supportedBy", "inContextOf", "challenges", "undeveloped", "defeated", "url")
    layers = _clean_text({key: value for key, value in node.items() if key not in keys})
    if "defeatedRelation" in layers:
        layers["defeatedRelation"] = list(resolved(node["defeatedRelation"], "defeatedRelation"))
    ends = [end.strip() for end in node.get("challenges", "").split("->") if end.strip()]
    return Element(
        id_,
        visible(node["text"]),
        supported_by=resolved(node.get("supportedBy", ()), "supportedBy"),
        in_context_of=resolved(node.get("inContextOf", ()), "inContextOf"),
        challenges=" -> ".join(resolved(ends, "challenges")),
        undeveloped=node.get("undeveloped", False),
        defeated=node.get("defeated", False),
        url=one_line(node.get("url", "")),
        layers=layers,
    )


def _resolved_ids(
    reference: str, key: str, known: Mapping[str, str | None], user: ArgumentEntry
) -> str:
    if reference in user.elements:
        return reference
    # An alias has a requirement's id as it is shown, and the user writes it as it is.
    what, mark, named = reference.partition(":")
    text = reference if reference in known else f"{what}{mark}{name(named)}"
    if text not in known:
        aliases = sorted(
            alias for alias, id_ in known.items() if id_ and alias.startswith("requirement")
        )
        _argument_error(
            user,
            "this element does not exist",
            key,
            found=reference,
            expected="an id of this file, or of the generated argument, or an alias such as "
            f"{', '.join(aliases[:8]) or 'top'}",
            remedy="the ids and aliases stand in assurance-case.gsn.yaml",
        )
    return known[text] or text


def _clean_text(value: Any) -> Any:
    if isinstance(value, str):
        return visible(value)
    if isinstance(value, list):
        return [_clean_text(element) for element in value]
    if isinstance(value, dict):
        return {name(key): _clean_text(element) for key, element in value.items()}
    return value


def _unused_contexts(argument: Argument, taken: set[str]) -> Iterator[Element]:
    """One context for each requirement of which something is not taken up, with its counts."""
    plain = {id_: element.to_yaml() for id_, element in argument.items()}
    for requirement in argument.values():
        what, _, named = requirement.alias.partition(":")
        if what != "requirement":
            continue
        below = reachable_ids(plain, [requirement.id])
        left = [argument[id_] for id_ in argument if id_ in below - taken]
        if not left:
            continue
        counts = _unused_counts(left)
        words = ", ".join(
            f"{counts[verdict_status]} {verdict_status}" for verdict_status in _VERDICT_STATUSES
        )
        untested = sum(element.alias.startswith("untested:") for element in left)
        what = "verdicts" if requirement.id in taken else "requirement, verdicts"
        yield Element(
            derived_id("C", "unused", named),
            f"Not used by the argument: {named}, {what}: {words}; {counts['waived']} waived; "
            f"untested cells: {untested}.",
            url=requirement.url,
            alias=f"unused:{named}",
            layers=counts,
        )
    hazards = [
        element.alias.partition(":")[2]
        for element in argument.values()
        if element.alias.startswith("hazard:") and element.id not in taken
    ]
    if hazards:
        yield Element(
            "CUnusedHazards",
            f"Not used by the argument: the hazards {names_text(hazards)}.",
            url="evidence.json#/hazards",
            alias="unused-hazards",
        )
    if "GMonitors" in argument and "GMonitors" not in taken:
        yield Element(
            "CUnusedMonitors",
            "Not used by the argument: the quality of the runtime monitors.",
            url="evidence.json#/monitors",
            alias="unused:monitors",
        )


def _unused_counts(left: list[Element]) -> dict[str, int]:
    goals = [element for element in left if element.alias.startswith("verdict:")]
    counts = {
        verdict_status: sum(goal.layers["verdict"] == verdict_status for goal in goals)
        for verdict_status in _VERDICT_STATUSES
    }
    counts["requirements"] = sum(element.alias.startswith("requirement:") for element in left)
    counts["waived"] = sum(element.alias.startswith("waiver:") for element in left)
    return counts


def _top_challenges(
    argument: Argument, taken: set[str], top: str, *, whole: bool
) -> Iterator[Element]:
    """Challenges to the user's top goal: violations that it leaves out, and missing runs."""
    left = [
        element.alias.partition(":")[2]
        for element in argument.values()
        if element.id not in taken
        and (
            (element.defeated and element.alias.startswith("verdict:"))
            or element.alias.startswith(COUNTEREXAMPLE_PREFIX)
        )
    ]
    if left:
        more = f" and {len(left) - 8} more" if len(left) > 8 else ""
        yield Element(
            "CGUnused",
            f"Violated, and not used by the argument: {', '.join(left[:8])}{more}.",
            challenges=top,
            url="evidence.json#/verdicts",
        )
    if not whole:
        yield Element(
            "CGIncomplete",
            "INCOMPLETE SESSION: not all of the evidence was gathered that was planned.",
            challenges=top,
            url="evidence.json#/gate",
        )
