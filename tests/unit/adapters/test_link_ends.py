"""A component and a simulator at the other end of each wire: the same episode as in one process."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import pytest
from free_ports import free_port
from link_suite import compile_peer, copy_suite

from pytest_dura import (
    ConfigurationError,
    EpisodeSpec,
    Orchestrator,
    RoleSpec,
    Termination,
    check_simulator,
)
from pytest_dura.adapters.link.bindings import Binding
from pytest_dura.adapters.link.conversation import Link, close_links
from pytest_dura.adapters.link.generator import DeviceGenerator, LinkGenerator
from pytest_dura.adapters.link.serve import _Target, serve
from pytest_dura.adapters.link.simulator import DeviceSimulator, LinkSimulator
from pytest_dura.adapters.link.transports import open_transport

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="wires are waited for by select")
BINDING = {"binding": "tank.link.yaml", "timeout": 30.0}
SERVED = "pipe:serve tank:{} --binding tank.link.yaml --idle 60"
SPEC = EpisodeSpec(
    case="tank/filling",
    run=0,
    seed=0,
    simulator=RoleSpec("tank:Tank"),
    roles={"generator": RoleSpec("tank:Fill")},
    scenario={"name": "a", "world": {"drain": 0.3}},
    termination=Termination(time_limit=3.0),
    time_budget=60.0,
)


@pytest.fixture
def tank(tmp_path, monkeypatch):
    monkeypatch.chdir(copy_suite(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "tank", raising=False)
    yield tmp_path
    close_links()
    sys.modules.pop("tank", None)


def generator(transport, kind=DeviceGenerator):
    return RoleSpec.of(kind, {"transport": transport, **BINDING})


def levels(spec):
    episode = Orchestrator.build(spec).run(spec)
    assert (episode.validity, episode.events) == ("valid", ())
    return episode.signal("level").tolist()


def driven_by(transport, kind=DeviceGenerator):
    return levels(replace(SPEC, roles={"generator": generator(transport, kind)}))


@contextmanager
def served(address, target="tank:Fill"):
    """A thread with the other end, which stops at the end of the conversation."""
    wire = Link(open_transport(address, peer=True))
    answer = _Target(RoleSpec(target), Binding.read("tank.link.yaml")).answer
    thread = threading.Thread(target=serve, args=(wire, answer, 60.0))
    thread.start()
    try:
        yield
    finally:
        close_links()
        thread.join(10.0)
        wire.transport.close()
        assert not thread.is_alive()


def test_component_and_simulator_in_programs_give_the_episode_of_one_process(tank) -> None:
    expected = levels(SPEC)
    assert driven_by(SERVED.format("Fill"), LinkGenerator) == expected
    world = RoleSpec.of(LinkSimulator, {"transport": SERVED.format("Tank"), **BINDING})
    assert levels(replace(SPEC, simulator=world)) == expected


@pytest.mark.parametrize("address", ["udp:127.0.0.1:{}", "tcp:127.0.0.1:{}"])
def test_over_a_socket_too(tank, address) -> None:
    address = address.format(free_port())
    with served(address):
        assert driven_by(address) == levels(SPEC)
        assert driven_by(address) == levels(SPEC)


def test_over_a_can_bus_too(tank) -> None:
    pytest.importorskip("can")
    with served("can:virtual/tank"):
        assert driven_by("can:virtual/tank") == levels(SPEC)


def test_the_controller_in_c_over_a_serial_line_and_over_udp(tank) -> None:
    pytest.importorskip("serial")
    program, expected = compile_peer(tank), levels(SPEC)
    ours, theirs = raw_terminal()
    port = free_port()
    try:
        for wire, address in ((os.ttyname(theirs), ours), (str(port), f"udp:127.0.0.1:{port}")):
            peer = subprocess.Popen([program, wire])
            try:
                wait_until_bound(port if wire == str(port) else None)
                with bridged(address) as transport:
                    assert driven_by(transport) == expected
                close_links()
                assert peer.wait(10.0) == 0
            finally:
                peer.kill()
                peer.wait()
    finally:
        os.close(ours)
        os.close(theirs)


def raw_terminal():
    """A pseudo-terminal that changes and echoes no byte, also before the other end opens it."""
    import tty

    ours, theirs = os.openpty()
    tty.setraw(theirs)
    return ours, theirs


def wait_until_bound(port):
    until = time.monotonic() + 20.0
    while port is not None and time.monotonic() < until:
        with socket.socket(type=socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                return
        time.sleep(0.05)


@contextmanager
def bridged(end):
    """A second pseudo-terminal before the first one, since a line has two ends."""
    if isinstance(end, str):
        yield end
        return
    ours, theirs = raw_terminal()
    stop = threading.Event()
    pump = threading.Thread(target=pass_on, args=(ours, end, stop))
    pump.start()
    try:
        yield f"serial:{os.ttyname(theirs)}"
    finally:
        close_links()
        stop.set()
        pump.join(60.0)
        os.close(ours)
        os.close(theirs)


def pass_on(one, other, stop):
    import select

    while True:
        ready = select.select([one, other], [], [], 0.1)[0]
        if not ready and stop.is_set():  # what was sent before the end has been passed on
            return
        for end in ready:
            os.write(other if end == one else one, os.read(end, 4096))


def test_the_simulator_keeps_its_contract(tank) -> None:
    from tank import Pump

    world = RoleSpec.of(LinkSimulator, {"transport": SERVED.format("Tank"), **BINDING})
    scenario = {"name": "a", "duration": 1.0, "world": {"drain": 0.3}}
    check_simulator(world, scenario, [Pump(0.5)] * 10)


def test_what_exists_once_says_so(tank) -> None:
    for kind in (LinkGenerator, LinkSimulator):
        with pytest.raises(ConfigurationError, match="take Device"):
            kind("udp:127.0.0.1:5000", "tank.link.yaml")
    assert DeviceGenerator.instances == DeviceSimulator.instances == "one"


@pytest.mark.parametrize(
    "before, after, words",
    [
        ("gauge.level", "gauge.levle", "'tank' has no 'gauge.levle'"),
        ("unit: m3/s", "unit: l/s", "is in m3/s in the domain 'tank', and in l/s on the wire"),
        ("unit: m3/s", "unit: m3/s, scale: 0", "the scale of 'inflow' is 0"),
        ("unit: m3/s", "unti: m3/s", "unti"),
    ],
)
def test_a_wrong_binding_is_refused(tank, before, after, words) -> None:
    file = tank / "tank.link.yaml"
    file.write_text(file.read_text().replace(before, after))
    with pytest.raises(ConfigurationError, match=words.replace("(", "[(]")):
        Binding.read("tank.link.yaml")


def test_a_number_in_another_unit_is_converted(tank) -> None:
    from tank import Pump

    file = tank / "tank.link.yaml"
    file.write_text(file.read_text().replace("unit: m3/s", "unit: l/s, scale: 1000, type: f32"))
    binding = Binding.read("tank.link.yaml")
    wire = binding.pack("command", Pump(0.5))
    assert wire == b"\x00\x00\xfaC"  # 500 as a float
    assert binding.action_of(binding.unpack("command", wire)[0]) == Pump(0.5)
