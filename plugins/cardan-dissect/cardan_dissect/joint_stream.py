"""scapy layers of the joint stream, the protocol of the simulated arm.

Positions are rad, speeds rad/s, torques N·m (m, m/s, N for a prismatic joint), stamps s, everything
little-endian. Written from the protocol's page (docs/simulated-peers.md), independent of Cardan's
codec, for cross-checks.

`JointStream(data)` dissects a datagram to JointStreamState, to JointStreamCommand, or to
JointStreamBroken if its length or its header is neither's; it never raises. Building fills in
missing numbers of joints and of the reason's bytes; a hold has none.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from typing import Any

from cardan_dissect._scapy import (
    UDP,
    ByteEnumField,
    ByteField,
    ConditionalField,
    Field,
    FieldLenField,
    LEIntField,
    Packet,
    StrField,
    StrFixedLenField,
    StrLenField,
    bind_bottom_up,
    bind_top_down,
)
from cardan_dissect.layers import Block
from cardan_dissect.ports import JOINT_STREAM_PORT

MAGIC = b"CJST"
VERSION = 1
STATE, COMMAND = 1, 2
HOLD, POSITION, VELOCITY, TORQUE = range(4)
KINDS = {STATE: "state", COMMAND: "command"}
MODES = {HOLD: "hold", POSITION: "position", VELOCITY: "velocity", TORQUE: "torque"}
MOST_JOINTS = 16

HEADER_BYTES = 24
STATE_BYTES = HEADER_BYTES + 4 + 8 + 8 * 7 + 8 * 6 + 1
"""Bytes of a state without its joints and its reason."""
STATE_LISTS = ("positions", "speeds", "torques")
COMMAND_LISTS: dict[int, tuple[str, ...]] = {
    HOLD: (),
    POSITION: ("positions", "speeds"),
    VELOCITY: ("speeds",),
    TORQUE: ("torques",),
}
"""Lists of a command's body, with a value per joint, by mode."""
QUATERNION_NORM_TOLERANCE = 1e-3
"""Largest difference of a unit quaternion's norm from 1."""


class DoubleField(Field[float, float]):
    """f64."""

    def __init__(self, name: str, default: float) -> None:
        Field.__init__(self, name, default, "<d")


