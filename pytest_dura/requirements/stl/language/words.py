"""Which word is an operator and which a signal, and what stands where it cannot.

rtamt reserves words such as ``s``, ``F`` or ``once`` for itself. Here a word is told by its place:
a connective stands after an operand, a prefix operator before one, a function before a parenthesis.
Anywhere else the word is a signal, so ``F (F > 2)`` is ``eventually`` over the signal ``F``.
``F - 3`` can be either and is refused.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from pytest_dura.requirements.stl.language.tokens import Token, refuse

PREFIXES = {
    "always": "AlwaysOperator", "G": "AlwaysOperator",
    "eventually": "EventuallyOperator", "F": "EventuallyOperator",
    "historically": "HistoricallyOperator", "H": "HistoricallyOperator",
    "once": "OnceOperator", "O": "OnceOperator",
    "next": "NextOperator", "X": "NextOperator",
    "prev": "PreviousOperator", "Y": "PreviousOperator",
    "s_next": "StrongNextOperator", "sX": "StrongNextOperator",
    "s_prev": "StrongPreviousOperator", "sY": "StrongPreviousOperator",
}  # fmt: skip
FUNCTIONS = {
    "abs": "ABS", "sqrt": "SQRT", "exp": "EXP", "pow": "POW",
    "rise": "RiseOperator", "fall": "FallOperator",
}  # fmt: skip
CONNECTIVES = {
    "and": "AndOperator", "&": "AndOperator",
    "or": "OrOperator", "|": "OrOperator",
    "implies": "ImpliesOperator", "->": "ImpliesOperator",
    "iff": "IffOperator", "<->": "IffOperator",
    "xor": "XorOperator",
    "until": "UntilOperator", "U": "UntilOperator",
    "unless": "UnlessOperator", "W": "UnlessOperator",
    "since": "SinceOperator", "S": "SinceOperator",
}  # fmt: skip
COMPARISONS = {
    ">=": "GreaterOrEqualOperator", ">": "GreaterOperator",
    "<=": "LesserOrEqualOperator", "<": "LesserOperator",
    "==": "EqualOperator", "!=": "NotEqualOperator", "!==": "NotEqualOperator",
}  # fmt: skip
ARITHMETIC = {"+": "PLUS", "-": "MINUS", "*": "TIMES", "/": "DIVIDE"}
NEGATIONS = ("not", "!")
WINDOWED = (
    "AlwaysOperator", "EventuallyOperator", "HistoricallyOperator", "OnceOperator",
    "UntilOperator", "UnlessOperator", "SinceOperator",
)  # fmt: skip

_TRUTH = ("true", "false", "TRUE", "FALSE", "True", "False")
_SHORT = ("U", "W", "S")
_VALUES = (*COMPARISONS, *ARITHMETIC)
_WORDS = tuple(
    word
    for word in ("not", *PREFIXES, *FUNCTIONS, *CONNECTIVES)
    if len(word) > 1 and word.islower()
)


def operand_kind(
    text: str, tokens: Sequence[Token], at: int, signals: frozenset[str] | None
) -> str:
    """The terminal of a word where an operand begins.

    Raises:
        ConfigurationError: For a word that cannot stand there, or can be read in two ways.
    """
    token, after = tokens[at], tokens[at + 1]
    word = token.text
    if word == "not":
        return "NotOperator"
    if word in CONNECTIVES and (word not in _SHORT or after.text in ("(", "[")):
        refuse(text, token.position, f"found `{word}`", "a formula before it")
    if word in FUNCTIONS:
        return FUNCTIONS[word] if after.text == "(" else "Identifier"
    if word in PREFIXES:
        return _prefix(text, tokens, at)
    if word in _TRUTH and not (signals and word in signals):
        remedy = "compare a signal, as in `flag > 0.5`"
        refuse(text, token.position, f"found the truth value `{word}`", "comparisons", remedy)
    if after.text in ("(", "["):
        unknown_word(text, token)
    return "Identifier"


def unknown_word(text: str, token: Token) -> None:
    """Refuse a word that is used as an operator.

    Raises:
        ConfigurationError: Always; it tells the nearest operator.
    """
    near = difflib.get_close_matches(token.text.lower(), _WORDS, n=1)
    remedy = f"did you mean `{near[0]}`?" if near else "check its spelling"
    problem = f"`{token.text}` is no operator or function"
    refuse(text, token.position, problem, "one of " + ", ".join(_WORDS), remedy)


def _prefix(text: str, tokens: Sequence[Token], at: int) -> str:
    token, after = tokens[at], tokens[at + 1]
    in_value = at > 0 and tokens[at - 1].text in _VALUES
    if after.text in ("(", "[", "!"):
        return PREFIXES[token.text]
    if after.text == "-" and not in_value and tokens[at + 2].kind == "number":
        number = tokens[at + 2].text
        problem = f"`{token.text} - {number}` can be read in two ways"
        remedy = (
            f"write `({token.text}) - {number}` for the signal `{token.text}`, or "
            f"`{token.text} (-{number} ...)` for the operator"
        )
        refuse(text, token.position, problem, "parentheses", remedy)
    operand = after.kind == "number" or (
        after.kind == "word" and (after.text not in CONNECTIVES or after.text in _SHORT)
    )
    return PREFIXES[token.text] if operand and not in_value else "Identifier"
