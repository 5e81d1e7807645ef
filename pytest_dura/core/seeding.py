"""Streams of random numbers: many independent ones from one seed, each with a name.

A role or a fault that is added draws from a stream of a new name, so that no other draw changes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from pytest_dura.core.errors import ConfigurationError

_SEED_BITS = 53
"""Seeds stay exact in JSON readers that store numbers as doubles."""


def stream(seed: int, name: str) -> np.random.Generator:
    """Make the stream ``name`` of ``seed``: the same numbers on every call, in every process.

    Raises:
        ConfigurationError: For a seed below 0.
    """
    if seed < 0:
        raise ConfigurationError(
            "a seed is a whole number of at least 0", key="seed", found=seed, expected="0 or more"
        )
    key = np.frombuffer(hashlib.sha256(name.encode()).digest(), dtype="<u4").tolist()
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *key])))
    watch_draws(generator, generator)
    return generator


def watch_draws(used: np.random.Generator, fresh: np.random.Generator) -> None:
    """Let the episode that runs record whether numbers are drawn from a generator.

    A simulator with a generator of its own calls this: episodes that draw may differ by their seed.

    Args:
        used: The generator that is drawn from.
        fresh: One of the same seed from which nothing has been drawn.
    """
    known = list(_open_records)
    own = [record for record in _own_records.get() if record in known]
    for record in own or known:
        record.note(used, fresh)


class DrawRecord:
    """Record of whether any number was drawn from the streams that were made in its context."""

    def __init__(self) -> None:
        self._streams: list[tuple[np.random.Generator, str]] = []

    def note(self, used: np.random.Generator, fresh: np.random.Generator) -> None:
        """Add a generator, see :func:`watch_draws`."""
        self._streams.append((used, _position(fresh)))

    @property
    def any(self) -> bool:
        """Whether a number was drawn from one of them."""
        return any(_position(generator) != first for generator, first in self._streams)


_own_records: ContextVar[tuple[DrawRecord, ...]] = ContextVar("dura_draw_records", default=())
_open_records: list[DrawRecord] = []
"""Records of all contexts that are open in the process. A thread that a component starts of its own
has an empty context, or that of an earlier episode, and its draws count for each of them."""


@contextmanager
def recording_draws() -> Iterator[DrawRecord]:
    """Context with the record of the draws from all streams that are made in it, in any thread."""
    record = DrawRecord()
    _open_records.append(record)
    token = _own_records.set((*_own_records.get(), record))
    try:
        yield record
    finally:
        _own_records.reset(token)
        _open_records.remove(record)


def _position(generator: np.random.Generator) -> str:
    """State of a generator, which is another text after each draw."""
    return str(generator.bit_generator.state)


def derive_seed(base_seed: int, *names: object) -> int:
    """Derive a seed below 2**53 for one run from the session's base seed and the run's names.

    The names that a campaign passes leave out the faults: arms with and without a fault share
    their seeds, which makes them pairs.
    """
    text = "\x1f".join([str(base_seed), *map(str, names)])
    digest = hashlib.sha256(text.encode()).digest()
    return int.from_bytes(digest[:8], "big") >> (64 - _SEED_BITS)
