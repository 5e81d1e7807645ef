"""ItemVerdict: the verdict that an item asked for, with what excuses it, and its other attempts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pytest_dura.core.codec import Count, Positive
from pytest_dura.requirements.campaign_verdicts import CampaignVerdict

WaiverKind = Literal["xfail", "rerun", "skip"]


@dataclass(frozen=True, slots=True)
class Waiver:
    """What excuses the failure of an item."""

    kind: WaiverKind
    """What excused it."""
    reason: str
    """As the test gives it."""


@dataclass(frozen=True, slots=True)
class FalseCheck:
    """A check that a test asked for and that did not hold, though it passed."""

    check: str
    """Its text."""
    episodes: Positive
    """In how many episodes."""


@dataclass(frozen=True, slots=True)
class FailedAssertion:
    """The assertion that failed in an episode."""

    episode: str
    """Its id."""
    message: str
    """The message, and the line of the test."""


@dataclass(frozen=True, slots=True)
class AssertionSummary:
    """What the assertions of a test on single episodes rest on."""

    alone: bool
    """Whether they alone decided: the requirement has no check that could judge the episodes."""
    by_check: Count
    """Episodes that violated the requirement's own check."""
    observed: tuple[str, ...]
    """What the test read of its episodes, sorted: attributes, signals, checks; at most 50."""
    false: tuple[FalseCheck, ...]
    """Checks that a test asked for and that did not hold, though it passed."""
    failed: tuple[FailedAssertion, ...]
    """The assertion that failed, for the first 10 episodes in which one did."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ItemVerdict(CampaignVerdict):
    """What one requirement says of a campaign, as an item asked, with every figure behind it."""

    item: str
    """Node id of the test that asked."""
    waiver: Waiver | None = None
    """What excused its failure; null if nothing did."""
    attempts: tuple[CampaignVerdict, ...] = ()
    """Other verdicts of the same test, which was retried or repeated."""
    assertion: AssertionSummary | None = None
    """What the assertions of a test on single episodes rest on; null where no test decided."""
    also_without: Count | None = None
    """Violations that the run of the same seed without any fault shows as well: they count, and are
    not the faults' doing; null where that was measured of none."""
