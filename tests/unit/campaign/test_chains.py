"""The chain of a fault: what its episode's verdicts make of it."""

from __future__ import annotations

from typing import Any

import pytest
from handmade import handmade

from pytest_dura import Episode
from pytest_dura.campaign.fault_tracing import causal_chains
from pytest_dura.core import Divergence, FaultRecord
from pytest_dura.requirements import Paired, Requirement

FREE = Requirement("SAF-1", check="always (gap > 0)")
NEAR = Requirement("SAF-2", check="always (gap > 1)")


def episode(*gaps: float, failure: str | None = None, **fault: Any) -> Episode:
    record = FaultRecord("f", "lidar", 0.1, **fault)
    return handmade(len(gaps), gap=gaps, faults=(record,), failure=failure)


ACTIVE: dict[str, Any] = {"activated_at": 0.1}
MANIFEST: dict[str, Any] = {**ACTIVE, "manifested_at": 0.1}


@pytest.mark.parametrize(
    "gaps, fault, divergence, outcome",
    [
        ((5, 5, 5), {}, None, "idle"),
        ((5, 5, 5), ACTIVE, None, "masked"),
        ((5, 5, 5), MANIFEST, None, "tolerated"),
        ((5, 5, 5), MANIFEST, Divergence(), "contained"),
        ((5, 5, 5), MANIFEST, Divergence(0.1), "tolerated"),
        ((5, 5, 5), MANIFEST, Divergence(doubt="d"), "tolerated"),
        ((5, 5, 0), MANIFEST, Divergence(0.1), "violated"),
        ((5, 0, 5), MANIFEST, Divergence(0.1), "violated"),
        ((5, 5, 0), ACTIVE, None, "masked"),  # a violation, but none of its doing
        ((5, 5, 0), {}, None, "idle"),
    ],
)
def test_the_outcome(
    gaps: tuple[float, ...], fault: dict[str, Any], divergence: Divergence | None, outcome: str
) -> None:
    (chain,) = causal_chains(episode(*gaps, **fault), [FREE], None, divergence)
    assert chain.outcome == outcome
    assert chain.violated == (("SAF-1",) if outcome == "violated" else ())


def test_a_violation_before_it_manifested_is_none_of_its_doing() -> None:
    late = episode(0, 5, 5, activated_at=0.1, manifested_at=0.1)
    (chain,) = causal_chains(late, [FREE], None, Divergence(0.1))
    assert (chain.outcome, chain.violated) == ("tolerated", ())


def test_what_the_twin_violates_too_is_not_the_faults_doing() -> None:
    faulty, twin = episode(5, 0, 0, **MANIFEST), episode(5, 0.5, 5)
    (chain,) = causal_chains(faulty, [FREE, NEAR], twin, Divergence(0.1))
    assert chain.violated == ("SAF-1", "SAF-2")
    assert chain.violated_without == ("SAF-2",)
    assert chain.outcome == "violated"
    (chain,) = causal_chains(faulty, [NEAR], twin, Divergence(0.1))
    assert (chain.violated, chain.violated_without) == (("SAF-2",), ("SAF-2",))
    assert chain.outcome == "violated also without it"
    for missing in (None, episode(5, 0.5, 5, failure="infrastructure: x")):
        (alone,) = causal_chains(faulty, [FREE, NEAR], missing)
        assert (alone.violated, alone.violated_without) == (("SAF-1", "SAF-2"), None)


def test_a_missing_episode_tells_no_outcome_but_a_violation() -> None:
    broken = episode(5, 5, 5, failure="infrastructure: x", **MANIFEST)
    assert causal_chains(broken, [FREE])[0].outcome == "missing"
    hurt = episode(5, 0, 0, failure="infrastructure: x", **MANIFEST)
    assert causal_chains(hurt, [FREE])[0].outcome == "violated"


def test_requirements_on_pairs_and_on_other_signals_are_left_to_their_own_judges() -> None:
    paired = Requirement("REC-1", check="always (gap > 0)", paired=Paired("faults"))
    other = Requirement("X-1", check="always (warmth > 0)")
    code = Requirement("X-2")
    (chain,) = causal_chains(episode(5, 0, 0, **MANIFEST), [paired, other, code])
    assert chain.outcome == "tolerated"


def test_a_chain_has_all_that_is_known() -> None:
    (chain,) = causal_chains(episode(5, 0, 0, **MANIFEST), [FREE], None, Divergence(0.1))
    assert (chain.id, chain.manifested_at, chain.propagated_at) == ("f", 0.1, 0.1)
    assert (chain.propagation, chain.outcome, chain.violated) == (
        "propagated", "violated", ("SAF-1",),
    )  # fmt: skip
