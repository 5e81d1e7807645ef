"""``--dura-replay-failures``: the failures of the evidence alone, several times each.

A failure that comes up in each replay is systematic; one that does not has something of chance in
it that the seed does not fix: a live model, a clock, a component that does not repeat itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.text import counted, name
from pytest_dura.plugin.commands.replay import (
    RecordedEpisode,
    damage_as_error,
    recorded_failures,
)
from pytest_dura.plugin.messages import print_lines

if TYPE_CHECKING:
    from pytest_dura.plugin.session.session import DuraSession
    from pytest_dura.requirements.model import Requirement

OPTION = "--dura-replay-failures"
TIMES = 5
"""How often each failure is run without ``--dura-runs``."""
LEAST = 3
"""Replays that make violations systematic which recur in each but differ from the record."""
CONFIDENCE = 0.95
"""Two-sided, of each interval."""
Nature = Literal["systematic", "by chance", "did not come up again", "not known"]


@dataclass(frozen=True)
class FailureReplays:
    """What replays of one violation came to.

    Args:
        requirement: Id of the violated requirement.
        runs: Replays.
        violated: Those that violate it again.
        undecided: Those that decide nothing.
        equal: Those with the digest of the record.
    """

    requirement: str
    runs: int
    violated: int
    undecided: int
    equal: int

    @property
    def nature(self) -> Nature:
        """Whether the violation is systematic, as far as the replays show."""
        decided = self.runs - self.undecided
        if not decided:
            return "not known"
        if self.violated == self.runs and (self.equal == self.runs or self.runs >= LEAST):
            return "systematic"
        if self.violated == self.runs:
            return "not known"
        if self.violated:
            return "by chance"
        return "not known" if self.undecided else "did not come up again"

    @property
    def text(self) -> str:
        """A line on it, with the exact interval of the share where replays differ."""
        share = f"violated in {self.violated} of {counted(self.runs, 'replay')}"
        if self.undecided:
            share += f", {self.undecided} undecided"
        if self.equal == self.runs:
            # Equal runs are no draws: more of them would show nothing else.
            return f"{self.nature}: {share}, all equal to the record"
        from pytest_dura.requirements.rate_tests import lower_bound, upper_bound

        level = (1.0 + CONFIDENCE) / 2.0
        low = lower_bound(self.violated, self.runs, level)
        high = upper_bound(self.violated + self.undecided, self.runs, level)
        interval = f"{100 * CONFIDENCE:.0f} % interval {100 * low:.0f} to {100 * high:.0f} %"
        return f"{self.nature}: {share} ({interval}), {self.equal} equal to the record"


def replay_failures(session: DuraSession) -> int:
    """Run each failure again and return the exit code: 0 if all are systematic, else 1.

    Overruns of time budgets are measured again, and not taken from the record.

    Raises:
        ConfigurationError: For evidence without a failure, and an episode that cannot be built.
    """
    options, code, number = session.options, 0, 0
    times = TIMES if options.runs is None else options.runs
    with damage_as_error(options, OPTION, OPTION):
        for number, (recorded, requirements) in enumerate(  # noqa: B007 - counted
            recorded_failures(session.config, options, OPTION), start=1
        ):
            session.guests.prepare(recorded.spec)
            print_lines([f"{name(recorded.spec.id)} ({name(recorded.spec.component)})"])
            for result in _replayed(recorded, requirements, times):
                code = code if result.nature == "systematic" else 1
                line = f"  {name(result.requirement)}: {result.text}"
                print_lines([line], session.redact)
    if not number:
        raise ConfigurationError(
            "the evidence has no failure that could be replayed",
            file=str(options.evidence / "evidence.json"),
            key=OPTION,
            found="no episode that violates a requirement with a check in a file",
            expected="a session with violations",
            remedy="name another evidence with --dura-evidence",
        )
    return code


def _replayed(
    recorded: RecordedEpisode, requirements: Sequence[Requirement], times: int
) -> Iterator[FailureReplays]:
    from pytest_dura.requirements.episode_verdicts import judge_episode

    spec = replace(recorded.spec, timeouts=None)
    equal, verdicts = 0, []
    for _ in range(times):
        episode = recorded.run(spec)
        equal += episode.digest == recorded.digest
        verdicts.append([judge_episode(each, episode).verdict for each in requirements])
    for requirement, column in zip(requirements, zip(*verdicts, strict=True), strict=True):
        decided = column.count("violated") + column.count("satisfied")
        yield FailureReplays(
            requirement.id, times, column.count("violated"), times - decided, equal
        )
