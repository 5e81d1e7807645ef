"""Runner: what the ``orchestrator`` fixture returns; joins campaigns and searches."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

from pytest_dura.campaign.campaign import Campaign
from pytest_dura.campaign.events import CausalChain
from pytest_dura.campaign.fault_tracing import FaultTracer
from pytest_dura.campaign.runner import EpisodeRunner
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.library.cases import Case, SearchedCase
from pytest_dura.requirements.episode_verdicts import JudgedEpisode
from pytest_dura.requirements.model import Requirement
from pytest_dura.search.counterexamples import CounterexampleStore
from pytest_dura.search.falsify import falsify_campaign


@dataclass(repr=False)
class Runner(EpisodeRunner):
    """Runs cases by name, makes campaigns of them, and searches them.

    Args:
        counterexamples: Stores the counterexamples that searches confirm; ``None`` stores none.
            All other arguments are those of :class:`EpisodeRunner`.
    """

    counterexamples: CounterexampleStore | None = None
    _tracer: FaultTracer = field(init=False)

    def __post_init__(self) -> None:
        """Trace faults with this runner."""
        self._tracer = FaultTracer(self)

    def chains(self, case: Case, episode: JudgedEpisode) -> list[CausalChain]:
        """Each fault of an episode from plan to outcome, with the help of fault-free twins.

        Args:
            case: The case that it belongs to.
            episode: One of its runs.
        """
        return self._tracer.chains(case, episode)

    def campaign(
        self,
        case: Case | str,
        runs: int | None = None,
        requirement: Requirement | None = None,
        *,
        until_decided: bool | None = None,
    ) -> Campaign:
        """All planned runs of a case.

        Args:
            case: The case, or its name.
            runs: Planned runs instead of the scenario's.
            requirement: What :meth:`Campaign.require` decides.
            until_decided: Whether runs end once the requirement is decided, instead of what the
                scenario says.

        Raises:
            ConfigurationError: For an unknown name, and a case that a search chose.
        """
        chosen = self.case(case) if isinstance(case, str) else case
        if isinstance(chosen, SearchedCase):
            raise ConfigurationError(
                f"the case {chosen.id!r} was chosen by a search, and no rate can be made of it",
                found=chosen.id,
                expected="a case of a scenario",
                remedy="run it as such, orchestrator.episode(case), or keep it as a scenario file",
            )
        planned = self.runs or runs or chosen.scenario.planned
        if until_decided is None:
            until_decided = chosen.scenario.until_decided and runs is None
        return Campaign(
            self,
            chosen,
            planned,
            requirement,
            until_decided,
            tracer=self._tracer,
            search=partial(falsify_campaign, store=self.counterexamples),
        )
