"""Requirements on the component on other roads than the built-in scenarios' one."""

from __future__ import annotations

import pytest

from pytest_dura import JudgedEpisode


@pytest.mark.dura(scenario="roads/*", runs=3)
@pytest.mark.requirement("ROAD-1", text="Crosses without contact", kind="safety")
def test_crosses_without_contact(episode: JudgedEpisode) -> None:
    """One test case for each road and run."""
    assert not episode.collided
    assert episode.ever("cleared")


@pytest.mark.dura(scenario=["roads/t-junction", "roads/merge"], runs=3)
@pytest.mark.requirement("ROAD-2", text="Makes nobody with priority brake hard", kind="safety")
def test_gives_way(episode: JudgedEpisode) -> None:
    """The right of way is the road's own: on the merge, that of who is on the major road."""
    assert episode.robustness("always (priority_braking <= 3)") >= 0
