"""Nodes as text, with every parenthesis that a reader or another parser could want."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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
    return Renderer().text(node)


def exact(number: float) -> str:
    """The shortest text that reads back as the same number."""
    return repr(float(number)).removesuffix(".0")


def seconds(window: Window) -> str:
    """A window in seconds, such as ``[0:2.5]``."""
    return f"[{exact(window.start)}:{exact(window.end)}]"


@dataclass(frozen=True, slots=True)
class Renderer:
    """Writes nodes in the syntax that this package shares with rtamt.

    Args:
        signal: Gives the text of a signal's name.
        window: Gives the text of a window, with its brackets.
        not_equal: Stands between two expressions that differ.
    """

    signal: Callable[[str], str] = str
    window: Callable[[Window], str] = seconds
    not_equal: str = "!="

    def text(self, node: Node | Expression) -> str:
        """The text of one node and all below it."""
        if isinstance(node, (Signal, Constant, Arithmetic, Function)):
            return self._expression(node)
        if isinstance(node, Comparison):
            operator = self.not_equal if node.operator == "!=" else node.operator
            return f"{self._expression(node.left)} {operator} {self._expression(node.right)}"
        if isinstance(node, (Boolean, TemporalPair)):
            return self._joined(node)
        return f"{self._prefix(node)} ({self.text(node.operand)})"

    def _expression(self, node: Expression) -> str:
        if isinstance(node, Signal):
            return self.signal(node.name)
        if isinstance(node, Constant):
            return exact(node.value)
        if isinstance(node, Function):
            return f"{node.name}({self._expression(node.operand)})"
        if node.operator == "pow":
            return f"pow({self._expression(node.left)}, {self._expression(node.right)})"
        right = self._term(node.right)
        if node.operator == "-" and isinstance(node.right, Constant):
            # rtamt fails on `a - 5`, which it tries to read as a formula `a` and another, `-5`.
            right = f"({right})"
        return f"{self._term(node.left)} {node.operator} {right}"

    def _term(self, node: Expression) -> str:
        joined = isinstance(node, Arithmetic) and node.operator != "pow"
        return f"({self._expression(node)})" if joined else self._expression(node)

    def _joined(self, node: Boolean | TemporalPair) -> str:
        left = self.text(node.left)
        # A chain of one operator associates to the left, whoever reads it.
        chain = node.operator in ("and", "or")
        if not (chain and isinstance(node.left, Boolean) and node.left.operator == node.operator):
            left = f"({left})"
        return f"{left} {self._prefix(node)} ({self.text(node.right)})"

    def _prefix(self, node: Node) -> str:
        """The operator's word, and its window where it has one."""
        if isinstance(node, (Temporal, TemporalPair)):
            return node.operator + (self.window(node.window) if node.window else "")
        if isinstance(node, (Boolean, Comparison)):
            return node.operator
        name = getattr(node, "operator", "not")
        return str(name).replace("strong_", "s_")
