"""Robots' protocols: EGM, simple message, the joint stream, and the sessions that speak them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import cache
from typing import Any

from cardan.drivers.abb_egm import AbbEgmOptions, EgmSession
from cardan.drivers.motoros.connections import CHANNELS
from cardan.drivers.motoros.io_client import (
    IoConnectionError,
    IoExchange,
    IoRefusedError,
    read_bit,
    read_register,
)
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.session import MotorosSession
from cardan.drivers.sim_arm.options import SimArmOptions
from cardan.drivers.sim_arm.session import SimArmSession
from cardan.protocols.egm.decode import decode_feedback, decode_from_pc, decode_robot
from cardan.protocols.egm.encode import encode_path_corr, encode_robot, encode_sensor
from cardan.protocols.egm.messages import (
    EgmCollisionInfo,
    EgmFeedback,
    EgmHeader,
    EgmMeasuredForce,
    EgmMessageType,
    EgmMotion,
    EgmPose,
    EgmRapidData,
    EgmRobot,
    EgmSensor,
    EgmSensorPathCorr,
    EgmSpeedRef,
    MCIState,
    MotorState,
    RapidState,
)
from cardan.protocols.egm.reader import FeedbackReader
from cardan.protocols.joint_stream import codec as js
from cardan.protocols.simple_message import codec, io_addresses, messages
from cardan.protocols.simple_message.codec import detect_wire
from cardan.protocols.simple_message.codes import MessageType
from cardan.protocols.simple_message.framing import ByteOrder, FrameReader
from cardan.protocols.simple_message.messages import Message, ReadIoReply
from cardan.types import HoldCommand, Quaternion, RobotLink, Vector3
from fuzz.target import Form, Target
from fuzz.targets.common import near, pieces_of, same
from tests.drivers.motoros_bench import SessionBench
from tests.protocols import worked

# -- EGM ------------------------------------------------------------------------------------------

_POSE = EgmPose(Vector3(0.6, 0.0, 0.8), Quaternion(0.5, 0.0, 0.866, 0.0), None)
_SIX = (0.0, 0.1, -0.2, 0.0, 0.5, 0.0)
_MOTION = EgmMotion(_SIX, _POSE, (0.1,), 1_700_000_000_000_000, None)


def egm_state(seqno: int, **changed: Any) -> bytes:
    """A controller's datagram."""
    fields: dict[str, Any] = {
        "header": EgmHeader(seqno, 4 * seqno, EgmMessageType.DATA),
        "feed_back": _MOTION,
        "planned": _MOTION,
        "motor_state": MotorState.ON,
        "mci_state": MCIState.RUNNING,
        "mci_convergence_met": True,
        "rapid_exec_state": RapidState.RUNNING,
        **changed,
    }
    return encode_robot(EgmRobot(**fields))


def _robots() -> Iterator[bytes]:
    yield egm_state(1)
    yield egm_state(
        300,
        test_signals=_SIX,
        measured_force=EgmMeasuredForce((1.0, 2.0, 3.0, 0.1, 0.2, 0.3), True),
        utilization_rate=12.5,
        move_index=1,
        collision_info=EgmCollisionInfo(False, _SIX),
        rapid_from_robot=EgmRapidData(True, (1.0, 2.0)),
        torque_ref=_SIX,
    )
    yield egm_state(5, header=None, planned=None)
    yield from (worked.R0, worked.R1, worked.R0 + worked.F6, worked.R0 + worked.F7)


def _sensors() -> Iterator[bytes]:
    header = EgmHeader(7, 28, EgmMessageType.CORRECTION)
    speed = EgmSpeedRef(_SIX, None, ())
    yield encode_sensor(EgmSensor(header, _MOTION, None, None))
    yield encode_sensor(EgmSensor(header, _MOTION, speed, EgmRapidData(None, (1.0,))))
    path = EgmHeader(8, 32, EgmMessageType.PATH_CORRECTION)
    yield encode_path_corr(EgmSensorPathCorr(path, Vector3(0.0, 0.0025, -0.001), 1))
    yield from (worked.S1, worked.S2, worked.S3, worked.S4, worked.C1)


def _egm_robot(data: bytes) -> object:
    whole, part = decode_robot(data), decode_feedback(data)
    if isinstance(whole, EgmRobot):
        again = decode_robot(encode_robot(whole))
        near(again, whole)
        if isinstance(part, EgmFeedback):
            assert whole.header is not None
            assert part.seqno == whole.header.seqno
    reader = FeedbackReader()
    for _ in range(3):  # The reader learns the form of a datagram.
        found = reader.read(data)
        same(found, part)
    return whole


def _egm_from_pc(data: bytes) -> object:
    found = decode_from_pc(data)
    if isinstance(found, EgmSensor):
        again = decode_from_pc(encode_sensor(found))
        near(again, found)
    elif isinstance(found, EgmSensorPathCorr):
        again = decode_from_pc(encode_path_corr(found))
        near(again, found)
    return found


