"""Simulated tracking service, with time as an argument: its hands, its tracker, its clients. Times
are s since its start. Frames keep an absolute schedule with jitter; a service that runs late skips
frames instead of sending a burst."""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from cardan.sim_peers.base import check_faults, strikes
from cardan_leap.peer.faults import ABSURD_MM, FAULTS, RESTART_S, STALL_EVERY_S
from cardan_leap.peer.hand_model import HandModel, HandPosture, Triple, as_version, frame_document
from cardan_leap.protocol import (
    DEVICE_EVENT_SINCE,
    FOCUS_SINCE,
    HEARTBEAT_PERIOD_S,
    HEARTBEAT_VERSIONS,
    UNSUPPORTED_VERSION_CLOSE,
    VERSIONS,
    ClientOptions,
    DeviceEvent,
    Malformed,
    Version,
    decode_options,
    encode_device_event,
    encode_json,
    encode_version,
)

DEFAULT_RATE_HZ = 110.0
DEFAULT_JITTER = 0.1
SERVICE_VERSION = "2.3.1+33747"
DEVICE_ID = "LP00000000001"
DEVICE_TYPE = "peripheral"
HEARTBEAT_VALID_S = 2.0 * HEARTBEAT_PERIOD_S
EPOCH_US = 56_257_000_000
"""The service's clock at its start: its epoch is arbitrary."""
LOG_LENGTH = 1000

UPRIGHT: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass
class SimulatedHand:
    """Hand in view of the tracker, and its posture."""

    hand_model: HandModel
    palm_mm: Triple = (0.0, 200.0, 0.0)
    tilt_deg: Triple = (0.0, 0.0, 0.0)
    """Pitch (fingers up), yaw (fingers to the right) and roll (left edge down)."""
    grab: float = 0.0
    pinch: float = 0.0
    confidence: float = 1.0


class Message(NamedTuple):
    """Message of the service to a client, and its time."""

    time_s: float
    client: int
    text: str


@dataclass
class _Client:
    version: int
    background: bool = False
    heartbeat_s: float = -math.inf
    enable_gestures: bool = False
    optimize_hmd: bool = False
    outbox: list[str] = field(default_factory=list)


