"""Verdicts on episodes of campaigns and of searches, and the episode that test functions get.

A search looks where it expects violations, so that its episodes are no sample of anything. They
have types of their own, which neither :func:`judge_episode` nor a campaign takes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NoReturn, get_args

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.boundary import Boundary
from pytest_dura.core.codec import Number
from pytest_dura.core.display import Shown, short_repr
from pytest_dura.core.episode import LOST, RECORDED, Episode
from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.core.loop_signals import LOOP_PREFIX, loop_signals
from pytest_dura.core.loop_signals import PROPOSAL_PREFIX as ACCOUNTS
from pytest_dura.requirements.checks import (
    Check,
    CheckResult,
    check_name,
    check_result,
    is_function_path,
    load_function,
    read_formula,
)
from pytest_dura.requirements.margins import columns_of, margins_over_time, moment_of
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.second_engine import (
    FUNCTION,
    NO_ACCOUNT,
    NO_TRACE,
    NOT_FINITE,
    NOT_KNOWN,
    EnginesDisagreeError,
    SecondEngine,
)
from pytest_dura.requirements.stl.evaluation import Ending, Evaluation, evaluate
from pytest_dura.requirements.stl.formula import Formula, conjuncts, unknown_signal
from pytest_dura.requirements.stl.uncertainty import (
    GREATEST,
    LEAST,
    uncertain_signals,
    with_bounds,
)

if TYPE_CHECKING:
    from typing_extensions import Self


def _unmeasured_failure_modes(formula: Formula, episode: Episode) -> list[str]:
    """Failure modes in a formula that no decision of the episode could have shown.

    Their signals are 0 throughout. That such a formula holds says nothing.
    """
    names = [name.removeprefix(ACCOUNTS) for name in formula.signals if name.startswith(ACCOUNTS)]
    tallies = episode.metrics.tallies
    return [name for name in names if name in tallies and tallies[name].of == 0]


class SealedColumns(dict[str, NDArray[Any]]):
    """Columns by name, neither of which can be written; ``dict(columns)`` is a copy that can grow.

    Args:
        columns: The columns. They are sealed in place.
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        super().__init__(columns)
        for column in columns.values():
            np.asarray(column).flags.writeable = False

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles are plain dictionaries."""
        return dict, (dict(self),)

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise TypeError("the columns of an episode cannot be changed; take a copy, dict(columns)")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse


EpisodeStatus = Literal["satisfied", "violated", "open", "invalid", "missing"]
EPISODE_STATUSES: tuple[str, ...] = get_args(EpisodeStatus)

EARLY_ENDS = {
    "critical": "the episode ended critical",
    "halt": "the episode was halted",
    "violation": "the episode ended at a violation of something else",
    "decided": "the episode ended once the requirements of its case were decided",
    LOST: "a call of the component ended the process",
    RECORDED: "the log does not show more",
}
"""Ends that come before the time limit or the goal, and that the component may have caused."""
_ENDINGS: dict[str, Ending] = {
    "critical": "stopped",
    "halt": "stopped",
    "goal": "goal",
    "violation": "open",
    "decided": "open",
}
"""How a trace ended, by the episode's termination; otherwise at the time limit."""
_WHOLE = (
    "run it with --dura-end=complete if that is known with hindsight: the episode ended once the "
    "requirements of its case were decided"
)


@dataclass(frozen=True, slots=True)
class CheckVerdict:
    """What a check says of one run, apart from what the run says of itself."""

    status: EpisodeStatus
    """`satisfied`, `violated`, `open` (the run ended before it was decided), `invalid` (it is no
    sample) or `missing`."""
    margin: Number | None
    """Robustness, in the unit of the check; null where there is no trace to measure it on."""
    time: Number | None
    """When it was violated first, in simulated seconds; null for none."""
    detail: str
    """Why, in words."""
    vacuous: bool
    """Whether it is satisfied only because its condition never held."""

    @classmethod
    def of(cls, verdict: EpisodeVerdict) -> CheckVerdict:
        """Take the part of a verdict that the run does not say itself."""
        return cls(verdict.verdict, verdict.margin, verdict.time, verdict.detail, verdict.vacuous)


