"""Static checks of Python roles that models draft: such code is parsed, and never imported or run.

They tell a model what does not fit, and keep out what a role has no use for. They are no sandbox:
the person who imports the file reads it first.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import math
import warnings
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from io import StringIO
from tokenize import ENDMARKER, NEWLINE, TokenError, generate_tokens
from typing import Any

import numpy as np

import pytest_dura
from pytest_dura.core.percepts import Percept
from pytest_dura.core.roles import Role

_MOST = 8
"""Problems that are listed of one draft."""
_PARTS = 300
"""Tokens of a statement at most."""
MODULES: Mapping[str, Sequence[str]] = {
    "__future__": ("annotations",),
    "collections": ("deque",),
    "collections.abc": ("Mapping", "Sequence"),
    "math": tuple(name for name in dir(math) if not name.startswith("_")),
    "typing": ("Any",),
}
"""Names that any role may import, by module."""
_BUILTINS = frozenset((
    "abs", "all", "any", "bool", "dict", "enumerate", "filter", "float", "frozenset", "int",
    "isinstance", "len", "list", "map", "max", "min", "range", "reversed", "round", "set",
    "sorted", "str", "sum", "super", "tuple", "zip",
))  # fmt: skip
_NODES = (
    ast.Module, ast.ClassDef, ast.FunctionDef, ast.arguments, ast.arg, ast.keyword, ast.Return,
    ast.Assign, ast.AugAssign, ast.AnnAssign, ast.For, ast.If, ast.Expr, ast.Pass, ast.Break,
    ast.Continue, ast.BoolOp, ast.NamedExpr, ast.BinOp, ast.UnaryOp, ast.Lambda, ast.IfExp,
    ast.Dict, ast.Set, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp, ast.Compare,
    ast.Call, ast.FormattedValue, ast.JoinedStr, ast.Constant, ast.Attribute, ast.Subscript,
    ast.Starred, ast.Name, ast.List, ast.Tuple, ast.Slice, ast.comprehension, ast.expr_context,
    ast.boolop, ast.operator, ast.unaryop, ast.cmpop,
)  # fmt: skip
"""What a draft is made of: no `while`, nothing that hides an error."""
_TYPES = (
    ast.Name, ast.Attribute, ast.Subscript, ast.Constant, ast.BinOp, ast.BitOr, ast.Tuple,
    ast.List, ast.expr_context,
)  # fmt: skip
"""What annotations are made of: some run when the file is imported."""
_ARRAY = frozenset((
    "T", "all", "any", "argmax", "argmin", "max", "mean", "min", "ndim", "shape", "size", "sum",
    "tolist",
))  # fmt: skip
"""Of an array: the others write files, among other things."""
_FORMATS = {"format", "format_map"}
"""These read attributes that stand in a text."""


@dataclass(frozen=True)
class Basis:
    """What a draft rests on.

    Args:
        base: Its base class.
        method: The method that it has to have.
        output: Class of what that returns.
        view: What the method is given, with the percept of an episode.
        classes: Names that it may import, by name; each has its module.
    """

    base: type[Role]
    method: str
    output: type
    view: Any
    classes: Mapping[str, Any]


def read_role(lines: Sequence[str], basis: Basis) -> tuple[str, str, list[str]]:
    """Read a draft: name of its class, the code as it was read, and why it is refused.

    The code is written anew from what was parsed, so that no comment of the model is left.
    """
    text = "\n".join(lines) + "\n"
    odd = next((line for line in lines if not (line.isascii() and line.isprintable())), None)
    if odd is not None:
        return "", "", [f"the line {odd[:80]!a} has other characters than printable ASCII"]
    try:
        if _longest_statement(text) > _PARTS:
            return "", "", [f"a statement has more than {_PARTS} parts: write it in several"]
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            tree = ast.parse(text)
            compile(text, "draft", "exec", dont_inherit=True)  # what parsing alone lets pass
        code = ast.unparse(tree) + "\n"
        if ast.dump(ast.parse(code)) != ast.dump(tree):
            return "", "", ["it cannot be written as it was read: use simpler strings"]
        reader = _Reader(basis)
        reader.visit(tree)
    except (SyntaxError, ValueError, RecursionError, MemoryError, TokenError) as error:
        return "", "", [f"it is not Python: {ascii(str(error))[1:-1][:200]}"]
    names = [each.name for each in tree.body if isinstance(each, ast.ClassDef)]
    return names[0] if names else "", code, list(dict.fromkeys(reader.problems))[:_MOST]


def _longest_statement(text: str) -> int:
    """Count the tokens of the longest statement, without building anything of them.

    Nesting without bounds makes the parser give up, after which some versions of CPython (3.11.7
    among them) fail at the next thing that is parsed in the process.
    """
    most = count = 0
    for token in generate_tokens(StringIO(text).readline):
        count = 0 if token.type in (NEWLINE, ENDMARKER) else count + 1
        most = max(most, count)
    return most


class _Reader(ast.NodeVisitor):
    """Notes what is wrong with a draft, in the order of its lines."""

    def __init__(self, basis: Basis) -> None:
        self.basis = basis
        self.problems: list[str] = []
        self.known: dict[str, Any] = {}
        """Names of the module; with an object where it is at hand."""
        self.local: dict[str, Any] = {}
        self.attributes = set().union(
            *(attributes_of(each) for each in (basis.view, *basis.classes.values())),
            *map(_public, (str, int, float, list, dict, set, tuple, deque)),
        ) - _FORMATS  # fmt: skip

    def refuse(self, node: ast.AST, problem: str) -> None:
        """Note a problem with its line."""
        self.problems.append(f"line {getattr(node, 'lineno', 1)}: {problem}")

    def generic_visit(self, node: ast.AST) -> None:
        """Go on below what a draft may be made of."""
        if isinstance(node, _NODES):
            super().generic_visit(node)
        else:
            self.refuse(node, f"a draft has no {type(node).__name__}")

    def visit_Module(self, node: ast.Module) -> None:
        classes = [each for each in node.body if isinstance(each, ast.ClassDef)]
        if len(classes) != 1:
            self.refuse(node, f"it has {len(classes)} classes, and has to have one")
        for place, each in enumerate(node.body):
            if isinstance(each, (ast.Import, ast.ImportFrom)):
                self._import(each)
            elif isinstance(each, ast.ClassDef):
                self._class(each)
            elif not (place == 0 and _is_text(each)):
                self._constant(each, "the module", [*self.known, *dir(builtins)])

    def _import(self, node: ast.Import | ast.ImportFrom) -> None:
        for alias in node.names:
            module = alias.name if isinstance(node, ast.Import) else str(node.module)
            given = self.basis.classes.get(alias.name)
            if alias.asname or getattr(node, "level", None):
                found = False
            elif isinstance(node, ast.Import):
                found = module == "math"
            elif module in MODULES:
                found = alias.name in MODULES[module]
            else:
                ours = module == "pytest_dura" and alias.name in pytest_dura.__all__
                found = given is not None and (ours or module == given.__module__)
            if not found:
                self.refuse(node, f"`{ast.unparse(node)}` is none of the imports that are listed")
            self.known[alias.name] = math if module == alias.name else given

    def _annotation(self, node: ast.expr | None) -> None:
        if node is not None and all(isinstance(each, _TYPES) for each in ast.walk(node)):
            self.visit(node)
        elif node is not None:
            self.refuse(node, f"the annotation `{ast.unparse(node)}` names no type")

    def _constant(self, node: ast.stmt, place: str, taken: Sequence[str]) -> None:
        """Check a statement outside of methods: it runs when the file is imported."""
        targets = (
            node.targets if isinstance(node, ast.Assign)
            else [node.target] if isinstance(node, ast.AnnAssign) else []
        )  # fmt: skip
        names = [each.id for each in targets if isinstance(each, ast.Name)]
        value = getattr(node, "value", None)
        if not names or len(names) != len(targets) or not _is_plain(value):
            text = ast.unparse(node).partition("\n")[0][:60]
            self.refuse(node, f"`{text}` in {place}: it holds numbers and texts by name alone")
        self._annotation(getattr(node, "annotation", None))
        for name in names:
            if name in taken or name.startswith("__"):
                self.refuse(node, f"{name} means something else in {place}")
            self.known[name] = None

    def _class(self, node: ast.ClassDef) -> None:
        base = self.basis.base
        bases = [ast.unparse(each) for each in node.bases]
        if bases != [base.__name__] or self.known.get(base.__name__) is not base or node.keywords:
            self.refuse(node, f"the class has to be a subclass of {base.__name__} alone, imported")
        if node.decorator_list or getattr(node, "type_params", []):
            self.refuse(node, "a draft has no decorators and no type parameters")
        if node.name in self.known or node.name in dir(builtins) or node.name.startswith("_"):
            self.refuse(node, f"the class cannot be named {node.name}")
        self.known[node.name] = None
        methods = [each for each in node.body if isinstance(each, ast.FunctionDef)]
        stored = {
            each.attr for each in ast.walk(node)
            if isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Store)
        }  # fmt: skip
        own = {each.name for each in methods} | stored
        rest = [each for each in node.body if each not in methods]
        for each in rest:
            if not _is_text(each):
                before = dict(self.known)
                self._constant(each, "the class", dir(base))
                own |= self.known.keys() - before.keys()
                self.known = before
        self.own = own | set(_public(base))
        if self.basis.method not in own:
            self.refuse(node, f"the class has no method {self.basis.method}(self, view)")
        for method in methods:
            self._method(method)

    def _method(self, node: ast.FunctionDef) -> None:
        given, basis = node.args, self.basis
        names = [each.arg for each in given.args]
        plain = not (given.vararg or given.kwarg or given.kwonlyargs or given.posonlyargs)
        expected = {basis.method: ["self", "view"], "reset": ["self", "context"]}.get(node.name)
        if node.name == "__init__":
            fits = plain and len(given.defaults) == len(names) - 1
            wanted = "self, and parameters that each have a default"
        elif expected:
            fits, wanted = plain and names == expected and not given.defaults, ", ".join(expected)
        else:
            fits, wanted = plain and not given.defaults, "self first, and no defaults"
            if node.name in dir(basis.base) or node.name.startswith("__"):
                self.refuse(node, f"the method {node.name} is none that a draft changes")
        if not fits or names[:1] != ["self"]:
            self.refuse(node, f"the parameters of {node.name} have to be: {wanted}")
        if node.decorator_list or getattr(node, "type_params", []):
            self.refuse(node, "a draft has no decorators and no type parameters")
        if not all(map(_is_plain, given.defaults)):
            self.refuse(node, f"a default of {node.name} is no number and no text")
        empty = any(_is_empty_return(each) for each in ast.walk(node))
        if node.name == basis.method and (empty or not _ends(node.body)):
            self.refuse(node, f"{node.name} can end without {basis.output.__name__}")
        bound = [each.arg for each in ast.walk(node) if isinstance(each, ast.arg)] + [
            each.id for each in ast.walk(node)
            if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)
        ]  # fmt: skip
        if bound.count("self") > 1:
            self.refuse(node, "self means something else in a part of the method")
        self.local = dict.fromkeys(bound)
        self.once = {name for name in bound if bound.count(name) == 1}
        if node.name == basis.method and "view" in self.once:
            self.local["view"] = basis.view
        self._annotation(node.returns)
        for each in (*given.args, *given.defaults, *node.body):
            self.visit(each)
        self.local = {}

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self.refuse(node, "a function stands in another one, and a draft has methods alone")

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self.refuse(node, "a class stands in a method")

    def visit_arg(self, node: ast.arg) -> None:
        self._annotation(node.annotation)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        self._annotation(node.annotation)
        for each in (node.target, node.value):
            if each is not None:
                self.visit(each)

    def visit_Constant(self, node: ast.Constant) -> None:
        if node.value is not ... and not _is_plain(node):
            self.refuse(node, f"{type(node.value).__name__} is no value of a draft")

    def visit_Name(self, node: ast.Name) -> None:
        if isinstance(node.ctx, ast.Load) and node.id not in {*self.local, *self.known, *_BUILTINS}:
            word = "not for a draft" if hasattr(builtins, node.id) else "not defined"
            self.refuse(node, f"the name {node.id} is {word}")

    def visit_Attribute(self, node: ast.Attribute) -> None:
        self.visit(node.value)
        name, of = node.attr, ast.unparse(node.value)
        own = of == "self"
        if isinstance(node.ctx, ast.Store):
            if not own or name.startswith("__") or name in dir(self.basis.base):
                self.refuse(node, f"{of}.{name} is not the draft's own to set")
        elif own:
            if name not in self.own or name.startswith("__"):
                self.refuse(node, f"self has no {name}")
        elif of == "super()":
            if name not in ("__init__", "reset"):
                self.refuse(node, f"super().{name} is not for a draft")
        elif (value := self._value(node.value)) is not None:
            has = sorted(_attributes(value))
            if name not in has:
                self.refuse(node, f"{_named(value)} has no {name}; it has {', '.join(has)}")
        elif name not in self.attributes:
            self.refuse(node, f"nothing that a draft is given has an attribute {name}")

    def visit_Subscript(self, node: ast.Subscript) -> None:
        self.generic_visit(node)
        value, root = self._value(node.value), node.value
        while isinstance(root, (ast.Attribute, ast.Subscript)):
            root = root.value
        if isinstance(node.ctx, ast.Store) and not (
            isinstance(root, ast.Name) and root.id in {*self.local, "self"} - {"view", "context"}
        ):
            self.refuse(node, f"`{ast.unparse(node)}` is not the draft's own to set")
        self._check_channel(node, value, node.slice)

    def visit_Call(self, node: ast.Call) -> None:
        self.generic_visit(node)
        if isinstance(node.func, ast.Attribute) and node.func.attr == "get" and node.args:
            self._check_channel(node, self._value(node.func.value), node.args[0])
        made = self._value(node.func)
        starred = any(isinstance(each, ast.Starred) for each in node.args)
        if not inspect.isclass(made) or issubclass(made, Enum) or starred:
            return
        given = {each.arg or "": 0 for each in node.keywords}
        try:
            inspect.signature(made).bind(*node.args, **given)
        except TypeError as error:
            self.refuse(node, f"{made.__name__}: {error}")
        except ValueError:  # a class in C may not say what it takes
            return

    def _check_channel(self, node: ast.AST, percept: Any, key: ast.expr) -> None:
        if isinstance(percept, Percept) and isinstance(key, ast.Constant):
            known = {*percept, *percept.aliases}
            if key.value not in known:
                text = ", ".join(sorted(known))
                self.refuse(node, f"the percept has no channel {key.value!r}; it has {text}")

    def visit_Assign(self, node: ast.Assign) -> None:
        self.visit(node.value)
        for target in node.targets:
            self.visit(target)
            self._bind(target, self._value(node.value))

    def visit_For(self, node: ast.For) -> None:
        self.visit(node.iter)
        self._bind(node.target, first_of(self._value(node.iter)))
        for each in (node.target, *node.body, *node.orelse):
            self.visit(each)

    def _comprehension(self, node: Any) -> None:
        for each in node.generators:
            self.visit(each.iter)
            self._bind(each.target, first_of(self._value(each.iter)))
            for part in (each.target, *each.ifs):
                self.visit(part)
        for name in ("key", "value", "elt"):
            if hasattr(node, name):
                self.visit(getattr(node, name))

    visit_ListComp = visit_SetComp = visit_DictComp = visit_GeneratorExp = _comprehension  # noqa: N815 - as ast has it

    def _bind(self, target: ast.expr, value: Any) -> None:
        if isinstance(target, ast.Name) and target.id in self.once:
            self.local[target.id] = value

    def _value(self, node: ast.expr) -> Any:
        """Return what an expression has in an episode; ``None`` where it is not known."""
        if isinstance(node, ast.Name):
            return self.local.get(node.id, self.known.get(node.id))
        if isinstance(node, ast.Attribute):
            value = self._value(node.value)
            return getattr(value, node.attr) if node.attr in fields_of(value) else None
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant):
            value, key = self._value(node.value), node.slice.value
            return value.get(str(key)) if isinstance(value, Percept) else first_of(value)
        return None


def fields_of(value: Any) -> tuple[str, ...]:
    """Names that hold data of a value, so that to read one calls nothing."""
    if inspect.isclass(value):
        return tuple(value.__members__) if issubclass(value, Enum) else ()
    named = value._fields if isinstance(value, tuple) and hasattr(value, "_fields") else ()
    return (*named, *getattr(type(value), "__dataclass_fields__", ()))


def first_of(value: Any) -> Any:
    """Return an entry of a sequence; ``None`` of an empty one, and of what is none."""
    return value[0] if isinstance(value, Sequence) and value and type(value) is not str else None


def _public(kind: Any) -> list[str]:
    return [name for name in dir(kind) if not name.startswith("_")]


def _attributes(value: Any) -> set[str]:
    """Names of attributes that a draft may read of a value."""
    if isinstance(value, np.ndarray):
        return set(_ARRAY)
    kind = value if inspect.isclass(value) or inspect.ismodule(value) else type(value)
    fields = getattr(kind, "__dataclass_fields__", ())
    return {*_public(kind), *(name for name in fields if not name.startswith("_"))} - _FORMATS


def attributes_of(value: Any, depth: int = 5) -> set[str]:
    """Names of attributes of a value, and of what it is made of."""
    names = _attributes(value)
    parts = [] if inspect.isclass(value) else [getattr(value, name) for name in fields_of(value)]
    parts += [*value.values()] if isinstance(value, Percept) else [first_of(value)]
    known = [part for part in parts if part is not None] if depth else []
    return names.union(*(attributes_of(part, depth - 1) for part in known))


def _named(value: Any) -> str:
    return str(getattr(value, "__name__", type(value).__name__))


def _is_text(node: ast.stmt) -> bool:
    """Whether a statement is a documentation string, or nothing."""
    value = getattr(node, "value", None) if isinstance(node, ast.Expr) else None
    is_text = isinstance(value, ast.Constant) and isinstance(value.value, str)
    return is_text or isinstance(node, ast.Pass)


def _is_plain(node: ast.AST | None) -> bool:
    """Whether it is a number, a text, or a tuple of them: what no run can change for the next."""
    if isinstance(node, ast.Tuple):
        return all(map(_is_plain, node.elts))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        node = node.operand
    kinds = (int, float, str, bool, type(None))
    return isinstance(node, ast.Constant) and type(node.value) in kinds


def _is_empty_return(node: ast.AST) -> bool:
    """Whether a statement returns nothing, or ``None``."""
    value = getattr(node, "value", None)
    is_none = value is None or (isinstance(value, ast.Constant) and value.value is None)
    return isinstance(node, ast.Return) and is_none


def _ends(body: Sequence[ast.stmt]) -> bool:
    """Whether statements end by a return on each way."""
    last = body[-1]
    if isinstance(last, ast.If):
        return _ends(last.body) and bool(last.orelse) and _ends(last.orelse)
    return isinstance(last, ast.Return) and last.value is not None
