"""Our own server with selected defects, and a scenario in virtual time."""

from __future__ import annotations

import heapq
import itertools
import math
import random
from collections import Counter
from collections.abc import Iterator, Mapping

from cardan.conform.runner import Exchange, Step
from cardan.conform.timeline import Kind
from cardan.protocols.spnav.codes import Code, EventMask
from cardan.protocols.spnav.records import (
    OK,
    RECORD_BYTES,
    STATUS,
    Button,
    ConfigChange,
    DeviceChange,
    MotionEvent,
    ServerReply,
    decode_handshake,
    decode_server_record,
    encode_handshake,
    encode_reply,
)
from cardan.sim_peers.base import check_faults, strikes
from cardan.types import Axes, ButtonEvent, DeviceLink, DeviceState
from cardan_spnav_server.conform.faults import FAULTS
from cardan_spnav_server.conform.scenario import NEW, OLD, OTHER
from cardan_spnav_server.core import SpnavServerCore
from cardan_spnav_server.identity import DeviceIdentity
from cardan_spnav_server.protocol import (
    ClientRequest,
    bits_of,
    decode_request,
    encode_button,
    encode_device,
    encode_motion,
)

LONGEST_S = 300.0
"""Limit of a simulated run; a script whose wait is never fulfilled ends before."""
OFFER_S = 0.008
COUNTS = 350.0
IDENTITY = DeviceIdentity("3Dconnexion SpaceNavigator", "/dev/input/event7", 0x206, 0x046D, 0xC626)
_BUTTONS = ("left", "right")
_PUSHES = ("push", "same", "scaled", "masked", "alone")
_RIGHT = Axes(0.0, -0.5, 0.0, 0.0, 0.0, 0.0)
_CLOCKWISE = Axes(0.0, 0.0, 0.0, 0.0, 0.0, -1.0)
_REST = Axes(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_JUNK = b"\x55" * RECORD_BYTES
_CONTINUED = 0x10000


class SpnavSimulation:
    """Programs that are connected to the server, and a user who follows the instructions."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        check_faults(faults, FAULTS)
        self._exchange, self._faults = exchange, faults
        self._core = SpnavServerCore(_BUTTONS, identity=IDENTITY, on_led=lambda _: None)
        self._random = random.Random(seed)
        self._numbers: dict[str, int] = {}
        """Numbers of the server by connection, in the order of opening."""
        self._axes, self._there, self._edges = _REST, True, list[ButtonEvent]()
        self._sent: list[tuple[float, int, str, bytes]] = []
        """Heap of data under way: due, order, connection, bytes."""
        self._order = itertools.count()
        self._counts: Counter[str] = Counter()
        self._asked = False
        """True if the server must handle data of a program next."""
        self._mask: int | None = None
        """Event mask set by the program of version 1."""
        self._sensitivity = bits_of(1.0)
        self._shown: dict[str, MotionEvent] = {}
        self._repeat_s = self._offer_s = self._now_s = 0.0

    def run(self) -> None:
        """Run until the scenario is over."""
        exchange = self._exchange
        while not exchange.over and self._now_s < LONGEST_S:
            if self._now_s >= self._offer_s:
                self._offer()
            self._do(exchange.due(self._now_s))
            self._serve()
            if self._now_s >= self._faults.get("hang-up", math.inf):
                self._end("the daemon closed the connection")
            if exchange.over:
                break
            due_s = min(self._offer_s, exchange.next_s, self._core.next_due_s())
            if self._asked:
                due_s, self._asked = self._now_s, False
            if self._sent:
                due_s = min(due_s, self._sent[0][0])
            if "repeat" in self._faults:
                due_s = min(due_s, self._repeat_s)
            self._now_s = max(self._now_s + 1e-6, due_s)

    # -- the device ----------------------------------------------------------------------------

    def _offer(self) -> None:
        self._offer_s = self._now_s + OFFER_S
        axes = self._axes
        if any(axes) or "drift" in self._faults:
            off = self._faults.get("drift", 0.0)
            axes = Axes(*(u + (off + self._random.randint(-1, 1)) / COUNTS for u in axes))
        link = DeviceLink.LIVE if self._there else DeviceLink.LOST
        edges, self._edges = self._edges, []
        held = frozenset[str]()
        self._core.offer(DeviceState(self._now_s, link, axes, held), edges, self._now_s)

    def _by_hand(self, what: str) -> None:
        if what in _PUSHES or what == "unplug":
            self._axes = _RIGHT
        elif what == "twist":
            self._axes = _CLOCKWISE
        elif what == "let-go":
            self._axes = _REST
        if what in ("press", "masked"):
            self._edges.append(ButtonEvent(self._now_s, _BUTTONS[0], True))
        elif what in ("release", "let-go"):
            self._edges.append(ButtonEvent(self._now_s, _BUTTONS[0], False))
        if what in ("unplug", "replug"):
            self._there = what == "replug"
            self._axes = _REST if self._there else self._axes
        self._offer_s = self._now_s

    # -- programs ------------------------------------------------------------------------------

    def _do(self, steps: list[Step]) -> None:
        for step in steps:
            if step.kind is Kind.DATA:
                if step.channel in self._numbers:
                    self._take(step.channel, step.data)
            elif step.kind is Kind.OPENED:
                self._connect(step.channel)
            elif step.kind is Kind.CLOSED:
                self._core.disconnect(self._numbers.pop(step.channel, -1))
                if self._faults.get("ends-all"):
                    self._end("the daemon closed the connection")
            elif step.kind is Kind.ASKED:
                self._by_hand(step.channel)

    def _connect(self, channel: str) -> None:
        if self._now_s < self._faults.get("refuse", 0.0):
            heard = self._exchange.heard(self._now_s, channel, kind=Kind.REFUSED, note="no socket")
            self._do(heard)
            return
        number = self._core.connect(self._now_s)
        assert number is not None
        self._numbers[channel] = number
        if self._faults.get("tells-all") and channel == OLD:
            change = DeviceChange(True, 0, *IDENTITY[2:5])
            self._send(channel, encode_device(change))
        self._do(self._exchange.heard(self._now_s, channel, kind=Kind.OPENED))

    def _end(self, why: str) -> None:
        for channel in tuple(self._numbers):
            self._core.disconnect(self._numbers.pop(channel))
            self._do(self._exchange.heard(self._now_s, channel, kind=Kind.CLOSED, note=why))

    def _take(self, channel: str, data: bytes) -> None:
        """Pass a program's data to the server, unless a defect drops or changes it."""
        self._asked = True
        if len(data) != RECORD_BYTES:
            version = decode_handshake(data)
            if self._faults.get("version-0" if version is not None else "deaf-v0"):
                return
            if version is not None and self._faults.get("grants-all"):
                self._core.receive(self._numbers[channel], data, self._now_s)
                self._core.sent(self._numbers[channel], len(data))
                self._send(channel, encode_handshake(version))
                return
        else:
            request = decode_request(data)
            assert isinstance(request, ClientRequest)
            if self._keeps(channel, request):
                return
        self._core.receive(self._numbers[channel], data, self._now_s)

    def _keeps(self, channel: str, request: ClientRequest) -> bool:
        """Return True if a defect answers a request instead of the server, or drops it."""
        faults, code = self._faults, request.code
        if code == Code.SET_NAME:
            if faults.get("name-answered"):
                self._send(channel, encode_reply(request.word))
            return False
        self._counts["requests"] += 1
        if self._every("no-answer", "requests"):
            return True
        if code == Code.SET_EVMASK and channel == NEW:
            self._mask = request.data[0]
        elif code == Code.SET_SENS:
            self._sensitivity = request.data[0]
        reported = {
            ("mask-ignored", Code.SET_EVMASK): self._mask,
            ("mask-ignored", Code.GET_EVMASK): self._mask,
            ("deaf-v1", Code.SET_SENS): self._sensitivity,
            ("deaf-v1", Code.GET_SENS): self._sensitivity,
        }
        for (fault, about), value in reported.items():
            if faults.get(fault) and about == code and value is not None:
                self._send(channel, encode_reply(request.word, (value,)))
                return True
        return False

    # -- what the server says ------------------------------------------------------------------

    def _serve(self) -> None:
        core = self._core
        core.advance(self._now_s)
        for channel, number in tuple(self._numbers.items()):
            while record := core.outgoing(number, self._now_s):
                core.sent(number, len(record))
                for each in self._spoilt(channel, record):
                    self._send(channel, each)
        self._repeat()
        while self._sent and self._sent[0][0] <= self._now_s:
            _, _, channel, data = heapq.heappop(self._sent)
            if channel in self._numbers and not self._faults.get("mute"):
                self._do(self._exchange.heard(self._now_s, channel, data))

    def _send(self, channel: str, data: bytes) -> None:
        """Send data to a program, late if a defect delays it."""
        due_s = self._now_s
        burst_s = self._faults.get("burst", 0.0)
        if burst_s and due_s % (2.0 * burst_s) < burst_s:
            due_s += burst_s - due_s % (2.0 * burst_s)
        if len(data) == RECORD_BYTES and isinstance(decode_server_record(data), ServerReply):
            due_s += 1e-3 * self._faults.get("slow-answer", 0.0)
        heapq.heappush(self._sent, (due_s, next(self._order), channel, data))

    def _repeat(self) -> None:
        if "repeat" not in self._faults or self._now_s < self._repeat_s:
            return
        self._repeat_s = self._now_s + 1e-3 * self._faults["repeat"]
        for channel, shown in self._shown.items():
            if any(shown[:6]) and channel in self._numbers:
                self._send(channel, encode_motion(shown[:6], round(self._faults["repeat"])))

    def _every(self, fault: str, count: str) -> bool:
        """Return True if a fault of every VALUE-th item acts on this one."""
        return strikes(self._faults, fault, self._counts[count])

    def _spoilt(self, channel: str, record: bytes) -> Iterator[bytes]:
        """Yield `record` altered by these defects."""
        if not self._faults or len(record) != RECORD_BYTES:
            yield record
            return
        value = decode_server_record(record)
        found: Iterator[bytes] = iter((record,))
        if isinstance(value, MotionEvent):
            found = self._motion(channel, value)
        elif isinstance(value, Button):
            found = self._button(channel, value)
        elif isinstance(value, ServerReply):
            found = iter((self._reply(value),))
        elif isinstance(value, (ConfigChange, DeviceChange)) and self._unreported(value):
            return
        for each in found:
            self._counts["records"] += 1
            yield each[:-8] if self._every("short", "records") else each

    def _unreported(self, value: ConfigChange | DeviceChange) -> bool:
        if isinstance(value, ConfigChange):
            return bool(self._faults.get("led-unreported"))
        return bool(self._faults.get("replug-unreported" if value.added else "unplug-unreported"))

    def _motion(self, channel: str, value: MotionEvent) -> Iterator[bytes]:
        faults = self._faults
        counts: tuple[int, ...] = value[:6]
        if self._now_s >= faults.get("silence", math.inf):
            return
        if faults.get("one-client") and channel != list(self._numbers)[-1]:
            return
        if faults.get("missing-zero") and not any(counts):
            return
        self._counts["motions"] += 1
        if self._every("unknown", "motions"):
            yield _JUNK
        if faults.get("unmirrored"):
            counts = (*counts[:3], *(-each for each in counts[3:]))
        counts = tuple(round(faults.get("overrange", 1.0) * each) for each in counts)
        period_ms = round(faults.get("period", value.period_ms))
        self._shown[channel] = value
        self._beside(channel, EventMask.MOTION)
        yield encode_motion(counts, period_ms)

    def _beside(self, channel: str, kind: EventMask) -> None:
        """Send zeros to the program that masks the other's events."""
        masked = self._mask is not None and not self._mask & kind
        if self._faults.get("mask-zeros") and channel == OTHER and masked:
            self._send(NEW, encode_motion(_NO_COUNTS, 0))

    def _button(self, channel: str, value: Button) -> Iterator[bytes]:
        self._counts[f"keys of {channel}"] += 1
        number = value.number + int(self._faults.get("key-number", 0.0))
        record = encode_button(number, value.pressed)
        if not self._every("key-lost", f"keys of {channel}"):
            yield record
        if self._every("key-twice", f"keys of {channel}"):
            yield record

    def _reply(self, value: ServerReply) -> bytes:
        faults, data = self._faults, list(value.data)
        replaced = {
            Code.DEV_NAXES: "axes",
            Code.DEV_TYPE: "type",
            Code.GCFG_REPEAT: "repeat-interval",
        }
        known = value.code in tuple(Code)
        if known and replaced.get(Code(value.code), "") in faults:
            data[0] = int(faults[replaced[Code(value.code)]])
        elif value.code == Code.GET_EVMASK and self._mask is None and "mask" in faults:
            data[0] = int(faults["mask"])
        elif value.code == Code.GCFG_SENS and faults.get("nan"):
            data[0] = bits_of(math.nan)
        if faults.get("string") and value.code == Code.DEV_NAME:
            data[STATUS] &= ~_CONTINUED
        gone = faults.get("keeps-device") and value.code == Code.DEV_NAXES
        if gone or (faults.get("grants-unknown") and not known):
            data[STATUS] = OK
        word = value.code if faults.get("bare-word") else value.word
        return encode_reply(word, data[:STATUS], data[STATUS])


_NO_COUNTS = (0,) * 6
