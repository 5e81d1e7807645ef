"""One seed, many independent streams of random numbers, told apart by name.

Adding a role or a fault asks for a new name and so shifts nobody else's draws.
"""

from __future__ import annotations

import hashlib

import numpy as np

from pytest_dura.core.errors import ConfigurationError

SEED_BITS = 53
"""Seeds stay exact in JSON readers that store numbers as doubles."""


def stream(seed: int, name: str) -> np.random.Generator:
    """The stream ``name`` of ``seed``: the same numbers on every call and in every process.

    Raises:
        ConfigurationError: For a seed below 0.
    """
    if seed < 0:
        raise ConfigurationError(
            "a seed is a whole number of at least 0", key="seed", found=seed, expected="0 or more"
        )
    words = np.frombuffer(hashlib.sha256(name.encode()).digest(), dtype="<u4").tolist()
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *words])))


def derive_seed(base_seed: int, *names: object) -> int:
    """A seed below 2**53 for one run, from the session's base seed and the run's names.

    Faults are no part of the names that the campaign passes: arms with and without a fault
    share their seeds, which makes them pairs.
    """
    text = "\x1f".join([str(base_seed), *map(str, names)])
    digest = hashlib.sha256(text.encode()).digest()
    return int.from_bytes(digest[:8], "big") >> (64 - SEED_BITS)
