"""Scenario of programs at spacenavd's socket: three, of both versions of the protocol."""

from __future__ import annotations

from collections.abc import Sequence

from cardan.conform.hands import QUIET_S, HandScenario, Steps
from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Script, ask, close, mark, open_, send
from cardan.conform.timeline import WireEvent
from cardan.protocols.spnav.codes import MASK_V1, NEWEST_VERSION, REQUEST_TAG, Code, EventMask
from cardan.protocols.spnav.records import (
    STATUS,
    Button,
    DeviceChange,
    MotionEvent,
    ServerReply,
    encode_handshake,
    encode_request,
    encode_sensitivity,
)
from cardan.protocols.spnav.streams import Handshake, ServerReader
from cardan.protocols.spnav.strings import CHUNK_BYTES, encode_string
from cardan_spnav_server.protocol import bits_of

OLD, NEW, OTHER = "v0", "v1", "other"
"""Connections: a silent one, like version 0's; one with requests; and one for comparison."""
REST_S = 0.5
ANSWER_S = 0.5
LATER = 9
"""A version that does not exist."""
UNKNOWN = 0x1FFF
"""Not a valid request."""
STRINGS = (Code.DEV_NAME, Code.DEV_PATH)
IDENTITY = (Code.DEV_NAXES, Code.DEV_NBUTTONS, Code.DEV_TYPE, Code.DEV_USBID)
SETTINGS = (
    Code.GCFG_SENS, Code.GCFG_SENS_AXIS, Code.GCFG_DEADZONE, Code.GCFG_INVERT, Code.GCFG_AXISMAP,
    Code.GCFG_SWAPYZ, Code.GCFG_GRAB, Code.GCFG_REPEAT, Code.GCFG_LED,
)  # fmt: skip
NEW_FACTOR, OLD_FACTOR = 2.0, 3.0
SAME: Steps = (("same", "Push the cap to the right, half way, and hold it."),)
SCALED: Steps = (("scaled", "Push the cap to the right, half way, and hold it once more."),)
MASKED: Steps = (("masked", "Push the cap to the right, hold it, and press a button."),)
ALONE: Steps = (("alone", "Push the cap to the right once more."),)


class SpnavScenario(HandScenario):
    """Level 0 is a program of version 0, which sends nothing. Higher levels send requests, and
    change only settings of a connection."""

    def __init__(self, level: Level, seconds: float) -> None:
        super().__init__(level, seconds)
        self._readers = {name: ServerReader() for name in (OLD, NEW, OTHER)}
        self._granted = self._answered = self._removed = self._added = False
        self._led: int | None = None

    def _note(self, event: WireEvent) -> None:
        for value in self._readers[event.channel].feed(event.data):
            if isinstance(value, MotionEvent):
                self._moved = self._moved or any(value[:6])
            elif isinstance(value, Button):
                self._pressed = True
            elif isinstance(value, DeviceChange):
                self._added, self._removed = value.added, not value.added
            elif isinstance(value, Handshake):
                self._granted = value.version >= NEWEST_VERSION
            elif isinstance(value, ServerReply):
                left = value.data[STATUS] & 0xFFFF if value.code in STRINGS and value.ok else 0
                self._answered = left <= CHUNK_BYTES
                if value.code == Code.GCFG_LED and value.ok:
                    self._led = value.data[0]

    def script(self) -> Script:
        yield open_(OLD)
        yield mark("rest")
        yield ask("rest", "Do not touch the device.")
        yield Pause(REST_S)
        yield from self._motions(REST_S)
        yield from self._keys()
        if self._level < Level.HOLD:
            return
        yield mark("greet-later")
        yield from self._greet(OTHER, LATER)
        yield mark("greet")
        yield from self._greet(NEW, NEWEST_VERSION)
        if not self._granted or self._gone:
            # A daemon of version 0 would take the records below for sensitivities.
            return
        yield mark("ask")
        yield from self._questions()
        yield from self._pushes()
        if self._level >= Level.BY_HAND:
            yield from self._without_device()

    def _greet(self, channel: str, version: int) -> Script:
        self._granted = False
        yield open_(channel)
        yield send(encode_handshake(version), channel)
        yield Pause(ANSWER_S, lambda: self._granted or self._gone)

    def _send_request(self, code: int, data: Sequence[int] = (), channel: str = NEW) -> Script:
        self._answered = False
        yield send(encode_request(code, data), channel)
        yield Pause(ANSWER_S, lambda: self._answered or self._gone)

    def _questions(self) -> Script:
        for record in encode_string(REQUEST_TAG | Code.SET_NAME, "cardan conform"):
            yield send(record, NEW)
        yield Pause(0.05)
        yield from self._send_request(Code.GET_EVMASK)
        for code in (*STRINGS, *IDENTITY, *SETTINGS):
            yield from self._send_request(code)
        yield from self._send_request(UNKNOWN)
        yield from self._send_request(Code.SET_EVMASK, [MASK_V1 | EventMask.CONFIG])
        yield from self._send_request(Code.GET_EVMASK)
        if self._led is not None:
            yield from self._send_request(Code.SET_EVMASK, [MASK_V1 | EventMask.CONFIG], OTHER)
            yield mark("led")
            yield from self._send_request(Code.SCFG_LED, [self._led])
            yield Pause(0.1)
        yield from self._send_request(Code.SET_EVMASK, [MASK_V1])

    def _pushes(self) -> Script:
        yield from self._motions(REST_S, SAME)
        yield from self._send_request(Code.SET_SENS, [bits_of(NEW_FACTOR)])
        yield from self._send_request(Code.GET_SENS)
        yield send(encode_sensitivity(OLD_FACTOR), OLD)
        yield from self._motions(REST_S, SCALED)
        yield from self._send_request(Code.SET_SENS, [bits_of(1.0)])
        yield send(encode_sensitivity(1.0), OLD)
        yield from self._send_request(Code.SET_EVMASK, [EventMask.BUTTON])
        yield from self._motions(REST_S, MASKED)
        yield from self._send_request(Code.SET_EVMASK, [MASK_V1])
        yield close(OTHER)
        yield from self._motions(REST_S, ALONE)

    def _without_device(self) -> Script:
        yield mark("unplug")
        self._removed = False
        yield ask("unplug", "Hold the cap deflected, and unplug the device.")
        yield Pause(self._hand_s, lambda: self._removed or self._gone)
        yield Pause(QUIET_S)
        yield mark("unplugged")
        yield from self._send_request(Code.DEV_NAXES)
        yield mark("replug")
        self._added = False
        yield ask("replug", "Plug the device in again.")
        yield Pause(self._hand_s, lambda: self._added or self._gone)
        yield Pause(QUIET_S)