@dataclass(frozen=True, slots=True)
class EpisodeVerdict(Shown):
    """Verdict of one requirement on one episode; plain data that crosses processes.

    Args:
        requirement: Id of the requirement.
        episode: Id of the episode, ``case#run``.
        component: Name of the component under test.
        verdict: ``satisfied``, ``violated``, ``open`` (the episode ended before it was decided),
            ``invalid`` or ``missing``.
        margin: Robustness; ``None`` where there is no trace to measure it on.
        time: Seconds at which the requirement was violated first, for a violation.
        detail: Why, in words.
        vacuous: Whether it is satisfied only because its condition never held, or no decision could
            have shown the failure mode that it looks at.
        proposals: How often the component was asked.
        valid_proposals: How often it answered with a valid action.
        not_manifested: Ids of planned faults that never manifested. A valid episode has such where
            hits are drawn.
        without_effect: Whether it is violated in a run that is invalid, since a planned fault never
            manifested: the violation counts, and the run is no sample of runs with that fault.
        ended: How the episode ended, if that was an early end: a key of :data:`EARLY_ENDS`.
        unseen_crash: Id of the episode, or of its twin, that ended critical and violates no
            requirement of its case on single episodes; empty without one.
    """

    requirement: str
    episode: str
    component: str
    verdict: EpisodeStatus
    margin: float | None
    time: float | None
    detail: str
    proposals: int
    valid_proposals: int
    vacuous: bool = False
    not_manifested: tuple[str, ...] = ()
    without_effect: bool = False
    ended: str = ""
    unseen_crash: str = ""

    __repr__ = short_repr

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows."""
        yield "requirement", self.requirement
        yield "episode", self.episode
        yield "component", self.component
        yield "verdict", self.verdict + (", vacuous" if self.vacuous else "")
        yield "margin", self.margin
        yield "violated at, s", self.time
        yield "detail", self.detail

    @property
    def valid(self) -> bool:
        """Whether the run counts for this requirement: in its n, its bound and its tables."""
        return self.verdict in ("satisfied", "violated", "open") and not self.without_effect


def judge_episode(
    requirement: Requirement, episode: Episode, check: Check | None = None
) -> EpisodeVerdict:
    """The verdict of a requirement on an episode, with what the episode says of itself.

    Args:
        requirement: The requirement.
        episode: The episode.
        check: A check in place of the requirement's own.

    Raises:
        ConfigurationError: See :func:`judge_run`.
    """
    judged = judge_run(requirement, episode, check)
    return EpisodeVerdict(
        requirement=requirement.id,
        episode=episode.id,
        component=episode.spec.component,
        verdict=judged.status,
        margin=judged.margin,
        time=judged.time,
        detail=judged.detail,
        proposals=episode.metrics.proposals,
        valid_proposals=episode.metrics.valid_proposals,
        vacuous=judged.vacuous,
        not_manifested=episode.not_manifested,
        without_effect=judged.status == "violated" and episode.validity == "invalid",
        ended=episode.termination if episode.termination in EARLY_ENDS else "",
    )


def judge_run(
    requirement: Requirement, episode: Episode, check: Check | None = None
) -> CheckVerdict:
    """What a requirement's check says of an episode of a campaign.

    Args:
        requirement: The requirement.
        episode: The episode.
        check: A check in place of the requirement's own.

    Raises:
        ConfigurationError: If there is no check, or it cannot be read or imported or names
            a signal that the episode does not have; and for an episode that a search chose.
    """
    check = requirement.check if check is None else check
    if episode.searched:
        raise ConfigurationError(
            f"the episode {episode.id!r} was chosen by a search, and is no sample of anything",
            found=episode.id,
            expected="an episode of a campaign",
            remedy="use judge_searched, or ask the episode itself: episode.satisfies(...)",
        )
    if not check:
        raise ConfigurationError(
            f"requirement {requirement.id!r} has no check",
            key="check",
            expected="a formula such as `always (gap > 0)`, or the path of a function",
            remedy="add a check, or judge it in test code",
        )
    return _judged_by_both(requirement, check, episode)


def _judged_by_both(requirement: Requirement, check: Check, episode: Episode) -> CheckVerdict:
    """As :func:`judge_by_check`; the episode is missing where two engines differ."""
    try:
        return judge_by_check(check, episode)
    except EnginesDisagreeError as error:
        values = f"`{check}`: {error.values}"
        detail = str(EnginesDisagreeError(requirement.id, error.episode, values))
        return CheckVerdict("missing", None, None, detail, vacuous=False)


def judge_by_check(check: Check, episode: Episode) -> CheckVerdict:
    """What a check says of an episode of any kind.

    A formula and an import path are evaluated once an episode, wherever that is: the verdict stays
    with the episode, also on its way from another process and on disk.

    Raises:
        ConfigurationError: If the check cannot be read or imported, or names a signal that the
            episode does not have.
        EnginesDisagreeError: If two engines evaluate a formula, and differ.
    """
    known = episode.check_verdicts if isinstance(episode, JudgedEpisode) else {}
    if isinstance(check, str) and check in known:
        return known[check]
    status, result = _judged(check, episode)
    time = result.time if status == "violated" else None
    vacuous = result.vacuous and status == "satisfied"
    verdict = CheckVerdict(status, result.margin, time, result.detail, vacuous)
    if isinstance(check, str):
        known[check] = verdict
    return verdict


def _judged(check: Check, episode: Episode) -> tuple[EpisodeStatus, CheckResult]:
    if isinstance(check, str) and not is_function_path(check):
        return _by_formula(read_formula(check), episode)
    _pass_over(check_name(check), episode, FUNCTION)
    function = load_function(check) if isinstance(check, str) else check
    return _by_function(function, check_name(check), episode)


def _by_formula(formula: Formula, episode: Episode) -> tuple[EpisodeStatus, CheckResult]:
    evaluation, gap = evaluate_episode(formula, episode)
    if evaluation is None:
        return _without_trace(episode)
    margin = evaluation.margin if math.isfinite(evaluation.margin) else None

    def result(detail: str, *, holds: bool = False) -> CheckResult:
        vacuous = evaluation.vacuous or bool(_unmeasured_failure_modes(formula, episode))
        return CheckResult(holds, margin, evaluation.time, detail, holds and vacuous)

    if evaluation.status == "violated":
        return "violated", result(evaluation.detail)
    uncounted = _uncounted(episode)
    if uncounted is not None:
        return uncounted[0], result(uncounted[1])
    if evaluation.status == "undecided":
        interval = f"robustness between {evaluation.lower:.3g} and {evaluation.upper:.3g}"
        early = EARLY_ENDS.get(episode.termination)
        if gap is None and early is not None:
            return "open", result(f"{early}: {evaluation.detail}: {interval}")
        return "invalid", result(gap or f"{evaluation.detail}: {interval}")
    return "satisfied", result(evaluation.detail, holds=True)


def _by_function(
    function: Callable[..., Any], name: str, episode: Episode
) -> tuple[EpisodeStatus, CheckResult]:
    """A function sees complete episodes only: it cannot know what a prefix may become.

    An episode that ended critical, or was halted, is complete: nothing follows it.
    """
    if episode.failure is not None or episode.ticks == 0:
        return _without_trace(episode)
    try:
        with Boundary() as boundary:
            result = check_result(function(JudgedEpisode.of(episode)))
            boundary.raise_signalled()
    except ConfigurationError:
        raise
    except BaseException as error:
        boundary.let_pass(error)
        detail = f"infrastructure: check {name}: {describe_error(error)}"
        return "missing", CheckResult(False, detail=detail)
    if result.margin is not None and not math.isfinite(result.margin):
        result = CheckResult(result.holds, None, result.time, result.detail, result.vacuous)
    uncertain = [name for name in episode.signals if name.startswith(LEAST)]
    if uncertain:
        detail = f"not each sample of {uncertain[0].removeprefix(LEAST)} is known, and a function "
        return "open", CheckResult(False, detail=detail + "cannot take that into account")
    if not result.holds:
        return "violated", result
    uncounted = _uncounted(episode)
    if uncounted is None and episode.ended_early:
        uncounted = "open", EARLY_ENDS[episode.termination]
    if uncounted is not None:
        return uncounted[0], CheckResult(False, result.margin, None, uncounted[1])
    return "satisfied", result


def _without_trace(episode: Episode) -> tuple[EpisodeStatus, CheckResult]:
    """Status of an episode whose trace says nothing: open where the component ended its process."""
    if episode.termination != LOST:
        return "missing", CheckResult(False, detail=episode.failure or "the episode has no samples")
    death = episode.events[-1]
    detail = f"{EARLY_ENDS[LOST]} at tick {death.tick}: {death.detail}"
    return "open", CheckResult(False, detail=detail)


def _uncounted(episode: Episode) -> tuple[EpisodeStatus, str] | None:
    """Status and reason of an episode that cannot satisfy anything; ``None`` for a valid one."""
    if episode.failure is not None:
        return "missing", episode.failure
    if episode.validity == "invalid":
        return "invalid", episode.invalid_reason or "the episode is not valid"
    return None


def evaluate_episode(formula: Formula, episode: Episode) -> tuple[Evaluation | None, str | None]:
    """Evaluate a formula on the finite part of an episode's signals; say what cut it short, if so.

    The evaluation is ``None`` for an episode without samples. Where the component gives no account
    of its proposals, a formula that needs one is undecided, unless a part without it is violated.
    After an infrastructure error the trace is a prefix: it can show a violation, but not that there
    was none.

    Where the episode has a second engine, that evaluates the formula as well.

    Raises:
        ConfigurationError: For a signal that the episode does not have.
        EnginesDisagreeError: If the second engine differs.
    """
    known: Mapping[str, NDArray[np.float64]] = episode.signals
    if any(name.startswith(LOOP_PREFIX) for name in formula.signals):
        known = {**known, **loop_signals(episode)}
    missing = [name for name in formula.signals if name not in known]
    of_accounts = [name for name in formula.signals if name.startswith(ACCOUNTS)]
    has_account = any(name.startswith(ACCOUNTS) for name in known)
    if missing and missing == of_accounts and not has_account and episode.ticks:
        return _without_account(formula, missing, episode)
    if missing and (episode.signals or (episode.failure is None and episode.ticks)):
        remedy = _WHOLE if episode.termination == "decided" else None
        named = [name for name in known if not name.startswith((LEAST, GREATEST))]
        raise unknown_signal(missing[0], named, str(formula), None, remedy)
    if missing or episode.ticks == 0:
        _pass_over(str(formula), episode, NO_TRACE)
        return None, None
    columns = with_bounds(formula.signals, known)
    uncertain = uncertain_signals(formula.signals, known)
    certain = [name for name in formula.signals if name not in uncertain]
    finite = np.logical_and.reduce([np.isfinite(known[name]) for name in certain])
    samples = episode.ticks if finite.all() else int(np.argmin(finite))
    gap = None
    if samples < episode.ticks:
        bad = next(name for name in certain if not np.isfinite(known[name][samples]))
        gap = f"the signal {bad!r} is not finite at t = {episode.time[samples]:g} s"
        if samples == 0:
            _pass_over(str(formula), episode, NOT_FINITE)
            undecided = Evaluation("undecided", np.inf, -np.inf, np.inf, None, 0.0, gap)
            return undecided, gap
    # The episode may have ended early for other formulas than this one.
    whole = samples == episode.ticks and episode.failure is None
    cut = {name: column[:samples] for name, column in columns.items()}
    evaluation = evaluate(
        formula,
        episode.time[:samples],
        cut,
        ending=_ENDINGS.get(episode.termination, "time") if whole else "open",
        time_step=episode.spec.time_step,
    )
    engine = _second_engine(episode)
    if uncertain:
        _pass_over(str(formula), episode, NOT_KNOWN)
    elif engine is not None:
        engine.compare(
            formula,
            evaluation,
            cut,
            time_step=episode.spec.time_step,
            episode=episode.id,
            spec=episode.spec.key,
        )
    if episode.termination == "decided" and evaluation.status == "satisfied":
        # What would have followed can lower the margin to this.
        evaluation = replace(evaluation, margin=evaluation.lower)
    return evaluation, gap


def _without_account(
    formula: Formula, missing: Sequence[str], episode: Episode
) -> tuple[Evaluation, str]:
    """Undecided, unless a part of the formula that reads no account is violated."""
    detail = f"the component gives no account of its proposals, so that {missing[0]!r} is not known"
    for part in conjuncts(formula.root):
        known = Formula(part, formula.text)
        if not set(missing) & set(known.signals):
            evaluation, _ = evaluate_episode(known, episode)
            if evaluation is not None and evaluation.status == "violated":
                return evaluation, detail
    _pass_over(str(formula), episode, NO_ACCOUNT)
    return Evaluation("undecided", np.nan, -np.inf, np.inf, None, 0.0, detail), detail


def _second_engine(episode: Episode) -> SecondEngine | None:
    return episode.second_engine if isinstance(episode, JudgedEpisode) else None


def _pass_over(check: str, episode: Episode, reason: str) -> None:
    """Tell the second engine, if there is one, of a verdict that it cannot reach."""
    engine = _second_engine(episode)
    if engine is not None:
        engine.pass_over(check, episode.spec.key, reason)


@dataclass(repr=False)
class JudgedEpisode(Episode):
    """An episode with methods that evaluate formulas; what test functions get."""

    second_engine: ClassVar[SecondEngine | None] = None
    """Evaluates formulas as well, where an episode has one."""

    @classmethod
    def of(cls, episode: Episode) -> Self:
        """The same episode with these methods, read-only: all requirements share it."""
        made = cls(**{field.name: getattr(episode, field.name) for field in fields(Episode)})
        if isinstance(episode, JudgedEpisode):
            made.evaluate_also_by(episode.second_engine)
            vars(made)["_check_verdicts"] = episode.check_verdicts
        made.time.flags.writeable = False
        made.signals = SealedColumns(made.signals)
        made.decisions = SealedColumns(made.decisions)
        vars(made)["_sealed"] = True
        return made

    @property
    def check_verdicts(self) -> dict[str, CheckVerdict]:
        """What checks say of the episode, by their text; one for it and all of its copies."""
        verdicts: dict[str, CheckVerdict] = vars(self).setdefault("_check_verdicts", {})
        return verdicts

    def evaluate_also_by(self, engine: SecondEngine | None) -> None:
        """Set the second engine, which is no part of what happened in the episode."""
        if engine is not None:
            vars(self)["second_engine"] = engine

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse it once the episode is sealed."""
        if "_sealed" in vars(self):
            raise AttributeError(f"`{name}` of an episode cannot be changed")
        super().__setattr__(name, value)

    def robustness(self, formula: str) -> float:
        """How far the episode stays clear of violating a formula; below 0 it is violated.

        Where the trace ends before the formula is decided, this is the least value that is still
        possible, so that a test that compares it with a limit fails closed.

        Raises:
            ConfigurationError: If the formula cannot be read or names an unknown signal.
        """
        evaluation, _ = evaluate_episode(read_formula(formula), self)
        return -math.inf if evaluation is None else evaluation.robustness

    def margins(self, formula: str) -> NDArray[np.float64]:
        """The robustness of a formula at each tick, shape ``(ticks,)``.

        An ``always`` over the whole episode at the root is left out, so that it shows the moment:
        the least of it is the margin. NaN where a signal is not finite, and after that.

        Raises:
            ConfigurationError: If the formula cannot be read, names an unknown signal, or has an
                expression that is not finite.
        """
        moment = moment_of(read_formula(formula))
        columns = columns_of(moment, self.time, self.signals, self.decisions)
        for name in moment.signals:
            if name not in columns:
                self.signal(name)  # raises, with the names that there are
        return margins_over_time(moment, columns, self.spec.time_step)

    def satisfies(self, check: Check) -> bool:
        """Whether a check is decided and holds on this episode, which is itself valid.

        Raises:
            ConfigurationError: If a formula cannot be read or names an unknown signal.
        """
        return judge_by_check(check, self).status == "satisfied"


