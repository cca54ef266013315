"""A Wii Remote on one virtual Bluetooth controller, hosts on another: real L2CAP channels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from btvirt import connect, controllers
from cardan.types import DeviceLink
from cardan_wiimote.driver import Wiimote, WiimoteOptions
from cardan_wiimote.peer import WiimotePeer, WiimotePeerOptions
from tests.kernel.waiting import wait_for
from tests.serving import in_a_thread

MOVES = """
    0.3  press a
    0.6  tilt 30 0 0 over 0.2
    2.0  level over 0.1
    2.3  release a
    2.6  loop
"""


@pytest.fixture
def addresses(modules: Callable[..., None]) -> Iterator[tuple[str, str]]:
    modules("hci_vhci", "algif_hash", "algif_skcipher")
    with controllers() as pair:
        yield pair


@pytest.fixture
def remote(tmp_path: Path, addresses: tuple[str, str]) -> Callable[..., WiimotePeer]:
    def make(script: str = MOVES) -> WiimotePeer:
        file = tmp_path / "script.txt"
        file.write_text(script)
        return WiimotePeer(WiimotePeerOptions(bluetooth=addresses[0], script=str(file)))

    return make


@pytest.mark.judged(
    device="Wiimote", transport="L2CAP", by="Linux kernel 6.1: Bluetooth; BlueZ btvirt"
)
def test_the_driver_reads_it_over_real_channels(remote, addresses):
    with (
        in_a_thread(remote()),
        Wiimote(WiimoteOptions(transport="l2cap", address=addresses[0])) as wiimote,
    ):
        state = wait_for(
            lambda: (s := wiimote.state()).link is DeviceLink.LIVE and any(s.axes) and s
        )
        assert "a" in state.buttons
        edges = []
        wait_for(lambda: edges.extend(wiimote.button_events()) or len(edges) >= 3)
        assert {edge.button for edge in edges} == {"a"}


@pytest.mark.judged(
    device="Wiimote", transport="L2CAP, powered off", by="Linux kernel 6.1: Bluetooth; BlueZ btvirt"
)
def test_a_remote_that_goes_is_lost_and_is_connected_again_when_it_comes_back(remote, addresses):
    script = """
        0.5  press a
        0.8  tilt 30 0 0 over 0.2
        3.0  power-off
        5.0  power-on
        6.0  release a
        7.0  press a
        9.0  release a
        10.0 press a
        12.0 release a
        13.0 press a
    """
    with (
        in_a_thread(remote(script)),
        Wiimote(WiimoteOptions(transport="l2cap", address=addresses[0])) as wiimote,
    ):
        wait_for(lambda: any(wiimote.state().axes))
        lost = wait_for(lambda: (s := wiimote.state()).link is DeviceLink.LOST and s)
        assert not any(lost.axes)
        assert not lost.buttons
        wait_for(lambda: any(wiimote.state().axes))


@pytest.mark.judged(
    device="Wiimote", transport="L2CAP", by="Linux kernel 6.1: L2CAP channels, a plain client"
)
def test_a_plain_client_gets_the_status_it_asks_for(remote, addresses):
    with (
        in_a_thread(remote("")),
        connect(addresses[0], 0x11),
        connect(addresses[0], 0x13) as interrupt,
    ):
        interrupt.settimeout(5.0)
        interrupt.send(bytes.fromhex("a2 15 00"))
        packets = [interrupt.recv(64) for _ in range(2)]
        status = next(packet for packet in packets if packet[1] == 0x20)
        assert (status[0], len(status)) == (0xA1, 8)
