"""One seed, many independent streams of random numbers, told apart by name.

Adding a role or a fault asks for a new name and so shifts nobody else's draws.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from pytest_dura.core.errors import ConfigurationError

_SEED_BITS = 53
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
    watch_draws(made, made)
    return made


def watch_draws(used: np.random.Generator, fresh: np.random.Generator) -> None:
    """Note whether anybody draws from a generator, where an episode runs.

    For a simulator that brings its own generator: what draws declares that its runs may differ.

    Args:
        used: What is drawn from.
        fresh: One of the same seed from which nothing has been drawn.
    """
    for draws in _RECORDS:
        draws.note(used, fresh)


class DrawRecord:
    """Notes whether any number was drawn from the streams that were made since it began."""

    def __init__(self) -> None:
        self._streams: list[tuple[np.random.Generator, str]] = []

    def note(self, used: np.random.Generator, fresh: np.random.Generator) -> None:
        """See :func:`watch_draws`."""
        self._streams.append((used, _position(fresh)))

    @property
    def any(self) -> bool:
        """Whether a number was drawn from one of them."""
        return any(_position(item) != first for item, first in self._streams)


_RECORDS: list[DrawRecord] = []
"""A global, since a component may be asked in another thread than the loop's."""


@contextmanager
def recording_draws() -> Iterator[DrawRecord]:
    """Context in which it is noted whether anybody draws from a stream that is made in it."""
    draws = DrawRecord()
    _RECORDS.append(draws)
    try:
        yield draws
    finally:
        _RECORDS.remove(draws)


def _position(generator: np.random.Generator) -> str:
    """Where a generator is: another text after each draw."""
    return str(generator.bit_generator.state)


def derive_seed(base_seed: int, *names: object) -> int:
    """A seed below 2**53 for one run, from the session's base seed and the run's names.

    Faults are no part of the names that the campaign passes: arms with and without a fault
    share their seeds, which makes them pairs.
    """
    text = "\x1f".join([str(base_seed), *map(str, names)])
    digest = hashlib.sha256(text.encode()).digest()
    return int.from_bytes(digest[:8], "big") >> (64 - _SEED_BITS)