_PEER, _OTHER = ("192.0.2.1", 6511), ("192.0.2.9", 6511)


def _egm_session(packets: tuple[bytes, ...]) -> object:
    """Garbage, then a good datagram: it is answered."""
    now_s = 100.0
    session = EgmSession(AbbEgmOptions(), now_s, _PEER[0])
    for number, data in enumerate(packets):
        now_s += 0.004
        state = session.receive(data, _PEER if number % 5 else _OTHER, now_s)
        if state is not None:
            session.reply(HoldCommand(), now_s)
        session.diagnosis(now_s)
    now_s += 10.0  # The garbage may have been a controller's; it has fallen silent.
    session.tick(now_s)
    for number in range(3):
        now_s += 0.004
        state = session.receive(egm_state(70_000 + number), _PEER, now_s)
    assert state is not None, session.diagnosis(now_s)
    session.metrics()
    return tuple(session.diagnosis(now_s))


def _egm_packets() -> Iterator[tuple[bytes, ...]]:
    yield tuple(egm_state(number) for number in range(1, 9))
    yield (egm_state(1), b"", b"\x00" * 40, egm_state(2), egm_state(2), egm_state(1))


# -- simple message -------------------------------------------------------------------------------


@cache
def _messages() -> tuple[bytes, ...]:
    """Messages of every type, with every body that it has, of zeros, and worked ones."""
    found = []
    for msg_type, bodies in messages.BODIES.items():
        sizes = []
        for size in range(0, 1024, 4):
            data = struct.pack("<4i", 12 + size, msg_type, 1, 0) + bytes(size)
            if isinstance(codec.wire().decode(data), Message):
                sizes.append(data)
        found += sizes[: len(bodies) + 1]
    names = ("START_TRAJ_MODE", "START_TRAJ_MODE_REPLY", "SERVO_OFF_REPLY", "TRAJECTORY_POINT")
    names += ("BUSY_REPLY", "FEEDBACK", "STATUS_READY", "STATUS_ESTOP", "PING_REQUEST")
    names += ("PING_REPLY", "JOINT_VELOCITY", "RT_COMMAND")
    return (*found, *(getattr(worked, name) for name in names))


def _simple_message(data: bytes) -> object:
    result: object = None
    for order in ByteOrder:
        for real_bytes in (4, 8):
            wire = codec.wire(order, real_bytes)
            result = wire.decode(data)
            wire.decode_datagram(data)
            if isinstance(result, Message):
                again = wire.decode(wire.encode(result))
                same(again, result)
                return result
    detect_wire(data)
    return result


def _simple_message_stream(data: bytes) -> object:
    """A stream means the same whatever pieces it comes in."""

    def frames(pieces: list[bytes]) -> tuple[object, ...]:
        reader = FrameReader()
        found = []
        for piece in pieces:
            reader.feed(piece)
            while (frame := reader.take()) is not None:
                found.append(frame)
                assert len(frame) <= 4 + 0xFFFF
        assert reader.pending_bytes <= len(data)
        return (*found, reader.failure, reader.byte_order)

    whole = frames([data])
    same(frames(pieces_of(data)), whole)
    failure = whole[-2]
    return len(whole) > 2, bool(failure), str(whole[-1])


def _streams() -> Iterator[bytes]:
    good = _messages()
    yield b"".join(good[:8])
    yield b"".join(reversed(good[-12:]))
    yield struct.pack(">4i", 12, 1, 2, 0) * 5
    for each in good[-12:]:
        yield each + worked.PING_REQUEST


def _io_exchange(packets: tuple[bytes, ...]) -> object:
    exchange = IoExchange(ByteOrder.LITTLE)
    asked = exchange.ask(read_bit(io_addresses.ADDRESS_RANGES[0].first))
    assert asked
    result = None
    for data in packets:
        result = exchange.receive(data)
        if result is not None:
            assert 0 <= result <= 1
            exchange.ask(read_register(1))
            break
    return result


def _io_replies() -> Iterator[tuple[bytes, ...]]:
    wire = codec.wire()
    types = MessageType
    for value in (0, 1, 2):
        body = ReadIoReply(value, 0)
        reply = wire.encode(Message(types.MOTO_READ_IO_BIT_REPLY, 3, 1, body))
        yield (reply,)
        yield (reply[:7], reply[7:])
    yield (wire.encode(Message(types.MOTO_READ_IO_BIT_REPLY, 3, 2, ReadIoReply(0, 1001))),)


@cache
def _bench_packets() -> tuple[tuple[bytes, ...], ...]:
    """Packets that a simulated controller sends a session, each after a byte for its channel."""
    found = []
    for mode in ("velocity", "stream"):
        bench = SessionBench({"mode": mode})
        said: list[bytes] = []
        taken = bench.session.received

        def received(
            channel: Any, data: bytes, now_s: float, taken: Any = taken, said: Any = said
        ) -> None:
            if len(said) < 48 and (channel == "motion" or len(said) % 3 == 0 or len(said) < 6):
                said.append(bytes([CHANNELS.index(channel)]) + data)
            taken(channel, data, now_s)

        bench.session.received = received  # type: ignore[method-assign]
        bench.run(0.4)
        bench.session.enable(bench.now_s)
        bench.run(0.6)
        found.append(tuple(said))
    return tuple(found)


