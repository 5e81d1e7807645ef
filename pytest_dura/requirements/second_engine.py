"""SecondEngine: evaluates formulas by rtamt beside our own evaluation, and reports differences.

What is compared is the verdict on an episode at its first sample: the margin of each part of the
conjunction at the root, and whether it holds. Our margins of an undecided formula are compared as
well; that it is undecided is not, since rtamt cuts windows at the end of the trace. Margins must be
equal to the bit, as both engines add, subtract, multiply, divide and take roots and absolute values
in doubles, which IEEE 754 rounds alike. Only ``exp`` and ``pow``, which it does not prescribe, may
differ by :data:`TOLERANCE`.

rtamt is imported when a second engine is made, and by nothing else.
"""

from __future__ import annotations

import hashlib
import math
import operator
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from pytest_dura.core.errors import ConfigurationError, DuraError, type_name
from pytest_dura.requirements.stl.evaluation import Evaluation
from pytest_dura.requirements.stl.formula import (
    ON_BOUND,
    Arithmetic,
    Boolean,
    Comparison,
    Constant,
    Formula,
    Function,
    Node,
    Not,
    Signal,
    Window,
    conjuncts,
    in_samples,
    node_text,
    walk,
)

TOLERANCE = 1e-9
"""Relative and absolute difference of margins of formulas with ``exp`` or ``pow``."""

COMPARED = "compared"
FUNCTION = "the check is a function"
NO_TRACE = "the episode has no samples"
NO_ACCOUNT = "the component gives no account of its proposals"
NOT_FINITE = "a signal is not finite at the first sample"
NOT_KNOWN = "not each sample of a signal is known"
ONE_SAMPLE = "the trace has a single sample"

Columns = Mapping[str, Any]
"""Samples of each signal: a list, or an array."""


ENGINES_DISAGREE = "infrastructure: the STL engines disagree on "
"""Beginning of the detail of an episode on which two engines differ."""


class EnginesDisagreeError(DuraError):
    """Our evaluation of a formula and rtamt's differ: neither can be relied on.

    Args:
        subject: The requirement, or the formula where there is none.
        episode: Id of the episode.
        values: What each engine gives.
    """

    def __init__(self, subject: str, episode: str, values: str) -> None:
        self.episode, self.values = episode, values
        super().__init__(f"{ENGINES_DISAGREE}{subject}, episode {episode}: {values}")


