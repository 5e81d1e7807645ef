"""One seed, many independent streams of random numbers, told apart by name.

Adding a role or a fault asks for a new name and so shifts nobody else's draws.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager

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
    made = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *words])))
    for draws in _NOTING:
        draws.note(made)
    return made


class Draws:
    """Notes whether any number was drawn from the streams that were made since it began."""

    def __init__(self) -> None:
        self._streams: list[tuple[np.random.Generator, int]] = []

    def note(self, made: np.random.Generator) -> None:
        """A stream was made."""
        self._streams.append((made, _position(made)))

    @property
    def any(self) -> bool:
        """Whether a number was drawn from one of them."""
        return any(_position(one) != first for one, first in self._streams)


_NOTING: list[Draws] = []
"""A global, since a component may be asked in another thread than the loop's."""


@contextmanager
def noting_draws() -> Iterator[Draws]:
    """Context in which it is noted whether anybody draws from a stream that is made in it."""
    draws = Draws()
    _NOTING.append(draws)
    try:
        yield draws
    finally:
        _NOTING.remove(draws)


def _position(made: np.random.Generator) -> int:
    """Where a stream is: another number after each draw, as far as anybody can tell."""
    return int(made.bit_generator.state["state"]["state"])


def derive_seed(base_seed: int, *names: object) -> int:
    """A seed below 2**53 for one run, from the session's base seed and the run's names.

    Faults are no part of the names that the campaign passes: arms with and without a fault
    share their seeds, which makes them pairs.
    """
    text = "\x1f".join([str(base_seed), *map(str, names)])
    digest = hashlib.sha256(text.encode()).digest()
    return int.from_bytes(digest[:8], "big") >> (64 - SEED_BITS)
