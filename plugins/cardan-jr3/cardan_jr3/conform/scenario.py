"""Scenario: queries a JR3 board's properties, then takes samples by its own clock, then by SYNC."""

from __future__ import annotations

from collections.abc import Iterator

from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Scenario, Script, Step, ask, mark, open_, send
from cardan.conform.timeline import Kind, WireEvent
from cardan_jr3.conform.frames import pack, unpack
from cardan_jr3.protocol import (
    NODE_MASK,
    Ack,
    Bootup,
    GetFsForces,
    GetFsMoments,
    GetState,
    HostMessage,
    SetFilter,
    StartAsync,
    StartSync,
    Stop,
    Sync,
    ZeroOffs,
    decode_from_board,
    encode_from_host,
)

ACK_S = 0.5
BOOT_S = 3.0
PERIOD_US = 5000
CUTOFF_CENTIHZ = 2000
SYNCS = 20
SYNC_S = 0.01
HAND_S = 30.0


class Jr3Scenario(Scenario):
    """Host on the bus, with one request open at a time."""

    def __init__(self, level: Level, seconds: float, node_id: int) -> None:
        self._level = level
        self._seconds = seconds
        self._node_id = node_id
        self._acked = self._booted = False

    def answer(self, event: WireEvent) -> Iterator[Step]:
        frame = unpack(event.data) if event.kind is Kind.DATA else None
        if frame is not None and frame.arbitration_id & NODE_MASK == self._node_id:
            value = decode_from_board(*frame)
            self._acked = self._acked or isinstance(value, Ack)
            self._booted = self._booted or isinstance(value, Bootup)
        return iter(())

    def _say(self, message: HostMessage) -> Step:
        return send(pack(encode_from_host(message, self._node_id)))

    def _send_message(self, message: HostMessage) -> Script:
        self._acked = False
        yield self._say(message)
        yield Pause(ACK_S, lambda: self._acked)
        yield Pause(0.005)

    def script(self) -> Script:
        yield open_("")
        yield mark("listen")
        yield ask("rest", "Switch the board's power off and on, and leave the sensor alone.")
        yield Pause(max(BOOT_S, self._seconds), lambda: self._booted)
        yield Pause(0.1)
        if self._level < Level.HOLD:
            return
        yield mark("ask")
        for question in (GetState(), GetFsForces(), GetFsMoments()):
            yield from self._send_message(question)
        yield mark("start")
        yield from self._send_message(StartAsync(CUTOFF_CENTIHZ, PERIOD_US))
        yield Pause(0.1)
        yield from self._send_message(ZeroOffs())
        yield from self._send_message(SetFilter(CUTOFF_CENTIHZ))
        yield Pause(0.2)
        yield mark("run")
        yield Pause(self._seconds)
        yield mark("stop")
        yield from self._send_message(Stop())
        yield Pause(0.05)
        yield mark("stopped")
        yield Pause(0.2)
        yield mark("sync")
        yield from self._send_message(StartSync(CUTOFF_CENTIHZ))
        yield mark("syncs")
        for _ in range(SYNCS):
            yield self._say(Sync())
            yield Pause(SYNC_S)
        yield mark("ask-again")
        yield from self._send_message(GetState())
        if self._level >= Level.BY_HAND:
            yield from self._send_message(StartAsync(CUTOFF_CENTIHZ, PERIOD_US))
            yield mark("load")
            yield ask("load", "Press on the sensor with a few newtons.")
            yield Pause(min(HAND_S, 4.0 * self._seconds))
        yield mark("leave")
        yield from self._send_message(Stop())