class SecondEngine:
    """rtamt's offline evaluation in discrete time, with counts of what it was compared on.

    Raises:
        ConfigurationError: If rtamt cannot be imported.
    """

    def __init__(self) -> None:
        self._specified, self.version = _load()
        self.results: dict[str, str] = {}
        """Why a verdict was not compared, or :data:`COMPARED`, by what identifies the verdict."""
        self.differences: list[str] = []
        """Messages of all differences."""
        self._errors: dict[str, EnginesDisagreeError] = {}

    def compare(
        self,
        formula: Formula,
        evaluation: Evaluation,
        columns: Columns,
        *,
        time_step: float,
        episode: str,
        spec: str,
    ) -> None:
        """Evaluate a formula by rtamt as well.

        Args:
            formula: The formula.
            evaluation: Ours.
            columns: Samples by signal that it was evaluated on.
            time_step: Seconds from sample to sample.
            episode: Id of the episode.
            spec: Identifies the episode among those of the same id.

        Raises:
            EnginesDisagreeError: If the two differ.
        """
        key = _key(spec, formula, evaluation.status, evaluation.margin)
        if key not in self.results:
            self.results[key], difference = self._compared(formula, evaluation, columns, time_step)
            if difference is not None:
                self._errors[key] = EnginesDisagreeError(f"`{formula}`", episode, difference)
                self.differences.append(str(self._errors[key]))
        if key in self._errors:
            raise self._errors[key].with_traceback(None)

    def pass_over(self, check: str, spec: str, reason: str) -> None:
        """Note a verdict that rtamt cannot reach."""
        self.results[_key(spec, check, reason)] = reason

    def counts(self, *others: Mapping[str, str]) -> dict[str, Any]:
        """Count the results of this process and of others as plain data."""
        results = dict(self.results)
        for each in others:
            results |= each
        reasons = Counter(results.values())
        compared = reasons.pop(COMPARED, 0)
        return {
            "engine": "rtamt",
            "version": self.version,
            "compared": compared,
            "not_compared": dict(sorted(reasons.items())),
        }

    def robustness(self, root: Node, columns: Columns, time_step: float) -> list[float]:
        """Robustness at each sample by rtamt, for traces of at least two.

        ``iff`` is written out as two implications and ``xor`` as its negation: rtamt's own
        robustness of them, ``-|a - b|`` and ``|a - b|``, is never positive and never negative.
        Windows are given in samples, since 0.1 s is no exact number, and are cut at the length of
        the trace, which changes no value. Signals get names that rtamt allows.
        """
        names = {
            name: f"signal_{number}"
            for number, name in enumerate(
                sorted({node.name for node in walk(root) if isinstance(node, Signal)})
            )
        }
        size = len(next(iter(columns.values())))

        def readable(node: Any) -> Any:
            if isinstance(node, Signal):
                return Signal(names[node.name])
            if getattr(node, "window", None) is not None:
                bounds = in_samples(node.window, time_step)
                first, last = (float(min(bound, size)) for bound in bounds)
                return replace(node, window=Window(first, last))
            if not (isinstance(node, Boolean) and node.operator in ("iff", "xor")):
                return node
            there = Boolean("implies", node.left, node.right)
            both = Boolean("and", there, Boolean("implies", node.right, node.left))
            return both if node.operator == "iff" else Not(both)

        text = node_text(_rewritten(root, readable)).replace("!=", "!==")
        return self.evaluated(text, {names[name]: columns[name] for name in names})

    def evaluated(self, text: str, columns: Columns) -> list[float]:
        """What rtamt makes of a text as it stands, with a sample each second."""
        # Lists of our own: rtamt appends to its inputs. A specification is used once, since it
        # keeps a state.
        lists = {name: [float(sample) for sample in column] for name, column in columns.items()}
        time = list(range(len(next(iter(lists.values())))))
        margins = self._specified(text, list(lists)).evaluate({"time": time, **lists})
        return [float(margin) for _, margin in margins]

    def _compared(
        self, formula: Formula, own: Evaluation, columns: Columns, time_step: float
    ) -> tuple[str, str | None]:
        """The result, and what the engines give where they differ."""
        if len(next(iter(columns.values()))) < 2:
            return ONE_SAMPLE, None
        parts = conjuncts(formula.root)
        try:
            margins = [self.robustness(part, columns, time_step)[0] for part in parts]
            held = [
                margin > 0 if margin else self._holds_on_bound(part, columns, time_step)
                for part, margin in zip(parts, margins, strict=True)
            ]
        except Exception as error:  # rtamt raises anything for what it cannot evaluate
            return f"rtamt cannot evaluate it ({type_name(error)})", None
        inexact = any(
            (isinstance(node, Function) and node.name == "exp")
            or (isinstance(node, Arithmetic) and node.operator == "pow")
            for node in walk(formula.root)
        )
        agree = _nearly if inexact else operator.eq
        failed = [margin for margin, holds in zip(margins, held, strict=True) if not holds]
        if own.status == "violated":
            # Of several violated parts ours leaves out those that a longer trace might mend.
            alike = any(agree(own.margin, margin) for margin in failed)
        else:
            alike = agree(own.margin, min(margins)) and not (own.status == "satisfied" and failed)
        if inexact and not alike:  # on the bound itself a rounding decides
            near_zero = abs(own.margin) <= TOLERANCE
            alike = near_zero and any(_nearly(own.margin, margin) for margin in margins)
        if alike:
            return COMPARED, None
        theirs = min(failed or margins)
        status = "violated" if failed else "satisfied"
        values = (
            f"ours is {own.status} by {own.margin!r}, rtamt {self.version} {status} by {theirs!r}"
        )
        return COMPARED, values

    def _holds_on_bound(self, part: Node, columns: Columns, time_step: float) -> bool:
        """Whether a part with a margin of zero holds, which is not in its margin.

        Each comparison is replaced by a signal that is 1 where it holds and -1 elsewhere.
        """
        truths: dict[str, list[float]] = {}

        def truth(node: Any) -> Any:
            if not isinstance(node, Comparison):
                return node
            name = f"truth_{len(truths)}"
            truths[name] = [
                1.0 if margin > 0 or (node.operator in ON_BOUND and margin == 0) else -1.0
                for margin in self.robustness(node, columns, time_step)
            ]
            return Comparison(">", Signal(name), Constant(0.0))

        return self.robustness(_rewritten(part, truth), truths, time_step)[0] > 0


def _rewritten(node: Any, change: Callable[[Any], Any]) -> Any:
    """A tree with each node replaced by what ``change`` makes of it, leaves first."""
    parts = [name for name in ("left", "right", "operand") if hasattr(node, name)]
    below = {name: _rewritten(getattr(node, name), change) for name in parts}
    return change(replace(node, **below))


def _key(*about: object) -> str:
    return hashlib.blake2b("\n".join(map(str, about)).encode(), digest_size=8).hexdigest()


def _nearly(left: float, right: float) -> bool:
    return math.isclose(left, right, rel_tol=TOLERANCE, abs_tol=TOLERANCE)


def _load() -> tuple[Callable[[str, Sequence[str]], Any], str]:
    """A function that makes parsed specifications, sampled once a second; and rtamt's version."""
    try:
        with warnings.catch_warnings():
            # The generated parser imports `typing.io`, which Python deprecated.
            warnings.simplefilter("ignore", DeprecationWarning)
            from importlib.metadata import version

            import rtamt
    except ImportError as error:
        raise ConfigurationError(
            f"a second engine for formulas needs rtamt, which cannot be imported: {error}",
            key="dura_stl_engine",
            found="both",
            expected="own, or a Python below 3.13 with rtamt installed",
            remedy="pip install 'rtamt>=0.4.10,<0.5', or set dura_stl_engine = own",
        ) from None

    def specified(text: str, names: Sequence[str]) -> Any:
        specification = rtamt.StlDiscreteTimeOfflineSpecification()
        specification.set_sampling_period(1, "s", 0.1)
        for name in names:
            specification.declare_var(name, "float")
        specification.spec = text
        specification.parse()
        return specification

    return specified, version("rtamt")
