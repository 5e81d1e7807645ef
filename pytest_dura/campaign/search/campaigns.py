"""A campaign that is searched: what is asked for, and how a test is told what came of it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from pytest_dura.campaign.fault_campaigns import FaultCampaign
from pytest_dura.campaign.problems import did_you_mean
from pytest_dura.campaign.references import check_formula
from pytest_dura.campaign.search.falsify import falsify
from pytest_dura.campaign.search.limits import Limits
from pytest_dura.campaign.search.result import Falsification
from pytest_dura.campaign.search.trials import Asked
from pytest_dura.campaign.search.words import told
from pytest_dura.core.errors import ConfigurationError, DuraError
from pytest_dura.requirements.checks import check_name, is_function_path
from pytest_dura.requirements.model import Requirement

if TYPE_CHECKING:
    from pytest_dura.campaign.campaigns import Campaign

_ID = re.compile(r"[A-Za-z][A-Za-z0-9_.]*-[A-Za-z0-9_.-]+")
"""What looks like the id of a requirement rather than like a formula."""


class Falsified(DuraError):  # noqa: N818 - it is an outcome, not an error
    """A search found a violation, or learned too little. ``falsification`` says what it did."""

    def __init__(self, message: str, falsification: Falsification) -> None:
        self.falsification = falsification
        super().__init__(message)


def falsify_campaign(
    campaign: Campaign,
    wanted: Any,
    *,
    faults: FaultCampaign | Sequence[FaultCampaign],
    budget: int,
    at_most: int,
    shrink: int,
    seed: int | None,
) -> Falsification:
    """See :meth:`pytest_dura.campaign.campaigns.Campaign.falsify`."""
    __tracebackhide__ = True
    bench = campaign.bench
    limits = Limits(budget, shrink, at_most)
    asked = [_asked(campaign, one) for one in _several(wanted)]
    unkept: list[ConfigurationError] = []
    found = falsify(
        bench,
        campaign.case,
        asked,
        limits=limits,
        faults=_faults(faults),
        seed=_seed(seed),
        keep=bench.keep,
        unkept=unkept.append,
    )
    if any(one.word != "nothing found" for one in found.outcomes):
        lost = [f"not kept: {error}" for error in unkept]
        raise Falsified("\n".join([*told(found), *lost]), found)
    return found


def _faults(given: Any) -> Sequence[FaultCampaign]:
    if isinstance(given, (str, Mapping)):
        return [given]
    if not isinstance(given, Sequence):
        raise ConfigurationError(
            "this names no faults",
            key="faults",
            found=given,
            expected="a fault's name or data, or a list of them",
            remedy='for example faults=["delay"]',
        )
    return given


def _seed(given: Any) -> int | None:
    whole = isinstance(given, int) and not isinstance(given, bool)
    if given is None or (whole and given >= 0):
        return cast("int | None", given)
    raise ConfigurationError(
        "the seed of a search is a whole number of at least 0",
        key="seed",
        found=given,
        expected="0 or more",
    )


def _several(wanted: Any) -> list[Any]:
    if isinstance(wanted, Sequence) and not isinstance(wanted, str):
        if not wanted:
            raise ConfigurationError(
                "the search is asked for nothing",
                key="requirement",
                found="an empty list",
                expected="ids of requirements, or formulas",
            )
        return list(wanted)
    return [wanted]


def _asked(campaign: Campaign, wanted: Any) -> Asked:
    """One requirement that the search tries to violate, and which can be judged in this case."""
    requirement, check = _requirement(campaign, wanted)
    if requirement.paired is not None:
        raise ConfigurationError(
            f"the requirement {requirement.id!r} is about pairs, and a search runs none",
            key=requirement.id,
            expected="a requirement with a check on one episode",
            remedy="search for a violation of its check: campaign.falsify('always (...)')",
        )
    if not (check or requirement.check):
        raise ConfigurationError(
            f"requirement {requirement.id!r} has no check to violate",
            key="check",
            found=requirement.id,
            expected="a check, or a requirement with one in its file",
            remedy="call campaign.falsify('always (gap > 0)'), or add a `check` to the file",
        )
    if campaign.bench.simulator is None:  # another simulator than the scenario's tells by running
        check_formula(campaign.case.scenario, check or requirement.check)
    return Asked(requirement, check)


def is_formula(text: str) -> bool:
    """Whether a text that is no known requirement is a formula, and no id or import path."""
    return _ID.fullmatch(text) is None and not is_function_path(text)


def _requirement(campaign: Campaign, wanted: Any) -> tuple[Requirement, Any]:
    known = campaign.bench.library().requirements
    if wanted is None:
        if campaign.requirement is None:
            raise ConfigurationError(
                "there is no requirement to search a violation of",
                key="requirement",
                found="a test without a marker `requirement`",
                expected="a requirement's id or a formula",
                remedy="call campaign.falsify('SAF-1'), or add the marker",
            )
        return campaign.requirement, None
    if isinstance(wanted, Requirement):
        return wanted, None
    if isinstance(wanted, str) and wanted in known:
        return known[wanted], None
    if isinstance(wanted, str) and _ID.fullmatch(wanted) and not is_function_path(wanted):
        raise ConfigurationError(
            f"unknown requirement {wanted!r}",
            key="requirement",
            found=wanted,
            expected="one of " + ", ".join(known) + ", or a formula",
            remedy=did_you_mean(wanted, known),
        )
    if not (isinstance(wanted, str) or callable(wanted)):
        raise ConfigurationError(
            "this is nothing that an episode could violate",
            key="requirement",
            found=wanted,
            expected="a requirement's id, a formula, or a function of the episode",
        )
    if isinstance(wanted, str):
        return Requirement(check_name(wanted), check=wanted), None
    return Requirement(check_name(wanted)), wanted
