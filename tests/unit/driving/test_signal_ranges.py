"""Ranges that the domain declares of its signals: no run leaves them."""

from __future__ import annotations

import numpy as np
import pytest

from pytest_dura.campaign.runner import Runner
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.loop_signals import TRUTH
from pytest_dura.domains import DOMAINS, Signal


@pytest.mark.parametrize("name", ["conflicting-traffic", "sudden/leader-brakes"])
@pytest.mark.parametrize("component", ["rule_based", "aggressive"])
def test_runs_keep_within_them(name, component):
    episode = Runner.of(generator=component).run(f"intersection/{name}")
    known = DOMAINS["driving"].declared_signals
    outside = {
        signal: (float(np.min(column)), float(np.max(column)))
        for signal, column in episode.signals.items()
        if signal in known
        and not (
            known[signal].range[0] <= np.min(column) <= np.max(column) <= known[signal].range[1]
        )
    }
    assert outside == {}
    assert len(episode.signals.keys() & known.keys()) > 20


def test_a_signal_that_is_true_or_false_has_0_to_1():
    assert Signal("open", TRUTH).range == (0.0, 1.0)
    assert Signal("height", "m", least=0.0).range == (0.0, np.inf)


@pytest.mark.parametrize("ends", [(1.0, 1.0), (2.0, 1.0), (np.nan, None)])
def test_a_signal_without_a_value_between_its_ends_is_refused(ends):
    with pytest.raises(ConfigurationError, match="no value between"):
        Signal("height", "m", "", *ends)