class SearchedEpisode(JudgedEpisode):
    """An episode that a search or a strategy chose; it enters no rate."""

    searched: ClassVar[bool] = True


@dataclass(frozen=True, slots=True)
class SearchVerdict:
    """Verdict of one requirement on one episode of a search; no :class:`EpisodeVerdict`.

    Args:
        requirement: Id of the requirement.
        episode: Id of the episode.
        status: ``satisfied``, ``violated``, ``open``, ``invalid`` or ``missing``.
        margin: Robustness; ``None`` where there is no trace to measure it on, and for a check that
            gives none.
        time: Seconds at which it was violated first, for a violation.
        detail: Why, in words.
        vacuous: Whether it is satisfied only because its condition never held.
    """

    requirement: str
    episode: str
    status: EpisodeStatus
    margin: float | None
    time: float | None
    detail: str
    vacuous: bool = False


def judge_searched(
    requirement: Requirement, episode: SearchedEpisode, check: Check | None = None
) -> SearchVerdict:
    """Judge an episode of a search by a requirement's check.

    Args:
        requirement: The requirement.
        episode: The episode.
        check: A check in place of the requirement's own.

    Raises:
        ConfigurationError: If the check cannot be read or imported, or names a signal that the
            episode does not have.
    """
    check = requirement.check if check is None else check
    judged = _judged_by_both(requirement, check, episode)
    return SearchVerdict(
        requirement.id,
        episode.id,
        judged.status,
        judged.margin,
        judged.time,
        judged.detail,
        judged.vacuous,
    )
