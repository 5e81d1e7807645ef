"""Nodes as text, with every parenthesis that a reader or another parser could want."""

from __future__ import annotations

from pytest_dura.requirements.stl.language.nodes import (
    Arithmetic,
    Boolean,
    Comparison,
    Constant,
    Expression,
    Function,
    Node,
    Signal,
    Temporal,
    TemporalPair,
    Window,
)


def node_text(node: Node | Expression) -> str:
    """A formula or an expression as text that parses to equal nodes."""
    if isinstance(node, (Signal, Constant, Arithmetic, Function)):
        return _expression(node)
    if isinstance(node, Comparison):
        return f"{_expression(node.left)} {node.operator} {_expression(node.right)}"
    if isinstance(node, (Boolean, TemporalPair)):
        return _joined(node)
    return f"{_prefix(node)} ({node_text(node.operand)})"


def exact(number: float) -> str:
    """The shortest text that reads back as the same number."""
    return repr(float(number)).removesuffix(".0")


def seconds(window: Window) -> str:
    """A window in seconds, such as ``[0:2.5]``."""
    return f"[{exact(window.start)}:{exact(window.end)}]"


def _expression(node: Expression) -> str:
    if isinstance(node, Signal):
        return node.name
    if isinstance(node, Constant):
        return exact(node.value)
    if isinstance(node, Function):
        return f"{node.name}({_expression(node.operand)})"
    if node.operator == "pow":
        return f"pow({_expression(node.left)}, {_expression(node.right)})"
    right = _term(node.right)
    if node.operator == "-" and isinstance(node.right, Constant):
        # rtamt fails on `a - 5`, which it tries to read as a formula `a` and another, `-5`.
        right = f"({right})"
    return f"{_term(node.left)} {node.operator} {right}"


def _term(node: Expression) -> str:
    joined = isinstance(node, Arithmetic) and node.operator != "pow"
    return f"({_expression(node)})" if joined else _expression(node)


def _joined(node: Boolean | TemporalPair) -> str:
    left = node_text(node.left)
    # A chain of one operator associates to the left, whoever reads it.
    chain = node.operator in ("and", "or")
    if not (chain and isinstance(node.left, Boolean) and node.left.operator == node.operator):
        left = f"({left})"
    return f"{left} {_prefix(node)} ({node_text(node.right)})"


def _prefix(node: Node) -> str:
    """The operator's word, and its window where it has one."""
    if isinstance(node, (Temporal, TemporalPair)):
        return node.operator + (seconds(node.window) if node.window else "")
    if isinstance(node, (Boolean, Comparison)):
        return node.operator
    name = getattr(node, "operator", "not")
    return str(name).replace("strong_", "s_")