def _motoros_session(packets: tuple[bytes, ...]) -> object:
    """A session drops what it cannot trust, connects again, and hears a good controller."""
    now_s = 100.0
    session = MotorosSession(MotorosOptions())

    def step() -> None:
        session.advance(now_s)
        session.closing()
        session.outgoing()
        for channel in CHANNELS:
            if session.wants(channel, now_s):
                session.connected(channel, now_s)
        if (state := session.due_state(now_s)) is not None:
            session.command(HoldCommand(), now_s)
            assert state.link in RobotLink

    step()
    for number, packet in enumerate(packets):
        now_s += 0.004
        step()
        if number == 3:
            session.enable(now_s)
        if packet:
            session.received(CHANNELS[packet[0] & 1], packet[1:], now_s)
    diagnosis = session.diagnosis(now_s)
    session.metrics(now_s)
    now_s += 30.0
    session.disconnected("state", "closed", now_s)
    for _ in range(4):
        now_s += 5.0
        step()
    for _ in range(4):
        session.received("state", worked.STATUS_READY + worked.FEEDBACK, now_s)
        now_s += 0.01
        step()
    assert session.feed.live(now_s), session.diagnosis(now_s)
    return tuple(diagnosis)


# -- joint stream ---------------------------------------------------------------------------------


def arm_state(sequence: int, session: int = 1, joints: int = 6) -> js.ArmState:
    """A state of an arm at rest."""
    zeros = (0.0,) * joints
    mode = js.ControlMode.POSITION
    pose = (0.4, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0)
    return js.ArmState(
        session, sequence, 0.004 * sequence, mode, 0, 0.004, zeros, zeros, zeros, pose, (0.0,) * 6
    )


def _joint_stream(data: bytes) -> object:
    state, command = js.decode_state(data), js.decode_command(data)
    if isinstance(state, js.ArmState):
        same(js.decode_state(js.encode_state(state)), state)
        return state
    if isinstance(command, js.ArmCommand):
        joints = data[7]
        same(js.decode_command(js.encode_command(command, joints)), command)
    return command, state


def _joint_stream_seeds() -> Iterator[bytes]:
    yield js.encode_state(arm_state(7))
    yield js.encode_state(arm_state(7, joints=7)._replace(reason="emergency stop"))
    modes = js.ControlMode
    yield js.encode_command(js.ArmCommand(1, 5, 2.0, modes.HOLD), 6)
    yield js.encode_command(js.ArmCommand(1, 5, 2.0, modes.POSITION, (0.1,) * 6, (0.2,) * 6), 6)
    yield js.encode_command(js.ArmCommand(1, 5, 2.0, modes.TORQUE, (1.0,) * 7), 7)


def _sim_arm_session(packets: tuple[bytes, ...]) -> object:
    now_s = 100.0
    session = SimArmSession(SimArmOptions(robot="ur5"))
    for data in packets:
        now_s += 0.004
        if session.receive(data, now_s) is not None:
            session.command(HoldCommand(), now_s)
        session.diagnosis(now_s)
    now_s += 60.0
    session.keepalive(now_s)
    data = js.encode_state(arm_state(1, session=(1 << 31) + 5))
    assert session.receive(data, now_s) is not None, session.diagnosis(now_s)
    session.metrics()
    return tuple(session.diagnosis(now_s))


def _sim_arm_packets() -> Iterator[tuple[bytes, ...]]:
    yield tuple(js.encode_state(arm_state(number)) for number in range(1, 6))
    yield (js.encode_state(arm_state(1)), js.encode_state(arm_state(1, session=2)), b"")


TARGETS = (
    Target("egm.robot", Form.BYTES, _egm_robot, _robots, longest=2048),
    Target("egm.from_pc", Form.BYTES, _egm_from_pc, _sensors, longest=2048),
    Target("egm.session", Form.PACKETS, _egm_session, _egm_packets, longest=8192),
    Target("simple_message.codec", Form.BYTES, _simple_message, _messages, longest=2048),
    Target(
        "simple_message.stream",
        Form.BYTES,
        _simple_message_stream,
        _streams,
        words=(worked.PING_REQUEST, worked.FEEDBACK),
        longest=65536,
    ),
    Target(
        "motoros.io",
        Form.PACKETS,
        _io_exchange,
        _io_replies,
        raises=(IoConnectionError, IoRefusedError),
        longest=2048,
    ),
    Target("motoros.session", Form.PACKETS, _motoros_session, _bench_packets, slow_s=0.3),
    Target("joint_stream.codec", Form.BYTES, _joint_stream, _joint_stream_seeds, longest=2048),
    Target("sim_arm.session", Form.PACKETS, _sim_arm_session, _sim_arm_packets, longest=4096),
)
