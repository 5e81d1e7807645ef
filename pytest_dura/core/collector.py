"""Python's search for cycles among objects: how often it is made, and what it looks at."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

MAX_YOUNG_OBJECTS = 10_000
"""New objects after which Python looks for cycles among them while an episode runs."""


MAX_KEPT_OBJECTS = 500_000
"""The same until tests are collected, since all of that stays until the session ends."""


@contextmanager
def rare_collections(most: int = MAX_YOUNG_OBJECTS) -> Iterator[None]:
    """Context in which Python looks for cycles after more new objects than the usual 700.

    All that a tick leaves is kept until the episode ends, and all that is collected until the
    session does, so that looking through it again and again frees nothing: that took a tenth of a
    session. Where the collector is off, or looks no more often, nothing changes; and what others
    set meanwhile stays.

    Args:
        most: New objects after which it looks.
    """
    before = gc.get_threshold()
    if not 0 < before[0] < most:  # 0 is for never
        yield
        return
    own = (most, *before[1:])
    gc.set_threshold(*own)
    try:
        yield
    finally:
        if gc.get_threshold() == own:
            gc.set_threshold(*before)


def set_aside() -> bool:
    """Exempt all objects that there are from searches for cycles, until ``gc.unfreeze()``.

    Returns:
        Whether it did: where objects are exempt already, the caller that exempted them
        releases them.
    """
    if gc.get_freeze_count():
        return False
    gc.freeze()
    return True


def make_old() -> None:
    """Move all objects that there are to the oldest generation, without a look at them.

    What is there stays, so that Python need not find that out by looking through it.
    """
    if set_aside():
        gc.unfreeze()
