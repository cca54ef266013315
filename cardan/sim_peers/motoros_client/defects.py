"""Filter between a client of MotoROS and its connections that alters its messages and hides
received ones as a client with these defects would."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from cardan.protocols.simple_message.codec import wire
from cardan.protocols.simple_message.codes import (
    CommType,
    ControllerMode,
    InvalidSubcode,
    MessageType,
    MotionCommand,
    MotionResult,
    ValidFields,
)
from cardan.protocols.simple_message.framing import ByteOrder, FrameReader
from cardan.protocols.simple_message.messages import (
    Empty,
    Joints,
    JointTrajPtFull,
    JointVelocity,
    Message,
    MotionCtrl,
    MotionReply,
    RobotStatus,
    VelocityInfo,
    VelocityInfoRequest,
    joints10,
    reply,
    request,
)
from cardan.robots import ArmModel
from cardan.sim_peers.base import strikes

PIECE_S = 1e-3
OWN_SEQUENCE = 987_654
"""Sequence number of requests that the filter adds."""
DOZES_EVERY_S = 0.5
STATE_S = 0.025
JUMP_EVERY, STARVES_EVERY = 50, 25
STARTS = (MotionCommand.START_TRAJ_MODE, MotionCommand.START_VEL_MODE)
STOPS = (MotionCommand.STOP_TRAJ_MODE, MotionCommand.STOP_VEL_MODE)
TRUSTING = ("blind", "no-start", "takes-no-for-yes")
"""Faults of clients that ignore the status too."""


class Sent(NamedTuple):
    """Bytes that reach the controller in place of a message of the client."""

    data: bytes
    late_s: float | None = None
    """Delay of the arrival at the controller; None: at once."""
    pretended: bool = False
    """The client continues as after this answer, without a request."""


class MotorosClientDefects:
    """Defects of one client. Times that it gets, s, never go back."""

    def __init__(self, faults: Mapping[str, float], arm: ArmModel) -> None:
        """`faults`: values of `FAULTS`, by their names. `arm`: the arm that is moved."""
        self._faults = faults
        self._arm = arm
        self._requests = self._commands = self._sent = 0
        self._pending: Message | None = None
        """Open request, for clients that take any reply for its answer."""
        self._pending_s = math.inf
        self._point: JointTrajPtFull | None = None
        self._states: dict[int, Message] = {}
        self._heard_s, self._repeated_s = math.inf, 0.0

    # -- what the controller says -----------------------------------------------------------------

    def ignores_read(self, data: bytes) -> bool:
        """Return True if the client ignores the data of one read."""
        if "one-read" not in self._faults:
            return False
        found = FrameReader()
        found.feed(data)
        return found.take() is None or bool(found.pending_bytes)

    def heard(self, message: Message, is_state: bool, now_s: float) -> Message | None:
        """Return the message as the client reads it; None: the client does not see it."""
        found = self._believed(message)
        if found is not None and is_state:
            self._states[found.msg_type], self._heard_s = found, now_s
        return found

    def _believed(self, message: Message) -> Message | None:
        faults, body = self._faults, message.body
        if isinstance(body, RobotStatus) and any(name in faults for name in TRUSTING):
            well = body._replace(
                drives_powered=1,
                e_stopped=0,
                in_error=0,
                mode=int(ControllerMode.AUTO),
                motion_possible=1,
            )
            return message._replace(body=well)
        if isinstance(body, RobotStatus) and "hasty" in faults:
            return message._replace(body=body._replace(in_motion=0))
        if not isinstance(body, MotionReply):
            return message
        if body.sequence == OWN_SEQUENCE or (body.command == 0 and "unknown-command" in faults):
            return None
        asked, self._pending, self._pending_s = self._pending, None, math.inf
        if asked is None and "impatient" in faults:
            return None
        first = body.sequence == 0 and body.subcode == InvalidSubcode.DATA_START_POS
        refused = body.result == MotionResult.NOT_READY
        believes = (
            ("skips-busy" in faults and body.result == MotionResult.BUSY)
            or ("skips-first" in faults and first)
            or ("blind" in faults and refused and body.command not in STARTS)
            or ("takes-no-for-yes" in faults and refused and body.command in STARTS)
            or ("nan" in faults and body.result == MotionResult.INVALID)
        )
        if believes:
            body = body._replace(result=int(MotionResult.SUCCESS), subcode=0)
        if "skips-busy" in faults and body.command == MotionCommand.CHECK_QUEUE_CNT:
            body = body._replace(subcode=max(body.subcode, 1))
        if "credulous" in faults and asked is not None:
            wanted = asked.body
            command = wanted.command if isinstance(wanted, MotionCtrl) else asked.msg_type
            sequence = getattr(wanted, "sequence", body.sequence)
            body = body._replace(
                command=command, sequence=sequence, result=int(MotionResult.SUCCESS)
            )
        return message._replace(body=body)

    def states_again(self, now_s: float) -> tuple[Message, ...]:
        """Return the states that the client takes for new ones although none arrive."""
        if "deaf" not in self._faults or now_s <= max(self._heard_s, self._repeated_s) + STATE_S:
            return ()
        self._repeated_s = now_s
        return tuple(self._states.values())

    # -- what the client says ---------------------------------------------------------------------

    def connected(self, port: str, order: ByteOrder) -> Iterator[Sent]:
        """Yield the first messages of the client on a new connection to a port."""
        self._pending = None
        if port == "state" and "talks-to-states" in self._faults:
            yield from self._written(request(Empty(), MessageType.PING), order)
        if port == "motion" and "unknown-command" in self._faults:
            command = int(self._faults["unknown-command"])
            yield from self._own(command, order)

    def _own(self, command: int, order: ByteOrder) -> Iterator[Sent]:
        return self._written(request(MotionCtrl(0, OWN_SEQUENCE, command)), order)

    def asked_again(self, order: ByteOrder, now_s: float) -> Iterator[Sent]:
        """Repeat the open request, if the client stops waiting for its answer."""
        again_s = 1e-3 * self._faults.get("impatient", math.inf)
        if self._pending is not None and now_s > self._pending_s + again_s:
            self._pending_s = now_s
            yield from self._written(self._pending, order)

    def said(
        self, message: Message, order: ByteOrder, leaves: bool, now_s: float
    ) -> Iterator[Sent]:
        """Yield the bytes sent in place of a message; `leaves`: the client is about to end."""
        faults, body = self._faults, message.body
        if isinstance(body, MotionCtrl):
            command = body.command
            left_out = (
                ("no-stop" in faults and command == MotionCommand.STOP_MOTION)
                or ("no-start" in faults and command in STARTS)
                or ("leaves-mode-on" in faults and leaves and command in STOPS)
            )
            if left_out:
                yield _success(body, command, order)
                return
            if command == MotionCommand.START_VEL_MODE and "watchdog" in faults:
                body = body._replace(data=joints10((faults["watchdog"], *body.data[1:])))
        elif isinstance(body, VelocityInfoRequest) and "no-info" in faults:
            yield _pretended(self._info(), order)
            return
        elif isinstance(body, JointTrajPtFull):
            body = self._spoilt_point(body)
        elif isinstance(body, JointVelocity):
            if body.sequence and _asleep(now_s, 1e-3 * faults.get("dozes", 0.0)):
                if message.comm_type == CommType.SERVICE_REQUEST:
                    yield _success(body, MessageType.MOTO_JOINT_VELOCITY, order)
                return
            body = self._spoilt_speeds(body)
        comm_type = message.comm_type
        asks = comm_type == CommType.SERVICE_REQUEST
        if asks:
            comm_type = int(CommType.TOPIC) if "topics" in faults else comm_type
            # The awaited reply is that to the message of the client.
            self._pending, self._pending_s = message, now_s
            self._requests += 1
        yield from self._written(message._replace(comm_type=comm_type, body=body), order)
        if asks and strikes(faults, "pipelines", self._requests):
            yield from self._own(MotionCommand.CHECK_MOTION_READY, order)

    def _info(self) -> VelocityInfo:
        """Return the velocity-mode limits that a controller of this arm would report."""
        arm, joints = self._arm, len(self._arm.joints)
        accelerations = joints10(joint.acceleration for joint in arm.joints)
        limits = (joints10(arm.velocity), accelerations, joints10(arm.lower))
        return VelocityInfo(1, 4000, 100, 0, 1, joints, *limits, joints10(arm.upper))

    def _spoilt_point(self, point: JointTrajPtFull) -> JointTrajPtFull:
        faults = self._faults
        before, self._point = self._point, point
        if before is None or before.sequence != point.sequence:
            self._commands += 1
        first = point.sequence == 0
        pos, vel = point.pos, point.vel
        if first and "starts-off" in faults:
            pos = _shifted(pos, faults["starts-off"])
        if first and "starts-moving" in faults:
            vel = _shifted(vel, faults["starts-moving"])
        jump = self._commands % JUMP_EVERY == 0 and not first
        if jump:
            pos = _shifted(pos, faults.get("jump", 0.0) + faults.get("out-of-range", 0.0))
        if strikes(faults, "nan", self._commands):
            vel = _shifted(vel, math.nan)
        point = point._replace(pos=pos, vel=vel)
        if "fields" in faults:
            point = point._replace(valid_fields=int(faults["fields"]))
        if before is not None and not first and before.sequence + 1 == point.sequence:
            if strikes(faults, "sequence", self._commands):
                point = point._replace(sequence=max(1, before.sequence))
            if strikes(faults, "time-stands", self._commands):
                point = point._replace(time=before.time)
        return point

    def _spoilt_speeds(self, body: JointVelocity) -> JointVelocity:
        faults, vel, sequence = self._faults, body.vel, body.sequence
        self._commands += 1
        if not sequence and "starts-moving" in faults:
            vel = _shifted(vel, faults["starts-moving"])
        if sequence and self._commands % JUMP_EVERY == 0:
            vel = _shifted(vel, faults.get("jump", 0.0))
        if strikes(faults, "nan", self._commands):
            vel = _shifted(vel, math.nan)
        if sequence > 1 and strikes(faults, "sequence", self._commands):
            sequence -= 1
        fields = body.valid_fields
        if "fields" in faults:
            fields = int(faults["fields"]) & ~ValidFields.VELOCITY
        return body._replace(vel=vel, sequence=sequence, valid_fields=fields)

    def _written(self, message: Message, order: ByteOrder) -> Iterator[Sent]:
        """Yield a message in the form that the client writes it."""
        if "other-order" in self._faults:
            order = ByteOrder.BIG if order is ByteOrder.LITTLE else ByteOrder.LITTLE
        data = wire(order).encode(message)
        self._sent += 1
        if strikes(self._faults, "truncated", self._sent):
            word = "little" if order is ByteOrder.LITTLE else "big"
            data = (len(data) - 8).to_bytes(4, word) + data[4:-4]  # type: ignore[arg-type]
        late_s = 1e-3 * self._faults.get("starves", 0.0)
        point = isinstance(message.body, JointTrajPtFull)
        if late_s and point and self._commands % STARVES_EVERY == 0:
            yield Sent(data, late_s)
        elif strikes(self._faults, "pieces", self._sent):
            yield Sent(data[:10])
            yield Sent(data[10:], PIECE_S)
        else:
            yield Sent(data)


def _pretended(body: MotionReply | VelocityInfo, order: ByteOrder) -> Sent:
    return Sent(wire(order).encode(reply(body)), pretended=True)


def _success(body: MotionCtrl | JointVelocity, command: int, order: ByteOrder) -> Sent:
    """Return a success answer to an order that the controller never got."""
    done = MotionReply(body.group, body.sequence, command, MotionResult.SUCCESS, 0)
    return _pretended(done, order)


def _shifted(values: Joints, by: float) -> Joints:
    """Return the values with the first joint shifted by `by`."""
    return (values[0] + by, *values[1:])


def _asleep(now_s: float, for_s: float) -> bool:
    """Return True if a client is asleep that sleeps for `for_s` every DOZES_EVERY_S."""
    return for_s > 0.0 and now_s % DOZES_EVERY_S < for_s
