"""Parser of signal temporal logic, by rtamt's grammar; its errors point at the place in the text.

A text means here what it means to rtamt, or it is refused: rtamt's own parser makes the tree. In
front of it stands a reader of our own, so that every message has a column, signals may have any
name, and nothing is ignored. rtamt's precedence, tightest first::

    * / + -   > >= < <= == !=   not   always eventually historically once prev next s_prev s_next
    until unless since   and   or   implies   iff   xor

Each binary operator has a level of its own and associates to the left. What follows from this and
would surprise is refused, and parentheses are asked for:

- ``a - b + c`` and ``a / b * c``: rtamt reads ``a - (b + c)`` and ``a / (b * c)``.
- ``a -> b -> c``, ``a until b until c``, ``a iff b xor c``: rtamt starts from the left, logic
  usually from the right. So these, with ``since`` and ``unless``, never stand side by side, nor
  ``until``, ``unless`` and ``since`` beside ``and`` and ``or``.
- ``always (a) implies (b)`` and ``always (a) and (b)``: the ``always`` ends before the connective,
  and ``b`` is judged at the first sample only. ``always (a) and eventually (b)`` is accepted: where
  each side has an operator on time of its own, ``and`` and ``or`` need no parentheses.
- ``a < b < c`` would compare a formula.

Read as in rtamt and in most languages: ``not a > 1`` is ``not (a > 1)``; ``not a > 1 and b > 2``
is ``(not (a > 1)) and (b > 2)``; ``and`` before ``or`` before ``implies``; ``a - b - c`` and
``a / b / c`` from the left.

Beyond rtamt's text: ``!=`` for ``!==``; dotted signals; signals with the names of operators, told
by their place (see :mod:`words`); ``a/b`` is a division; ``a - 5``, on which rtamt fails
because it looks for a second formula. Short of it: no comments, declarations,
assignments, truth values, named constants, nor numbers such as ``0x1F`` and ``1_000``. Windows
are in seconds without a unit; one bound alone has a unit only beside a zero.
"""

from __future__ import annotations

from functools import lru_cache

from pytest_dura.requirements.stl.language.conversion import Conversion, check_depth
from pytest_dura.requirements.stl.language.formula import Formula
from pytest_dura.requirements.stl.language.grammar import syntax_tree
from pytest_dura.requirements.stl.language.reading import Reader

__all__ = ["parse"]


@lru_cache(maxsize=512)
def parse(text: str, signals: tuple[str, ...] | None = None) -> Formula:
    """The formula in ``text``; ``signals`` are the known names, where they are known.

    Raises:
        ConfigurationError: For anything that is not a formula, with a mark under the place.
    """
    reader = Reader(text, None if signals is None else frozenset(signals))
    tree = syntax_tree(text, reader.terminals)
    check_depth(text, tree)
    return Formula(Conversion(text, reader.windows).formula(tree), text)
