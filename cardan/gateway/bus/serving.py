"""What the servers on the bus share."""

from __future__ import annotations

from typing import Any, Protocol

from cardan.bus.node import ServiceRequest
from cardan.gateway.arm.requests import Request


def key_end(key: str) -> str:
    """Type and hash that the key of a message ends with."""
    return "/".join(key.split("/")[-2:])


class CommandServer(Protocol):
    """Passes requests on to the session's worker, and tells what became of them."""

    refused: int
    """Messages and requests that were none."""

    def next_id(self) -> int:
        """Of the next request."""

    def source(self, packet: ServiceRequest) -> str:
        """Name of who sent `packet` in the arm's authority. In the thread that decodes."""

    def watched(self, request: Request, packet: ServiceRequest) -> Request:
        """`request`, of a motion without end with a way to see whether who asked is still there.
        Raises PacketError where nobody could see it. From any thread."""

    def offer(self, client: Any, packet: Any) -> None:
        """Pass on what a client needs done besides. From any thread."""

    def tell(
        self, command: str, sequence: int, outcome: str, reason: str = "", source: str = ""
    ) -> None:
        """Publish what became of a command of `source`. From any thread."""
