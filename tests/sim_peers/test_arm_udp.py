"""Socket of the simulated arm, over loopback."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from cardan.errors import AddressError
from cardan.protocols.joint_stream.codec import (
    ArmCommand,
    ControlMode,
    decode_state,
    encode_command,
)
from cardan.robots import load_arm
from cardan.sim_peers.arm.options import PlantOptions, SimulatedArmOptions
from cardan.sim_peers.arm.udp import SimulatedArmPeer
from tests.serving import in_a_thread
from tests.waiting import WITHIN_S

pytestmark = pytest.mark.matrix

HELLO = encode_command(ArmCommand(0, 1, 0.0, ControlMode.HOLD), 6)


def options(**changes):
    plant = PlantOptions(drive="ideal")
    return SimulatedArmOptions(**{"robot": "gofa_crb15000_5", "plant": plant, "port": 0, **changes})


def serving(**changes):
    return in_a_thread(SimulatedArmPeer(options(**changes)))


@contextmanager
def client(peer):
    host, port = peer.endpoint.split(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.settimeout(WITHIN_S)
        link.connect((host, int(port)))
        yield link


def test_a_client_is_served_and_another_is_not():
    with serving(period_s=0.004) as peer, client(peer) as link, client(peer) as other:
        link.send(b"nonsense")
        link.send(HELLO)
        states = [decode_state(link.recv(4096)) for _ in range(50)]
        numbers = [state.sequence for state in states]
        assert numbers == list(range(numbers[0], numbers[0] + 50))
        # A cycle is late by less than a period, or left out, but never early, however long this
        # computer stands still.
        assert states[-1].stamp_s - states[0].stamp_s > 48 * 0.004
        other.send(HELLO)
        other.settimeout(0.1)
        with pytest.raises(TimeoutError):
            other.recv(4096)


def test_a_taken_port_is_named():
    peer = SimulatedArmPeer(options())
    peer.open()
    peer.open()
    port = int(peer.endpoint.split(":")[1])
    try:
        with pytest.raises(AddressError, match=f"cannot listen on 127.0.0.1:{port}"):
            SimulatedArmPeer(options(port=port)).open()
    finally:
        peer.close()
        peer.close()
    with pytest.raises(AddressError, match=r"cannot listen on nowhere\.invalid"):
        SimulatedArmPeer(options(host="nowhere.invalid")).open()
    peer.step(time.monotonic() + 0.1)


@pytest.mark.real
def test_the_command_serves_it():
    command = (sys.executable, "-m", "cardan", "sim", "arm")
    arguments = ("--listen", "127.0.0.1:0", "--seconds", "300", "--drive", "ideal")
    surroundings = ("--plane", "0,0,0,0,0,1", "--sphere=-1,0,0,0.1", "--payload", "0.5")
    with subprocess.Popen(
        [*command, *arguments, *surroundings], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            ready, endpoint = process.stdout.readline().split()
            assert ready == "READY"
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
                link.settimeout(WITHIN_S)
                host, port = endpoint.split(":")
                link.sendto(HELLO, (host, int(port)))
                assert decode_state(link.recv(4096)).positions == load_arm("ur5").home
        finally:
            process.terminate()
    assert process.returncode == 0