class DoublesField(Field[Any, Any]):
    """List of f64; `count` returns their number in a packet."""

    __slots__ = ["count"]
    islist = 1

    def __init__(self, name: str, default: list[float], count: Callable[[Any], int]) -> None:
        self.count = count
        Field.__init__(self, name, default)

    def any2i(self, pkt: Any, x: Any) -> Any:
        return list(x) if isinstance(x, tuple) else x

    def addfield(self, pkt: Any, s: bytes, val: Any) -> bytes:
        return s + struct.pack(f"<{len(val)}d", *val)

    def getfield(self, pkt: Any, s: bytes) -> tuple[bytes, list[float]]:
        count = min(self.count(pkt), len(s) // 8)
        return s[8 * count :], list(struct.unpack_from(f"<{count}d", s))


class JointCountField(ByteField):
    """u8; default: number of values in the first list of the body."""

    def i2m(self, pkt: Any, x: Any) -> int:
        if x is None:
            lists = () if pkt is None else pkt.lists
            return len(pkt.getfieldval(lists[0])) if lists else 0
        return int(x)


def _header(kind: int, mode: int) -> list[Any]:
    return [
        StrFixedLenField("magic", MAGIC, 4),
        ByteField("version", VERSION),
        ByteEnumField("kind", kind, KINDS),
        ByteEnumField("mode", mode, MODES),
        JointCountField("joints", None),
        LEIntField("session", 0),
        LEIntField("sequence", 0),
        DoubleField("stamp_s", 0.0),
    ]


def _per_joint(name: str) -> DoublesField:
    return DoublesField(name, [], lambda pkt: pkt.joints)


def _in_modes_with(name: str) -> ConditionalField:
    return ConditionalField(_per_joint(name), lambda pkt: name in pkt.lists)


class JointStream(Block):
    """Datagram of either direction; dissects to the layer of its kind."""

    name = "joint stream"

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        if _broken(_pkt):
            return JointStreamBroken
        return JointStreamState if _pkt[5] == STATE else JointStreamCommand


class JointStreamState(JointStream):
    """Arm to client."""

    fields_desc = [
        *_header(STATE, HOLD),
        LEIntField("taken", 0),
        DoubleField("cycle_s", 0.004),
        *map(_per_joint, STATE_LISTS),
        DoublesField("tcp_pose", [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], lambda _: 7),
        DoublesField("wrench", [0.0] * 6, lambda _: 6),
        FieldLenField("reason_bytes", None, length_of="reason", fmt="B"),
        StrLenField("reason", b"", length_from=lambda pkt: pkt.reason_bytes),
    ]

    @property
    def lists(self) -> tuple[str, ...]:
        """Names of the fields with a value per joint."""
        return STATE_LISTS


class JointStreamCommand(JointStream):
    """Client to arm."""

    fields_desc = [
        *_header(COMMAND, HOLD),
        *map(_in_modes_with, ("positions", "speeds", "torques")),
    ]

    @property
    def lists(self) -> tuple[str, ...]:
        """Names of the fields with a value per joint, by mode."""
        return COMMAND_LISTS.get(self.mode, ())


class JointStreamBroken(JointStream):
    """Bytes that are neither, with the `reason`."""

    fields_desc = [StrField("data", b"")]

    @property
    def reason(self) -> str:
        """Fault of the header or the length."""
        return _broken(self.data) or ""


def _broken(data: bytes) -> str | None:
    """Return why `data` has no layout; None if it has one. Few different texts, for counting."""
    if not data:
        return "empty datagram"
    if not data.startswith(MAGIC):
        return f"does not begin with {MAGIC.decode()}"
    if len(data) < HEADER_BYTES:
        return "shorter than its header"
    version, kind, mode, joints = data[4:8]
    for value, name, allowed in (
        (version, "version", (VERSION,)),
        (kind, "kind", KINDS),
        (mode, "mode", MODES),
        (joints, "number of joints", range(1, MOST_JOINTS + 1)),
    ):
        if value not in allowed:
            return f"{name} {value}"
    if kind == COMMAND:
        size = HEADER_BYTES + 8 * joints * len(COMMAND_LISTS[mode])
    else:
        size = STATE_BYTES + 8 * joints * len(STATE_LISTS)
        if len(data) >= size:
            size += data[size - 1]
    if len(data) == size:
        return None
    return f"a {KINDS[kind]} too {'short' if len(data) < size else 'long'}"


def malformed(layer: Packet) -> str | None:
    """Return why a dissected datagram is not one of the joint stream; None if it is."""
    if isinstance(layer, JointStreamBroken):
        return layer.reason
    return next(_wrong_values(layer), None)


def _wrong_values(layer: Packet) -> Iterator[str]:
    for field in layer.fields_desc:
        if not isinstance(layer.getfieldval(field.name), float | list):
            continue
        value = getattr(layer, field.name)  # None if a command's mode has no such field.
        values = value if isinstance(value, list) else () if value is None else (value,)
        if not all(map(math.isfinite, values)):
            yield f"{field.name} not finite"
    if isinstance(layer, JointStreamState):
        if layer.cycle_s <= 0.0:
            yield "cycle_s not above 0"
        if abs(math.hypot(*layer.tcp_pose[3:]) - 1.0) > QUATERNION_NORM_TOLERANCE:
            yield "orientation no unit quaternion"
        try:
            layer.reason.decode()
        except UnicodeDecodeError:
            yield "reason not UTF-8"


bind_bottom_up(UDP, JointStream, dport=JOINT_STREAM_PORT)
bind_bottom_up(UDP, JointStream, sport=JOINT_STREAM_PORT)
bind_top_down(UDP, JointStreamCommand, dport=JOINT_STREAM_PORT)
bind_top_down(UDP, JointStreamState, sport=JOINT_STREAM_PORT)
