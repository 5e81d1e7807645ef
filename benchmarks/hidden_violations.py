"""How often a rate at its limit is supported although violations hide behind an early end.

Run: python benchmarks/hidden_violations.py [--campaigns 10000]

Each campaign draws episodes that violate a requirement with a probability of exactly the limit. Of
these violations a share is hidden: the component crashes before, and the episode ends undecided.
The campaign's own judge decides, once with such episodes as they are, open, and once as if they
were left out of the sample, which is what a component could exploit. No simulator runs, so that the
figures hold on any machine.
"""

from __future__ import annotations

import argparse

import numpy as np
from machine import table

from pytest_dura.requirements import (
    CampaignJudge,
    EpisodeStatus,
    EpisodeVerdict,
    Method,
    Requirement,
)

LIMIT, P0, CONFIDENCE = 0.05, 0.01, 0.95
SHARES = (0.0, 0.5, 0.8, 1.0)
PLANS: tuple[tuple[Method, float | None, int], ...] = (
    ("fixed", None, 93),
    ("sprt", P0, 300),
    ("e-process", None, 300),
)


def episode(word: EpisodeStatus) -> EpisodeVerdict:
    """An episode's verdict; which run it was does not matter to a rate."""
    ended = "critical" if word == "open" else ""
    return EpisodeVerdict("R", "case#0", "component", word, None, None, "", 10, 10, ended=ended)


SATISFIED, VIOLATED, OPEN, LEFT_OUT = map(episode, ("satisfied", "violated", "open", "invalid"))


def supported(
    plan: tuple[Method, float | None, int], draws: np.ndarray, share: float, hidden: EpisodeVerdict
) -> bool:
    """Whether one campaign supports the limit.

    Args:
        plan: Method, its second rate, and the planned episodes.
        draws: Uniform numbers of shape ``(planned, 2)``.
        share: Share of the violations that hide behind an early end.
        hidden: What such an episode counts as.
    """
    method, p0, planned = plan
    requirement = Requirement("R", at_most=LIMIT, confidence=CONFIDENCE, method=method, p0=p0)
    judge = CampaignJudge(requirement, "case", planned=planned)
    for violates, hides in zip(draws[:, 0] < LIMIT, draws[:, 1] < share, strict=True):
        judge.add((hidden if hides else VIOLATED) if violates else SATISFIED)
        if judge.decided:
            break
    return judge.verdict().verdict == "supported"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--campaigns", type=int, default=10_000)
    options = parser.parse_args()
    print(
        f"true rate {LIMIT:g}, at most {LIMIT:g} at confidence {CONFIDENCE:g}, "
        f"{options.campaigns} campaigns a point: share that is supported, in %\n"
    )
    rows = []
    for plan in PLANS:
        for share in SHARES:
            cells = [plan[0], str(plan[2]), f"{share:.0%}"]
            for hidden in (OPEN, LEFT_OUT):
                # The same campaigns for each share, so that shares differ by hiding alone.
                random = np.random.default_rng(plan[2])
                accepted = sum(
                    supported(plan, random.random((plan[2], 2)), share, hidden)
                    for _ in range(options.campaigns)
                )
                cells.append(f"{100 * accepted / options.campaigns:.2f}")
            rows.append(cells)
            print(*cells, flush=True)
    head = ["method", "runs at most", "hidden", "counted as open", "left out"]
    print(f"\n{table(head, rows)}")


if __name__ == "__main__":
    main()
