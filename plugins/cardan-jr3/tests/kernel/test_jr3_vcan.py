"""The JR3 sensor and its driver on a virtual CAN bus of the kernel."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator

import can
import pytest

from cardan.errors import CommandError
from cardan.types import DeviceLink
from cardan_jr3.driver import Jr3, Jr3Options
from cardan_jr3.peer import Jr3Peer, Jr3PeerOptions
from tests.kernel.waiting import in_a_process, wait_for
from tests.serving import in_a_thread

BUS = "vcan0"


def ip(*words: str) -> None:
    subprocess.run(["ip", "link", *words], check=True, timeout=30)


@pytest.fixture
def bus() -> Iterator[str]:
    ip("add", "dev", BUS, "type", "vcan")
    try:
        ip("set", BUS, "up")
        yield BUS
    finally:
        ip("delete", BUS)


def board(bus: str, script: str) -> Jr3Peer:
    return Jr3Peer(Jr3PeerOptions(interface="socketcan", channel=bus, script=script, boot_s=0.2))


@pytest.mark.judged(device="JR3", transport="SocketCAN", by="Linux kernel 6.1: vcan; python-can")
@pytest.mark.parametrize("mode", ["async", "sync"])
def test_a_push_becomes_a_wrench_and_a_deflection(bus, mode):
    with in_a_thread(board(bus, "push")):
        options = Jr3Options(
            interface="socketcan", channel=bus, mode=mode, node_id=33, wait_for_device=True
        )
        with Jr3(options) as jr3:
            state = wait_for(lambda: (s := jr3.state()).axes[0] > 0.4 and s)
            assert state.link is DeviceLink.LIVE
            assert state.wrench is not None
            assert state.wrench.force.x == pytest.approx(6.0, abs=1.5)
            wait_for(lambda: not any(jr3.state().axes))


@pytest.mark.judged(
    device="JR3", transport="SocketCAN, bus down", by="Linux kernel 6.1: vcan; python-can"
)
def test_a_bus_that_goes_down_is_a_lost_sensor_and_it_comes_back(bus):
    options = Jr3Options(interface="socketcan", channel=bus, node_id=33, wait_for_device=True)
    with Jr3(options) as jr3:
        # The peer itself ends when its bus goes down.
        with in_a_process(board(bus, "rest")):
            wait_for(lambda: jr3.state().link is DeviceLink.LIVE)
            ip("set", bus, "down")
            lost = wait_for(lambda: (s := jr3.state()).link is not DeviceLink.LIVE and s)
            assert not any(lost.axes)
            assert lost.reason
        ip("set", bus, "up")
        with in_a_process(board(bus, "rest")):
            # The new board cannot be recognized as the one whose zero was taken.
            wait_for(lambda: live_or_zeroed(jr3))


def live_or_zeroed(jr3: Jr3) -> bool:
    """Return True if the sensor is live; take zero if it was lost."""
    if "zero is lost" in jr3.state().reason:
        with contextlib.suppress(CommandError):
            jr3.zero()
    return jr3.state().link is DeviceLink.LIVE


@pytest.mark.judged(
    device="JR3", transport="SocketCAN", by="Linux kernel 6.1: another program on the bus"
)
def test_what_others_send_on_the_bus_changes_nothing(bus):
    with in_a_thread(board(bus, "rest")), can.Bus(interface="socketcan", channel=bus) as other:
        options = Jr3Options(interface="socketcan", channel=bus, node_id=33, wait_for_device=True)
        with Jr3(options) as jr3:
            wait_for(lambda: jr3.state().link is DeviceLink.LIVE)
            for identifier in range(0x100, 0x110):
                other.send(can.Message(arbitration_id=identifier, data=b"\xff" * 8))
                other.send(
                    can.Message(arbitration_id=identifier, is_extended_id=True, data=b"junk")
                )
            seen = jr3.state().stamp_s
            state = wait_for(lambda: (s := jr3.state()).stamp_s > seen + 0.2 and s)
            assert state.link is DeviceLink.LIVE
            assert not any(state.axes)