class SimulatedLeapService:
    """Simulated service. The caller assigns numbers to its clients.

    Raises ScriptError for faults that do not exist.
    """

    def __init__(
        self,
        *,
        rate_hz: float = DEFAULT_RATE_HZ,
        jitter: float = DEFAULT_JITTER,
        faults: Mapping[str, float] | None = None,
        seed: int = 0,
    ) -> None:
        self.faults = dict(faults or {})
        check_faults(self.faults, FAULTS)
        self.rate_hz = rate_hz
        self._period_s = 1.0 / rate_hz
        self._jitter_s = jitter * self._period_s
        self._random = random.Random(seed)
        self.hands: dict[str, SimulatedHand] = {}
        """Hands in view by side: "left", "right"."""
        self.attached = not self.faults.get("no-device")
        self.streaming = self.attached
        self.stalled = False
        self.requests: deque[tuple[int, ClientOptions | Malformed]] = deque(maxlen=LOG_LENGTH)
        """Messages of clients, newest last."""
        self.frames_sent = 0
        self.restarts = 0
        """Number of restarts: each ends all connections."""
        self._clients: dict[int, _Client] = {}
        self._focused: int | None = None
        self._next_hand_id = 1
        self._frame_id = 0
        self._slot = 0
        self._due_s = 0.0
        self._last_frame_s: float | None = None
        self._rate_shown_hz = 0.0
        self._now_s = 0.0
        self._down_until_s = 0.0
        self._malformed_left = 0
        self._new_ids_s = self.faults.get("new-ids", math.inf)
        self._timed = sorted(
            (self.faults[name], name)
            for name in ("unplug", "replug", "pause", "restart", "lost-focus", "count-anew")
            if name in self.faults
        )

    # -- clients -------------------------------------------------------------------------------

    @property
    def plugged(self) -> bool:
        """True if connections are accepted now."""
        return self._now_s >= self._down_until_s

    @property
    def clients(self) -> tuple[int, ...]:
        """Return the numbers of the connected clients."""
        return tuple(self._clients)

    @property
    def focused(self) -> int | None:
        """Return the client that has the focus."""
        return self._focused

    def connect(self, number: int, version: int) -> int | None:
        """Register a client that opened the path of `version`; return the close code, or None."""
        if version > self.faults.get("highest-version", VERSIONS[-1]):
            return UNSUPPORTED_VERSION_CLOSE
        self._clients[number] = client = _Client(version)
        if self.faults.get("mute"):
            return None
        client.outbox.append(encode_version(Version(version, SERVICE_VERSION)))
        if version >= DEVICE_EVENT_SINCE and self.attached:
            client.outbox.append(encode_device_event(self._device(), version))
        return None

    def disconnect(self, number: int) -> None:
        """Remove a client and its options."""
        self._clients.pop(number, None)
        if self._focused == number:
            self._focused = None

    def receive(self, number: int, text: bytes | str, now_s: float) -> None:
        """Process a client's message. There is never an answer."""
        options = decode_options(text)
        self.requests.append((number, options))
        client = self._clients.get(number)
        if client is None or isinstance(options, Malformed):
            return
        if client.version >= FOCUS_SINCE:
            if options.background is not None:
                client.background = options.background
            if options.focused:
                self._focused = number
            elif options.focused is False and self._focused == number:
                self._focused = None
        if options.heartbeat:
            client.heartbeat_s = now_s
        if options.enable_gestures is not None:
            client.enable_gestures = options.enable_gestures
        if options.optimize_hmd is not None:
            client.optimize_hmd = options.optimize_hmd

    def outgoing(self) -> list[tuple[int, str]]:
        """Return the messages to send now: client and text, in order."""
        messages: list[tuple[int, str]] = []
        burst_s = self.faults.get("burst", 0.0)
        if burst_s and math.floor(self._now_s / burst_s) % 2:
            return messages
        for number, client in self._clients.items():
            if client.outbox:
                messages += [(number, text) for text in client.outbox]
                client.outbox = []
        return messages

    def gets_frames(self, number: int, now_s: float) -> bool:
        """Return True if frames go to this client."""
        client = self._clients[number]
        if client.version >= FOCUS_SINCE:
            return client.background or number == self._focused
        if client.version in HEARTBEAT_VERSIONS:
            return now_s - client.heartbeat_s <= HEARTBEAT_VALID_S
        return True

    # -- hands and tracker ---------------------------------------------------------------------

    def enter(self, side: str) -> SimulatedHand:
        """Bring a hand into view, with a new id."""
        hand = SimulatedHand(self._hand_model(side))
        self.hands[side] = hand
        return hand

    def leave(self, side: str) -> None:
        """Remove a hand from view."""
        self.hands.pop(side, None)

    def new_id(self, side: str) -> None:
        """Lose and find the hand between two frames: a new id for the same hand."""
        if side in self.hands:
            self.hands[side].hand_model = self._hand_model(side)

    def set_device(self, attached: bool, streaming: bool) -> None:
        """Set whether the tracker is plugged in and whether it delivers; inform the clients."""
        if (attached, streaming) == (self.attached, self.streaming):
            return
        self.attached, self.streaming = attached, streaming
        if not self.faults.get("mute"):
            for client in self._clients.values():
                client.outbox.append(encode_device_event(self._device(), client.version))

    def unplug(self) -> None:
        """Unplug the tracker, with the service's events: first no delivery, then no tracker."""
        self.set_device(self.attached, False)
        self.set_device(False, False)

    def replug(self) -> None:
        """Plug the tracker in, with the events in reverse order."""
        self.set_device(True, False)
        self.set_device(True, True)

    def steal_focus(self) -> None:
        """Give the focus to another program."""
        self._focused = None

    def restart(self, down_s: float = RESTART_S) -> None:
        """Restart the service, away for `down_s`; hands in view get new ids."""
        self.restarts += 1
        self._down_until_s = self._now_s + down_s
        self._clients.clear()
        self._focused = None
        self._frame_id = 0
        self._next_hand_id = 1
        self._last_frame_s = None
        for side, hand in self.hands.items():
            hand.hand_model = self._hand_model(side)

    def break_next(self, frames: int) -> None:
        """Truncate the next `frames` frames."""
        self._malformed_left = frames

    def _hand_model(self, side: str) -> HandModel:
        self._next_hand_id += 1
        return HandModel(self._next_hand_id - 1, side, self._now_s)

    def _device(self) -> DeviceEvent:
        return DeviceEvent(DEVICE_ID, DEVICE_TYPE, self.attached, self.streaming)

    # -- time ----------------------------------------------------------------------------------

    @property
    def next_due_s(self) -> float:
        """Return the time at which `advance` has work next."""
        return self._next_event_s

    def skip_to(self, now_s: float) -> None:
        """Skip the frames that are more than a period late at `now_s`."""
        if now_s - self._due_s > self._period_s:
            slots = int(now_s * self.rate_hz) - self._slot
            if slots > 0:
                self._slot += slots
                self._frame_id += slots
                self._schedule()

    def advance(self, now_s: float) -> None:
        """Run the service until `now_s`, with the hands' present postures."""
        while (due_s := self._next_event_s) <= now_s:
            self._now_s = max(self._now_s, due_s)
            if self._timed and self._timed[0][0] <= due_s:
                self._strike(self._timed.pop(0)[1])
            elif self._new_ids_s <= due_s:
                self._new_ids_s += self.faults["new-ids"]
                for side in self.hands:
                    self.new_id(side)
            else:
                self._slot += 1
                self._schedule()
                self._make_frame(due_s)
        self._now_s = max(self._now_s, now_s)

    def reports(self, now_s: float) -> list[Message]:
        """Return the messages to clients from the last call until `now_s`."""
        self.advance(now_s)
        return [Message(now_s, number, text) for number, text in self.outgoing()]

    @property
    def _next_event_s(self) -> float:
        due_s = min(self._due_s, self._new_ids_s)
        return min(due_s, self._timed[0][0]) if self._timed else due_s

    def _strike(self, fault: str) -> None:
        if fault == "unplug":
            self.unplug()
        elif fault == "replug":
            self.replug()
        elif fault == "pause":
            self.set_device(self.attached, False)
        elif fault == "restart":
            self.restart()
        elif fault == "lost-focus":
            self.steal_focus()
        else:
            self._frame_id = 0

    def _schedule(self) -> None:
        self._due_s = self._slot * self._period_s + self._random.uniform(0.0, self._jitter_s)

    def _make_frame(self, due_s: float) -> None:
        stall_s = self.faults.get("stall", 0.0)
        if not (self.attached and self.streaming and self.plugged):
            return
        self._frame_id += 1
        silent = self.stalled or (
            stall_s > 0.0 and due_s % STALL_EVERY_S >= STALL_EVERY_S - stall_s
        )
        if silent or self._random.random() < self.faults.get("drop", 0.0):
            return
        if self._last_frame_s is not None and due_s > self._last_frame_s:
            rate_hz = 1.0 / (due_s - self._last_frame_s)
            self._rate_shown_hz += 0.1 * (rate_hz - self._rate_shown_hz)
            if self._rate_shown_hz < 0.5 * self.rate_hz:
                self._rate_shown_hz = rate_hz
        self._last_frame_s = due_s
        listeners = [number for number in self._clients if self.gets_frames(number, due_s)]
        document = self._document(due_s)
        if not listeners or self.faults.get("mute"):
            return
        self.frames_sent += 1
        self._send(document, [self._clients[number] for number in listeners])

    def _document(self, due_s: float) -> dict[str, Any]:
        measured = [
            hand.hand_model.measure(self._posture(hand), due_s) for hand in self.hands.values()
        ]
        # The order of hands is unstable in the real service, too.
        if self._frame_id % 2:
            measured.reverse()
        return frame_document(
            self._frame_id, EPOCH_US + round(due_s * 1e6), self._rate_shown_hz, measured
        )

    def _posture(self, hand: SimulatedHand) -> HandPosture:
        palm = hand.palm_mm
        if self._strikes("absurd"):
            palm = (palm[0], palm[1], palm[2] - ABSURD_MM)
        return HandPosture(
            palm,
            rotation_rows(*(math.radians(angle) for angle in hand.tilt_deg)),
            hand.grab,
            hand.pinch,
            self.faults.get("confidence", hand.confidence),
        )

    def _send(self, document: dict[str, Any], clients: list[_Client]) -> None:
        if self._strikes("no-palm"):
            for hand in document["hands"]:
                del hand["palmPosition"]
        broken = self._malformed_left > 0 or self._strikes("malformed")
        self._malformed_left = max(0, self._malformed_left - 1)
        texts: dict[int, str] = {}
        for client in clients:
            text = texts.get(client.version)
            if text is None:
                text = encode_json(as_version(document, client.version))
                if broken:
                    text = text[: len(text) // 2]
                texts[client.version] = text
            if self._strikes("unknown"):
                client.outbox.append(encode_json({"policy": {"images": False}}))
            client.outbox.append(text)
            if self._strikes("repeat"):
                client.outbox.append(text)

    def _strikes(self, fault: str) -> bool:
        return strikes(self.faults, fault, self._frame_id)


def rotation_rows(
    pitch_rad: float, yaw_rad: float, roll_rad: float
) -> tuple[Triple, Triple, Triple]:
    """Return the attitude of a hand that was rolled, then pitched, then yawed: tracker's axes, by
    rows."""
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    # R = Ry(-yaw)·Rx(pitch)·Rz(roll): up is +x turned towards +y, right is -z turned towards +x.
    return (
        (cy * cr - sy * sp * sr, -cy * sr - sy * sp * cr, -sy * cp),
        (cp * sr, cp * cr, -sp),
        (sy * cr + cy * sp * sr, -sy * sr + cy * sp * cr, cy * cp),
    )
