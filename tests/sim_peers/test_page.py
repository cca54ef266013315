"""Simulated peer in the documentation page on adding one."""

from __future__ import annotations

import socket
import sys
import time
import types

import pytest

from cardan.errors import ScriptError
from cardan.sim_peers.scripted import play
from tests.test_docs import blocks, text
from tests.waiting import WITHIN_S


@pytest.fixture
def page(monkeypatch):
    """Import the module that the page shows."""
    (code,) = (b for b in blocks(text("adding-a-driver.md"), "python") if "DevicePeer" in b)
    module = types.ModuleType("simulated_joystick")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(code, vars(module))
    return module


def test_its_device_sends_what_its_script_does(page):
    stick = page.SimulatedJoystick(0.25, {})
    motion = page.ScriptedJoystick(page.load_script("demo", page.SCRIPTS, page.VERBS))
    tilts = [int.from_bytes(report, "little", signed=True) for report in play(stick, motion, 3.0)]
    assert tilts == [0, 0, 0, 64, 127, 127, 127, 64, 0, -64, -127, -127, -127]


def test_a_program_opens_it_and_it_is_unplugged(page, tmp_path):
    options = page.JoystickPeerOptions(path=str(tmp_path / "s"), faults={"unplug": 0.05})
    peer = page.JoystickPeer(options)
    peer.open()
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as program:
            program.connect(peer.endpoint)
            end_s = time.monotonic() + WITHIN_S
            while peer.device.plugged:
                assert time.monotonic() < end_s
                peer.step(time.monotonic() + 0.02)
            assert program.recv(10) == b"\0"
        assert not (tmp_path / "s").exists()
    finally:
        peer.close()


def test_nonsense_is_refused(page):
    with pytest.raises(ScriptError, match="there is no fault 'fire'"):
        page.JoystickPeer(page.JoystickPeerOptions(faults={"fire": 1.0}))


def test_its_command_is_declared(page):
    assert page.JoystickCommand.Options is page.JoystickPeerOptions
    assert list(page.JoystickCommand.scripts) == ["demo"]
