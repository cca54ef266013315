"""Parts that the servers on the bus share."""

from __future__ import annotations

import time
from typing import Any, Protocol

from cardan.bus.node import BusNode, ServiceRequest
from cardan.gateway.arm.requests import Request
from cardan.protocols.ros2.cdr import Message, codec_of
from cardan.protocols.ros2.messages import json_text

RESULT_TYPE = "cardan_msgs/msg/CommandResult"
TEXT_TYPE = "std_msgs/msg/String"


def key_end(key: str) -> str:
    """Return the type and hash at the end of a message's key."""
    return "/".join(key.split("/")[-2:])


class Results:
    """Outcomes of commands that arrive on topics: ``~/result``, and the same as JSON on
    ``~/result_text`` for clients without cardan_msgs. For one thread at a time."""

    def __init__(self, node: BusNode) -> None:
        self._results = node.publisher("~/result", RESULT_TYPE)
        self._texts = node.publisher("~/result_text", TEXT_TYPE)

    def put(self, command: str, sequence: int, outcome: str, reason: str, source: str) -> None:
        """Publish one outcome."""
        now_ns = time.time_ns()
        message: Message = {
            "header": {
                "stamp": {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9},
                "frame_id": "",
            },
            "command": command,
            "sequence": sequence,
            "source": source,
            "outcome": outcome,
            "success": outcome in ("accepted", "done"),
            "reason": reason,
        }
        self._results.put(codec_of(RESULT_TYPE).encode(message), now_ns)
        text = {"data": json_text(RESULT_TYPE, message)}
        self._texts.put(codec_of(TEXT_TYPE).encode(text), now_ns)


class CommandServer(Protocol):
    """Passes requests on to the session's worker, and publishes their outcomes."""

    refused: int
    """Count of malformed messages and requests."""

    def next_id(self) -> int:
        """Id of the next request."""

    def source(self, packet: ServiceRequest) -> str:
        """Return the name of the sender of `packet` in the arm's authority. In the thread that
        decodes."""

    def watched(self, request: Request, packet: ServiceRequest) -> Request:
        """Return `request`; a motion without end gets a check whether its client is still there.
        Raises PacketError if such a check is impossible, and while no commands are taken. From any
        thread."""

    def offer(self, client: Any, packet: Any) -> None:
        """Queue another packet of a client. From any thread."""

    def tell(
        self, command: str, sequence: int, outcome: str, reason: str = "", source: str = ""
    ) -> None:
        """Publish the outcome of a command of `source`. From any thread."""
