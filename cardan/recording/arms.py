"""Selection of an arm in a record, and the topic names that arms share."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from cardan.errors import CaptureError, OptionError
from cardan.protocols.ros2.cdr import Message

NS = 10**9

POSE, TARGET = "/state/pose", "/state/target"
STATUS, SNAPSHOT = "/state/status", "/state/snapshot"
WRENCH, RAW_ROBOT = "/state/wrench", "/raw/robot"
"""Suffixes of an arm's topics, after its node's name."""

CONFIGURATION = "/configuration"
"""Topic that identifies the arms of a record: each session's node publishes it."""


def choose_arm(nodes: Collection[str], arm: str, path: Path, problems: Sequence[str] = ()) -> str:
    """Return the full node name of `arm`; "" selects the only arm. `problems` of the file are for
    the error message. Raises CaptureError, OptionError."""
    if not nodes:
        why = "; ".join(("", *problems))
        raise CaptureError(f"{path} has no state of an arm, such as NODE{POSE}{why}")
    names = ", ".join(sorted(nodes))
    if arm:
        node = f"/{arm.strip('/')}"
        if node not in nodes:
            raise OptionError("--arm", arm, f"one of {names}")
        return node
    if len(nodes) > 1:
        raise OptionError("--arm", arm, f"one of {names}, as {path} has several")
    return next(iter(nodes))


def stamped_ns(message: Message) -> int:
    """The stamp in a message's header, ns since the epoch."""
    stamp = message["header"]["stamp"]
    return int(stamp["sec"]) * NS + int(stamp["nanosec"])
