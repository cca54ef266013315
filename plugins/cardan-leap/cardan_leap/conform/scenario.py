"""Scenario: requests frames of a tracking service, and prompts the user to hold a hand above the
tracker."""

from __future__ import annotations

from collections.abc import Iterator

from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Scenario, Script, Step, ask, mark, open_, send
from cardan.conform.timeline import Kind, WireEvent
from cardan_leap.protocol import ClientOptions, TrackingFrame, decode_service, encode_options

CHANNEL = "v6"
LISTEN_S = 0.5
EMPTY_S = 0.6
GONE_S = 0.3
HAND_S = 30.0


class LeapScenario(Scenario):
    """Client that first only listens, then receives frames in the background, then with the
    focus."""

    def __init__(self, level: Level, seconds: float) -> None:
        self._level = level
        self._seconds = seconds
        self._hand_s = min(HAND_S, 4.0 * seconds)
        self._hands = 0
        self._gone = False

    def answer(self, event: WireEvent) -> Iterator[Step]:
        if event.kind in (Kind.CLOSED, Kind.REFUSED):
            self._gone = True
        elif event.kind is Kind.DATA:
            value = decode_service(event.data)
            if isinstance(value, TrackingFrame):
                self._hands = len(value.hands)
        return iter(())

    def _say(self, options: ClientOptions) -> Script:
        for text in encode_options(options):
            yield send(text.encode(), CHANNEL)

    def script(self) -> Script:
        yield open_(CHANNEL)
        yield mark("listen")
        yield Pause(LISTEN_S, lambda: self._gone)
        if self._level < Level.HOLD:
            return
        yield mark("empty")
        yield ask("leave", "Take your hands away from the tracker.")
        yield from self._say(ClientOptions(background=True, optimize_hmd=False))
        yield Pause(EMPTY_S)
        yield mark("enter")
        yield ask("enter", "Hold your right hand 20 cm above the tracker, palm down, and still.")
        yield Pause(self._hand_s, lambda: self._hands == 1 or self._gone)
        yield Pause(GONE_S)
        yield mark("hand")
        yield Pause(self._seconds)
        yield mark("leave")
        yield ask("leave", "Take your hand away.")
        yield Pause(self._hand_s, lambda: self._hands == 0 or self._gone)
        yield Pause(GONE_S)
        yield mark("focused")
        yield from self._say(ClientOptions(focused=True, background=False))
        yield Pause(1.0)
        yield mark("unfocused")
        yield from self._say(ClientOptions(focused=False, background=False))
        yield Pause(0.1)
        yield mark("unheard")
        yield Pause(0.3)
        if self._level >= Level.BY_HAND:
            yield from self._say(ClientOptions(background=True))
            yield mark("unplug")
            yield ask("unplug", "Unplug the tracker.")
            yield Pause(min(HAND_S, self._hand_s))
