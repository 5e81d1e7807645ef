"""Propose points by a peer's own search, in an environment that has the peer and nothing of ours.

Run by ``peers/falsification.py``: it writes a point as a line of JSON, and reads the robustness
there as the next line; an empty line ends it.
"""

from __future__ import annotations

import json
import random
import sys
from collections.abc import Callable, Sequence

Robustness = Callable[[Sequence[float]], float]


def asked(point: Sequence[float]) -> float:
    """Return the robustness at a point, from the other side of the pipe.

    Raises:
        SystemExit: If the search is over; no peer catches that.
    """
    print(json.dumps([float(value) for value in point]), flush=True)
    answer = sys.stdin.readline().strip()
    if not answer:
        raise SystemExit(0)
    return float(answer)


def psy_taliro(size: int, seed: int, budget: int) -> None:
    """Its dual annealing, begun again with another seed where it ends."""
    import staliro
    from staliro.optimizers import DualAnnealing

    @staliro.costfunc
    def cost(inputs: staliro.Inputs) -> float:
        return asked([inputs.static[name] for name in names])

    names = [f"x{number}" for number in range(size)]
    for run in range(budget):
        options = staliro.TestOptions(
            static_inputs=dict.fromkeys(names, (0.0, 1.0)),
            seed=1000 * seed + run + 1,
            iterations=budget,
        )
        staliro.test(cost, DualAnnealing(), options)


def verifai(size: int, seed: int, budget: int) -> None:
    """Its cross-entropy sampler; the falsifier's default is the uniform one, a column of ours."""
    import numpy as np
    from verifai.features import Box, Feature, FeatureSpace
    from verifai.samplers import FeatureSampler

    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - its samplers draw from the global generators
    space = FeatureSpace({"x": Feature(Box(*[(0.0, 1.0)] * size))})
    sampler = FeatureSampler.crossEntropySamplerFor(space)
    feedback = None
    for _ in range(budget):
        sample = sampler.nextSample(feedback)
        feedback = asked([float(value) for value in np.ravel(sample.x)])


PEERS = {"psy-taliro": psy_taliro, "verifai": verifai}


def main() -> None:
    """Propose points until no answer comes."""
    name, size, seed, budget = sys.argv[1], *map(int, sys.argv[2:5])
    PEERS[name](size, seed, budget)


if __name__ == "__main__":
    main()
