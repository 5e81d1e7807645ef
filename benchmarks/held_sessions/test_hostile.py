"""Markers and messages that may do harm to a reader."""

from __future__ import annotations

import pytest
from hostile import SECRET, TEXT


@pytest.mark.dura(scenario="corridor/hostile", runs=1)
@pytest.mark.requirement("javascript:alert(1)//" + TEXT, text=TEXT * 20, source=TEXT)
def test_each(episode):
    assert not episode.collided, f"{TEXT} {SECRET}"


@pytest.mark.xfail(reason=TEXT)
@pytest.mark.dura(scenario="corridor/hostile", runs=1)
@pytest.mark.requirement("X" + TEXT, text=TEXT)
def test_excused(episode):
    raise KeyError(TEXT)


@pytest.mark.skip(reason=TEXT)
@pytest.mark.dura(scenario="corridor/hostile", runs=1)
@pytest.mark.requirement("T" + TEXT, text="x")
def test_left_out(episode):
    pass
