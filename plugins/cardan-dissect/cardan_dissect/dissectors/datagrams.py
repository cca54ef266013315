"""Protocols with a message in each UDP datagram."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple, TypeAlias

from cardan.protocols.egm.decode import decode_from_pc, decode_robot
from cardan.protocols.egm.messages import (
    EgmMessageType,
    EgmRobot,
    EgmSensor,
    EgmSensorPathCorr,
    MalformedEgmMessage,
)
from cardan.protocols.joint_stream import codec as joint_stream
from cardan_dissect.dissectors.egm_outline import Outline, outline
from cardan_dissect.network import Endpoint, Segment
from cardan_dissect.ports import EGM_PORTS, JOINT_STREAM_PORT
from cardan_dissect.reader import DatagramDissector, Decoded, Message, Numbers, value_of

ROBOT_TYPES = (EgmMessageType.DATA,)
PC_TYPES = (EgmMessageType.CORRECTION, EgmMessageType.PATH_CORRECTION)

_new = tuple.__new__

MOST_KNOWN = 1024
"""Most outlines of EGM datagrams that are kept."""

_Decode: TypeAlias = Callable[
    [bytes], EgmRobot | EgmSensor | EgmSensorPathCorr | MalformedEgmMessage
]


class Egm(DatagramDissector):
    """ABB's Externally Guided Motion, on UDP ports."""

    name = "EGM"
    page = "abb-egm.md"
    options = (
        Numbers(
            "egm_ports",
            "port",
            "PORT",
            "Another UDP port of EGM",
            "UDP port",
            usual=frozenset(EGM_PORTS),
        ),
    )

    def __init__(self, numbers: Mapping[str, frozenset[int]]) -> None:
        super().__init__(numbers)
        self._known: dict[tuple[Endpoint, Endpoint, int], _Known | None] = {}
        """By sender, receiver and length; None if it is too unusual to learn."""

    def decode(self, segment: Segment) -> Decoded | None:
        data = segment.payload
        key = segment.source, segment.destination, len(data)
        known = self._known.get(key)
        if known is not None and not segment.cut:
            header = known.outline.header(data)
            if header is not None:
                seqno, clock = header[0], header[1] or None
                asks, answers = (clock, None) if known.title == "EgmRobot" else (None, clock)
                later = partial(known.decode, data)
                return _new(Decoded, (later, known.title, "", seqno, asks, answers, ()))
        ports = self.numbers["egm_ports"]
        to_pc, from_pc = segment.destination.port in ports, segment.source.port in ports
        if not to_pc and not from_pc:
            return None
        decode: _Decode = decode_robot if to_pc else decode_from_pc
        value = decode(data)
        # The controller's local port may be one of the ports too.
        if to_pc and from_pc and isinstance(value, MalformedEgmMessage):
            decode = decode_from_pc
            value = decode(data)
        if isinstance(value, MalformedEgmMessage):
            title = "EgmRobot" if decode is decode_robot else "EGM from the PC"
            return Decoded(None, title, f"{value.fault.value}: {value.detail}")
        if known is not None or key not in self._known:
            if len(self._known) >= MOST_KNOWN:
                self._known.clear()
            found = outline(data, value)
            self._known[key] = found and _Known(found, type(value).__name__, decode)
        if value.header is None:
            return Decoded(value)
        number, tm_ms = value.header.seqno, value.header.tm_ms or None
        if isinstance(value, EgmRobot):
            return Decoded(value, sequence=number, asks=tm_ms)
        return Decoded(value, sequence=number, answers=tm_ms)

    def recognized(self, messages: Sequence[Message], end: Endpoint, other: Endpoint) -> str:
        for message in messages:
            value = value_of(message.decoded)
            header = value.header
            if header is None or None in (header.seqno, header.tm_ms):
                return ""
            robots = isinstance(value, EgmRobot)
            if robots != (message.where == f"{other} > {end}"):
                return ""
            if header.mtype not in (ROBOT_TYPES if robots else PC_TYPES):
                return ""
            if robots and (value.feed_back is None or value.feed_back.joints is None):
                return ""
        return f"the robot at {other}"


class _Known(NamedTuple):
    """Title and decoder of the datagrams with this outline."""

    outline: Outline
    title: str
    decode: _Decode


class JointStream(DatagramDissector):
    """The simulated arm's joint stream, on its UDP port or any other by its mark."""

    name = "joint stream"
    page = "simulated-peers.md"

    def decode(self, segment: Segment) -> Decoded | None:
        data = segment.payload
        ports = {segment.source.port, segment.destination.port}
        if JOINT_STREAM_PORT not in ports and not data.startswith(joint_stream.MAGIC):
            return None
        state, command = joint_stream.decode_state(data), joint_stream.decode_command(data)
        value = command if joint_stream.is_command(data) else state
        if isinstance(value, joint_stream.MalformedDatagram):
            return Decoded(None, "joint stream", value.reason)
        if isinstance(value, joint_stream.ArmCommand):
            return Decoded(value, sequence=value.sequence, asks=value.sequence)
        return Decoded(value, sequence=value.sequence, answers=value.acknowledged or None)
