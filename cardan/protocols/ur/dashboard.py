"""Dashboard server, TCP port 29999: a line of text per request, and one per reply."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from cardan.protocols.ur.framing import StreamReader

DASHBOARD_PORT: Final = 29999
GREETING: Final = "Connected: Universal Robots Dashboard Server"
LONGEST_LINE: Final = 4096

ROBOT_MODE: Final = "robotmode"
SAFETY_STATUS: Final = "safetystatus"
POWER_ON: Final = "power on"
POWER_OFF: Final = "power off"
BRAKE_RELEASE: Final = "brake release"
UNLOCK_PROTECTIVE_STOP: Final = "unlock protective stop"
CLOSE_SAFETY_POPUP: Final = "close safety popup"
REMOTE_CONTROL: Final = "is in remote control"
ROBOT_MODEL: Final = "get robot model"
STOP: Final = "stop"
SHUTDOWN: Final = "shutdown"
QUIT: Final = "quit"

UNLOCK_AFTER_S: Final = 5.0
"""Time before which a protective stop cannot be unlocked, s."""

GRANTED: Final[Mapping[str, str]] = {
    POWER_ON: "Powering on",
    POWER_OFF: "Powering off",
    BRAKE_RELEASE: "Brake releasing",
    UNLOCK_PROTECTIVE_STOP: "Protective stop releasing",
    CLOSE_SAFETY_POPUP: "closing safety popup",
    STOP: "Stopped",
    SHUTDOWN: "Shutting down",
}
"""Beginning of the reply to a granted request."""


def request(line: str) -> bytes:
    """Encode a request. Raises ValueError for a text of more than one line."""
    if "\n" in line or "\r" in line:
        raise ValueError(f"{line!r} is more than one line")
    return line.encode() + b"\n"


def refusal(line: str, reply: str) -> str:
    """Return the server's refusal of the request `line`; empty if it was granted."""
    return "" if reply.lower().startswith(GRANTED[line].lower()) else reply


def greets(said: bytes) -> bool | None:
    """True if a server's first bytes are a dashboard server's; None if more are needed."""
    greeting = GREETING.encode()
    return None if said != greeting and greeting.startswith(said) else said.startswith(greeting)


class DashboardReader(StreamReader):
    """Splitter of a TCP stream into lines."""

    def __init__(self) -> None:
        super().__init__()
        self._skips = False

    def feed(self, data: bytes) -> None:
        super().feed(data)
        if self._skips:
            _, end, rest = self._pending.partition(b"\n")
            self._pending, self._skips = rest, not end

    def skip(self) -> None:
        """Continue after a line that was too long, as a server may."""
        self.failure, self._skips = "", True
        self.feed(b"")

    def take(self) -> str | None:
        """Return the next line without its end; None if it is incomplete."""
        if self.failure:
            return None
        line, found, rest = self._pending.partition(b"\n")
        if len(line) > LONGEST_LINE:
            self.failure = f"a line of more than {LONGEST_LINE} bytes: not a dashboard server"
            return None
        if not found:
            return None
        self._pending = rest
        return line.rstrip(b"\r").decode("utf-8", "replace")
