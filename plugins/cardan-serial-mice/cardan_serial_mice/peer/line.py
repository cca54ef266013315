"""Faults of a simulated serial device, and the line that carries its bytes."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.sim_peers.base import FaultSwitch, check_faults
from cardan.sim_peers.delay_line import DelayLine
from cardan_serial_mice.protocol import SerialModel

SERIAL_FAULTS = (
    FaultSwitch("unplug", "the port vanishes at VALUE s, whatever the device is doing", 3.0),
    FaultSwitch("replug", "the port that vanished is back at VALUE s", 4.0, after="unplug"),
    FaultSwitch("power-loss", "at VALUE s the device restarts, with its port open", 3.0),
    FaultSwitch("silence", "nothing more comes after the first deflection past VALUE s", 3.0),
    FaultSwitch("mute", "never sends anything: a dead line, or the wrong baud rate"),
    FaultSwitch("deaf", "ignores everything that the host sends"),
    FaultSwitch("refuse", "there is no port for the first VALUE s", 2.0),
    FaultSwitch("slow-answer", "answers to commands come VALUE ms later", 300.0),
    FaultSwitch("parity-error", "one bit of every VALUE-th motion packet is wrong", 10.0, 1.0),
    FaultSwitch("half-packet", "every VALUE-th motion packet ends halfway", 10.0, 1.0),
    FaultSwitch("garbage", "noise before every VALUE-th motion packet", 10.0, 1.0),
    FaultSwitch("key-lost", "every VALUE-th key packet is lost", 2.0, 1.0),
    FaultSwitch("key-parity", "one bit of every VALUE-th key packet is wrong", 2.0, 1.0),
    FaultSwitch("key-half", "every VALUE-th key packet ends halfway", 2.0, 1.0),
    FaultSwitch("key-garbage", "noise before every VALUE-th key packet", 2.0, 1.0),
    FaultSwitch("missing-zero", "the zero packet after every VALUE-th motion is lost", 1.0, 1.0),
    FaultSwitch(
        "burst", "for VALUE s in every 2·VALUE s nothing, then all of it at once", 0.5, 0.001
    ),
    FaultSwitch(
        "drift", "every axis rests VALUE counts off zero: never any silence", 20.0, -350.0, 350.0
    ),
    FaultSwitch("overrange", "full deflection gives VALUE times the usual counts", 1.2, 0.01, 4.0),
    FaultSwitch("stuck-button", "the lowest button, once down, stays down"),
)

_SHORTEST_KEYS = 4
"""Bytes of the shortest packet of keys, with its CR. Some devices send two in a row."""

FIFO_BYTES = 14
"""A UART delivers received bytes in portions of this size, and the rest at a pause."""


class SerialLine(DelayLine):
    """Wire from the device to the host: bytes take time, and some of them are corrupted."""

    def __init__(self, faults: Mapping[str, float], model: SerialModel, seed: int) -> None:
        check_faults(faults, SERIAL_FAULTS)
        super().__init__(faults, seed)
        stop_bits = 2 if model.protocol == "magellan" else 1
        self._byte_s = (9 + stop_bits) / 9600
        self._motions = 0
        self._keys = 0
        self._rests = 0
        self.free_s = 0.0
        """Time at which all accepted bytes have been sent; no motion begins before."""

    def carry_motion(self, packet: bytes, sent_s: float, *, rest: bool) -> None:
        """Carry a motion packet; `rest`: the cap is back at rest."""
        self._motions += 1
        if rest:
            self._rests += 1
            if self._strikes("missing-zero", self._rests):
                return
        if self._strikes("garbage", self._motions):
            packet = self._noise() + packet
        if self._strikes("half-packet", self._motions):
            packet = packet[: len(packet) // 2]
        elif self._strikes("parity-error", self._motions):
            packet = self._with_a_wrong_bit(packet, len(packet))
        self.carry(packet, sent_s)

    def carry_keys(self, packet: bytes, sent_s: float) -> None:
        """Carry a packet of the device's keys, spontaneous or requested."""
        self._keys += 1
        if self._strikes("key-lost", self._keys):
            return
        if self._strikes("key-garbage", self._keys):
            packet = self._noise() + packet
        if self._strikes("key-half", self._keys):
            packet = packet[: len(packet) // 2]
        elif self._strikes("key-parity", self._keys):
            packet = self._with_a_wrong_bit(packet, min(len(packet), _SHORTEST_KEYS))
        self.carry(packet, sent_s)

    def carry(self, packet: bytes, sent_s: float) -> None:
        """Carry any packet, ready at `sent_s`; it is sent when the line is free."""
        start_s = max(sent_s, self.free_s)
        for begin in range(0, len(packet), FIFO_BYTES):
            portion = packet[begin : begin + FIFO_BYTES]
            super().carry(portion, start_s + (begin + len(portion)) * self._byte_s)
        self.free_s = start_s + len(packet) * self._byte_s

    def cut_at(self, now_s: float) -> None:
        """Drop everything under way; the line is free again at `now_s`."""
        self.cut()
        self.free_s = now_s

    def _noise(self) -> bytes:
        return self._random.randbytes(self._random.randint(1, 12))

    def _with_a_wrong_bit(self, packet: bytes, size: int) -> bytes:
        """Return `packet` with one wrong bit among its first `size` bytes, but their first and
        last."""
        at = self._random.randrange(1, size - 1)
        wrong = packet[at] ^ 1 << self._random.randrange(7)
        return packet[:at] + bytes((wrong,)) + packet[at + 1 :]
