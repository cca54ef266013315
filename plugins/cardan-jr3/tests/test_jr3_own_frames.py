"""A bus that returns a node's own frames, like python-can's udp_multicast."""

import time
from collections import deque

import pytest

from cardan_jr3.driver import Jr3, Jr3Options, bus
from cardan_jr3.peer import SimulatedJr3
from cardan_jr3.protocol import Opcode
from jr3_bench import NODE_ID, SCALES

can = pytest.importorskip("can", reason='python-can is not installed: pip install "cardan[can]"')
pytest.importorskip("msgpack", reason='msgpack is not installed: pip install "cardan[can]"')
packing = pytest.importorskip("can.interfaces.udp_multicast.utils")

BOARDS = {Opcode.ACK, Opcode.FORCES, Opcode.MOMENTS, Opcode.BOOTUP}


class Echoing(can.BusABC):
    """A multicast group with a board in it; datagrams are packed like python-can's."""

    def __init__(self, channel, can_filters, **_):
        super().__init__(channel=channel, can_filters=can_filters)
        self.board = SimulatedJr3(NODE_ID, SCALES, boot_s=0.0)
        self.began_s = time.monotonic()
        self.datagrams = deque()
        self.others = []
        """Frames of nodes other than the driver."""

    def send(self, msg, timeout=None):
        self._send(msg)
        self.board.receive(msg.arbitration_id, bytes(msg.data), time.monotonic() - self.began_s)

    def _recv_internal(self, timeout):
        for frame in self.board.reports(time.monotonic() - self.began_s):
            self.other(*frame)
        if not self.datagrams:
            time.sleep(min(timeout, 0.005))
            return None, False
        replaced = {"timestamp": 0.0}
        return packing.unpack_message(self.datagrams.popleft(), replace=replaced, check=True), False

    def other(self, arbitration_id, data):
        self.others.append((data, False, f"can 0x{arbitration_id:03x}"))
        self._send(can.Message(arbitration_id=arbitration_id, data=data, is_extended_id=False))

    def _send(self, message):
        self.datagrams.append(packing.pack_message(message))


def test_what_the_driver_sends_is_not_taken_for_what_the_board_says(monkeypatch):
    monkeypatch.setattr(can, "Bus", lambda interface, ignore_config, **extra: Echoing(**extra))
    options = Jr3Options(interface="udp_multicast", channel="239.74.163.2", period_s=0.005)
    device, opened = Jr3(options), bus.open_bus(options)
    recorded = []
    device.raw_packet_callback = lambda *packet: recorded.append(packet)
    device._core.on_opened(time.monotonic())
    sim = opened._bus
    end_s = time.monotonic() + 10.0
    while sum(sent for _, sent, _ in recorded) < 4 or len(sim.others) < 100:
        assert time.monotonic() < end_s
        device._turn(opened)
    # Another program asks the board for its state, with exactly the same bytes.
    sim.other(Opcode.GET_STATE + NODE_ID, b"")
    while sim.datagrams:
        device._turn(opened)
    received = [packet for packet in recorded if not packet[1]]
    assert received == sim.others[: len(received)]
    assert len(received) >= 101
    opcodes = [int(name.removeprefix("can "), 16) - NODE_ID for _, _, name in received]
    assert {*opcodes} - BOARDS == {Opcode.GET_STATE}
    assert opcodes.count(Opcode.GET_STATE) == 1
    assert device.metrics()["foreign_frames"] == 0


def test_a_frame_that_the_interface_says_is_its_own():
    class Own:
        def __init__(self):
            self.messages = [
                can.Message(arbitration_id=0x421, is_extended_id=False, is_rx=False),
                can.Message(arbitration_id=0x121, data=b"\0", is_extended_id=False),
            ]

        def recv(self, timeout):
            return self.messages.pop(0) if self.messages else None

    one = bus.CanBus(Own())
    assert one.receive(0.0) == (0x121, b"\0")
    assert one.receive(0.0) is None
