"""What exists is left out of later searches for garbage, which are frequent here."""

from __future__ import annotations

import functools
import gc

from hypothesis import given, settings
from hypothesis import strategies as st


@functools.cache
@settings(max_examples=1, database=None)
@given(st.none())
def _draw(_: None) -> None:
    """Let Hypothesis make the generator that it keeps for this thread.

    It looks for what refers to that generator. From Python 3.14 on, it finds nothing among what
    is frozen, and warns.
    """


def freeze() -> None:
    """Search what exists once, and never again."""
    _draw()
    gc.collect()
    gc.freeze()
