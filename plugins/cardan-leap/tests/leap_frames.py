"""A tracking service in virtual time, as seen by the driver's core."""

from __future__ import annotations

from typing import Any

from cardan.types import IDENTITY, DeviceState, Quaternion, Vector3
from cardan_leap.driver import LeapCore, LeapOptions
from cardan_leap.protocol import (
    DeviceEvent,
    Hand,
    Malformed,
    ServiceMessage,
    TrackingFrame,
    Version,
    direction_and_normal,
    position_to_leap,
)

PERIOD_S = 1.0 / 110.0
HOME = Vector3(0.0, 0.0, 0.2)
PLUGGED = DeviceEvent("LP1", "peripheral", attached=True, streaming=True)


def hand(
    identity: int = 1,
    position: Vector3 = HOME,
    orientation: Quaternion = IDENTITY,
    **fields: Any,
) -> Hand:
    """Return a hand at `position`, m, in the operator's axes: open, high confidence, long in
    view."""
    direction, normal = direction_and_normal(orientation)
    known = {
        "type": "right",
        "grab_strength": 0.0,
        "pinch_strength": 0.0,
        "confidence": 1.0,
        "time_visible_s": 9.0,
    }
    return Hand(identity, position_to_leap(position), normal, direction, **(known | fields))


class Bench:
    """A core and a service that sends a frame each period."""

    def __init__(self, **options: Any) -> None:
        self.core = LeapCore(LeapOptions(**options))
        self.now_s = 100.0
        self.frame_id = 0
        self.core.on_opened(self.now_s)
        self.tell(Version(6, "2.3.1"), PLUGGED)

    def tell(self, *messages: ServiceMessage) -> None:
        """Send messages at the present time."""
        for message in messages:
            self.core.on_message(message, self.now_s)

    def frame(self, *hands: Hand, unreadable: int = 0, frame_id: int | None = None) -> DeviceState:
        """Send one frame, a period later."""
        self.now_s += PERIOD_S
        if frame_id is None:
            self.frame_id = frame_id = self.frame_id + 1
        stamp_us = round(self.now_s * 1e6)
        self.tell(TrackingFrame(frame_id, stamp_us, 110.0, hands, unreadable))
        return self.state

    def frames(self, seconds: float, *hands: Hand) -> DeviceState:
        """Send the same hands for `seconds`."""
        for _ in range(round(seconds / PERIOD_S)):
            self.frame(*hands)
        return self.state

    def garbage(self, seconds: float) -> DeviceState:
        """Send unreadable messages for `seconds`."""
        for _ in range(round(seconds / PERIOD_S)):
            self.now_s += PERIOD_S
            self.tell(Malformed("that are not JSON"))
        return self.state

    def wait(self, seconds: float) -> DeviceState:
        """Send nothing for `seconds`."""
        self.now_s += seconds
        return self.state

    @property
    def state(self) -> DeviceState:
        return self.core.state(self.now_s)

    def edges(self) -> list[str]:
        """Return the button edges since the last call: "+hand", "-hand"."""
        return ["-+"[event.pressed] + event.button for event in self.core.events()]


def engaged(clutch: str = "still", **options: Any) -> Bench:
    """Return a bench whose hand with id 1 holds the clutch."""
    bench = Bench(clutch=clutch, **options)
    bench.frames(0.1)
    bench.frames(0.2, hand())
    if clutch in ("still", "open"):
        bench.frames(0.4, hand())
    else:
        bench.frames(0.1, hand(**{f"{clutch}_strength": 1.0}))
    assert "clutch" in bench.state.buttons
    bench.edges()
    return bench
