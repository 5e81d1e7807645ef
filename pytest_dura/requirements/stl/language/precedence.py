"""Where rtamt's reading of a formula without parentheses would surprise, they are asked for.

The table of rtamt's precedence, and what is refused, is in
:mod:`pytest_dura.requirements.stl.language.parsing`.
"""

from __future__ import annotations

from typing import Any

from pytest_dura.requirements.stl.language.nodes import (
    Boolean,
    Node,
    Not,
    Step,
    Temporal,
    TemporalPair,
)
from pytest_dura.requirements.stl.language.tokens import refuse

_LOGIC = ("ExprAndContext", "ExprOrContext")
_EDGED = (
    "ExprImpliesContext", "ExprIffContext", "ExprXorContext",
    "ExprUntilContext", "ExprUnlessContext", "ExprSinceContext",
)  # fmt: skip
_SCOPED = (
    "ExprAlwaysContext", "ExprEvContext", "ExprHistContext", "ExpreOnceContext",
    "ExprPreviousContext", "ExprNextContext",
    "ExprStrongPreviousContext", "ExprStrongNextContext",
)  # fmt: skip
# rtamt binds `+` tighter than `-`, and `*` tighter than `/`.
_SPLIT = {
    "ExprSubtractionContext": ("ExprAdditionContext", "(a - b) + c", "a - (b + c)"),
    "ExprDivisionContext": ("ExprMultiplicationContext", "(a / b) * c", "a / (b * c)"),
}


def kind(tree: Any) -> str:
    """The name of the grammar's alternative that a tree stands for."""
    return type(tree).__name__


def place(tree: Any) -> int:
    """The column of a tree's first token."""
    token = getattr(tree, "symbol", None) or tree.start
    return int(token.column)


def word(tree: Any) -> str:
    """The text of a tree's first token."""
    token = getattr(tree, "symbol", None) or tree.start
    return str(token.text)


def check_arithmetic(text: str, tree: Any) -> None:
    """Refuse ``a - b + c`` and ``a / b * c``, which rtamt reads from the right.

    Raises:
        ConfigurationError: For such a pair without parentheses.
    """
    tighter, usual, read = _SPLIT.get(kind(tree), ("", "", ""))
    right = tree.children[2]
    if kind(right) == tighter:
        problem = f"rtamt reads `{read.replace('(', '').replace(')', '')}` as `{read}`,"
        refuse(
            text, place(right.children[1]), problem, "parentheses", f"write `{usual}` or `{read}`"
        )


def check_connective(text: str, tree: Any, right: Node) -> None:
    """Refuse a connective whose operands could be meant to reach further than rtamt takes them.

    Args:
        text: The whole formula.
        tree: The connective's tree.
        right: The formula on its right.

    Raises:
        ConfigurationError: For operands that need parentheses.
    """
    mine = tree.children[1]
    for operand in (tree.children[0], tree.children[-1]):
        # `and` and `or` below these bind tighter, as usual; below `until` they cannot stand at all.
        if kind(operand) in _EDGED:
            inner = operand.children[1]
            problem = f"`{word(inner)}` and `{word(mine)}` stand together without parentheses"
            at = max(place(inner), place(mine))
            remedy = "write `(a ... b) ... c` or `a ... (b ... c)`, as it is meant"
            refuse(text, at, problem, "parentheses", remedy)
    reaching = _right_edge(tree.children[0])
    if reaching is not None and not (kind(tree) in _LOGIC and _temporal(right)):
        name, joint = word(reaching), word(mine)
        problem = f"`{name}` could be meant to reach over the `{joint}`"
        remedy = f"write `({name} (a)) {joint} (b)` or `{name} (a {joint} b)`, as it is meant"
        refuse(text, place(mine), problem, "parentheses", remedy)


def _right_edge(tree: Any) -> Any:
    """The prefix operator whose scope ends, without parentheses, where the tree ends."""
    while True:
        if kind(tree) in _SCOPED:
            return tree
        if kind(tree) != "ExprNotContext" and kind(tree) not in (*_LOGIC, *_EDGED):
            return None
        tree = tree.children[-1]


def _temporal(node: Node) -> bool:
    """Whether every branch of a formula is below an operator on time of its own."""
    if isinstance(node, (Temporal, TemporalPair, Step)):
        return True
    if isinstance(node, Not):
        return _temporal(node.operand)
    return isinstance(node, Boolean) and _temporal(node.left) and _temporal(node.right)
