"""A component at the other end of DDS topics, in another process."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace

import pytest
from dds_network import DOMAIN, LOOPBACK
from link_suite import copy_suite

from pytest_dura import ConfigurationError, EpisodeSpec, Orchestrator, RoleSpec, Termination
from pytest_dura.adapters.link.conversation import close_links
from pytest_dura.adapters.link.generator import DeviceGenerator
from pytest_dura.adapters.link.transports import LinkLostError, open_transport
from pytest_dura.requirements.episode_verdicts import JudgedEpisode

pytest.importorskip("cyclonedds", reason="the extra dds is not installed")
ADDRESS = f"dds:{DOMAIN}/tank"
SPEC = EpisodeSpec(
    case="tank/filling",
    run=0,
    seed=0,
    simulator=RoleSpec("tank:Tank"),
    roles={"generator": RoleSpec("tank:Fill")},
    scenario={"name": "a", "world": {"drain": 0.3}},
    termination=Termination(time_limit=2.0),
    time_budget=60.0,
)


@pytest.fixture
def tank(tmp_path, monkeypatch):
    monkeypatch.chdir(copy_suite(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    monkeypatch.delitem(sys.modules, "tank", raising=False)
    yield tmp_path
    close_links()
    sys.modules.pop("tank", None)


@contextmanager
def served():
    command = [sys.executable, "-m", "pytest_dura", "serve", "tank:Fill", "--transport", ADDRESS]
    command += ["--binding", "tank.link.yaml", "--idle", "60"]
    peer = subprocess.Popen(command)
    try:
        yield peer
    finally:
        peer.kill()
        peer.wait()


def episode_of(drain, role=None):
    roles = SPEC.roles if role is None else {"generator": role}
    spec = replace(SPEC, scenario={"name": "a", "world": {"drain": drain}}, roles=roles)
    return Orchestrator.build(spec).run(spec)


def test_ten_episodes_in_step_are_judged_as_those_of_one_process(tank) -> None:
    device = RoleSpec.of(
        DeviceGenerator, {"transport": ADDRESS, "binding": "tank.link.yaml", "timeout": 30.0}
    )
    with served() as peer:
        margins = []
        for drain in [0.1 * index for index in range(10)]:
            here, there = episode_of(drain), episode_of(drain, device)
            assert (there.validity, there.events) == ("valid", ())
            assert there.signal("level").tolist() == here.signal("level").tolist()
            margins.append(JudgedEpisode.of(there).robustness("always (level < 1.8)"))
            assert margins[-1] == JudgedEpisode.of(here).robustness("always (level < 1.8)")
        assert min(margins) < 0.0 < max(margins)
        close_links()
        assert peer.wait(30.0) == 0


def test_an_end_that_has_gone_is_a_lost_link(tank) -> None:
    with served() as peer:
        transport = open_transport(ADDRESS)
        try:
            transport.send(b"nothing that is a frame")
            assert transport.receive(0.05) == b""
            peer.terminate()
            with pytest.raises(LinkLostError, match="the other end has gone"):
                transport.receive(40.0)
        finally:
            transport.close()


@pytest.mark.parametrize("address", ["dds:tank", "dds:0/a b", "dds:300/tank", "dds:x/tank"])
def test_a_wrong_address_is_refused(address) -> None:
    with pytest.raises(ConfigurationError, match="dds:DOMAIN/NAME"):
        open_transport(address)


def test_nothing_at_the_other_end_is_a_lost_link(tank, monkeypatch) -> None:
    monkeypatch.setattr("pytest_dura.adapters.link.transports.dds._CONNECTING", 0.2)
    with pytest.raises(LinkLostError, match="nothing reads or writes at the other end of dds:"):
        open_transport(f"dds:{DOMAIN}/{'empty' + str(os.getpid())}")
