"""Protocols with a message in each UDP datagram."""

from __future__ import annotations

from collections.abc import Sequence

from cardan.dissect.network import Endpoint, Segment
from cardan.dissect.ports import EGM_PORTS, JOINT_STREAM_PORT
from cardan.dissect.reader import DatagramDissector, Decoded, Message, Numbers
from cardan.protocols import egm, joint_stream

ROBOT_TYPES = (egm.MessageType.DATA,)
PC_TYPES = (egm.MessageType.CORRECTION, egm.MessageType.PATH_CORRECTION)


class Egm(DatagramDissector):
    """ABB's Externally Guided Motion, on UDP ports."""

    name = "EGM"
    page = "protocols/egm.md"
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

    def decode(self, segment: Segment) -> Decoded | None:
        ports = self.numbers["egm_ports"]
        to_pc, from_pc = segment.destination.port in ports, segment.source.port in ports
        if not to_pc and not from_pc:
            return None
        value: egm.EgmRobot | egm.EgmSensor | egm.EgmSensorPathCorr | egm.Malformed
        value, title = egm.decode_robot(segment.payload), "EgmRobot"
        # The controller's local port may be one of the ports, too.
        if not to_pc or (from_pc and isinstance(value, egm.Malformed)):
            value, title = egm.decode_from_pc(segment.payload), "EGM from the PC"
        if isinstance(value, egm.Malformed):
            return Decoded(None, title, f"{value.fault.value}: {value.detail}")
        if value.header is None:
            return Decoded(value)
        seqno, tm_ms = value.header.seqno, value.header.tm_ms or None
        if isinstance(value, egm.EgmRobot):
            return Decoded(value, sequence=seqno, asks=tm_ms)
        return Decoded(value, sequence=seqno, answers=tm_ms)

    def recognised(self, messages: Sequence[Message], end: Endpoint, other: Endpoint) -> str:
        for message in messages:
            value = message.decoded.value
            header = value.header
            if header is None or None in (header.seqno, header.tm_ms):
                return ""
            robots = isinstance(value, egm.EgmRobot)
            if robots != (message.where == f"{other} > {end}"):
                return ""
            if header.mtype not in (ROBOT_TYPES if robots else PC_TYPES):
                return ""
            if robots and (value.feed_back is None or value.feed_back.joints is None):
                return ""
        return f"the robot at {other}"


class JointStream(DatagramDissector):
    """The simulated arm's joint stream, on its UDP port or any other by its mark."""

    name = "joint stream"
    page = "protocols/joint-stream.md"

    def decode(self, segment: Segment) -> Decoded | None:
        data = segment.payload
        ports = {segment.source.port, segment.destination.port}
        if JOINT_STREAM_PORT not in ports and not data.startswith(joint_stream.MAGIC):
            return None
        state, command = joint_stream.decode_state(data), joint_stream.decode_command(data)
        value = command if joint_stream.is_command(data) else state
        if isinstance(value, joint_stream.Malformed):
            return Decoded(None, "joint stream", value.reason)
        if isinstance(value, joint_stream.ArmCommand):
            return Decoded(value, sequence=value.sequence, asks=value.sequence)
        return Decoded(value, sequence=value.sequence, answers=value.acknowledged or None)
