"""Our own driver, with the defects it is told to have, and a scenario in virtual time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from cardan.conform.motoros_driver.faults import FAULTS
from cardan.conform.rigs import LOOK_S, DriverRig
from cardan.conform.runner import Exchange
from cardan.conform.timeline import Kind
from cardan.drivers.motoros.connections import CHANNELS, Channel
from cardan.drivers.motoros.motion_control import MotionPhase
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.session import MotorosSession
from cardan.protocols import simple_message as sm
from cardan.robots import load_arm
from cardan.types import HoldCommand, JointVelocityCommand, RobotCommand, RobotState

NETWORK_S = 1e-4
"""How long a piece is on its way, each way."""
PIECE_S = 1e-3
OPTIONS = MotorosOptions()
SPEED_RAD_S = 0.1
SWING_S = 1.0
OWN_SEQUENCE = 987_654
"""Of requests that the driver's core knows nothing of."""
DOZES_EVERY_S = 0.5
STATE_S = 0.025
LEAP_EVERY, STARVES_EVERY = 50, 25
STARTS = (sm.MotionCommand.START_TRAJ_MODE, sm.MotionCommand.START_VEL_MODE)
STOPS = (sm.MotionCommand.STOP_TRAJ_MODE, sm.MotionCommand.STOP_VEL_MODE)
TRUSTING = ("blind", "no-start", "takes-no-for-yes")
"""Faults of drivers that do not look at the status either."""


class MotorosDriverRig(DriverRig):
    """Joins the driver's core to the scenario, spoils what it says and hides from it what it hears,
    as a driver with these defects would have it."""

    def __init__(
        self,
        exchange: Exchange,
        faults: Mapping[str, float],
        seed: int = 0,
        options: MotorosOptions = OPTIONS,
    ) -> None:
        super().__init__(exchange, faults, FAULTS)
        self._options = options
        self._session = self._new_session()
        self._listens: set[str] = set()
        self._links: dict[Channel, str] = {}
        """Channels of the connections that stand."""
        self._joined = 0
        self._readers: dict[str, sm.FrameReader] = {}
        self._ended = self._leaving = False
        self._requests = self._commands = self._sent = 0
        self._told: sm.Message | None = None
        """The request that is open, for those who take any reply for its answer."""
        self._told_s = math.inf
        self._point: sm.JointTrajPtFull | None = None
        self._states: dict[int, sm.Message] = {}
        self._heard_s, self._repeated_s = math.inf, 0.0

    def _new_session(self) -> MotorosSession:
        wait_s = self._faults.get("patient", self._options.request_timeout_s)
        return MotorosSession(replace(self._options, request_timeout_s=wait_s))

    # -- connections ------------------------------------------------------------------------------

    def _open(self, channel: str) -> None:
        super()._open(channel)
        self._listens.add(channel)

    def _closed(self, channel: str) -> None:
        self._later(NETWORK_S, lambda: self._hung_up(channel))

    def _hung_up(self, channel: str) -> None:
        kind = self._kind(channel)
        if kind is not None:
            del self._links[kind]
            self._session.disconnected(kind, "the controller closed it", self._now_s)

    @property
    def _wire(self) -> sm.WireFormat:
        return sm.wire(self._session.feed.byte_order or sm.ByteOrder.LITTLE)

    def _kind(self, name: str) -> Channel | None:
        return next((kind for kind, each in self._links.items() if each == name), None)

    def _connect(self) -> None:
        faults = self._faults
        for kind in CHANNELS:
            barred = "absent" in faults or ("no-motion" in faults and kind == "motion")
            tired = "gives-up" in faults and self._joined >= len(CHANNELS)
            wanted = kind not in self._links and self._session.wants(kind, self._now_s)
            if barred or tired or kind not in self._listens or not wanted:
                continue
            self._joined += 1
            name = self._links[kind] = f"{kind} {self._joined}"
            self._session.connected(kind, self._now_s)
            self._told = None
            self._hear(name, kind=Kind.OPENED)
            if kind == "state" and "talks-to-states" in faults:
                self._write(name, sm.request(sm.Empty(), sm.MessageType.PING))
            if kind == "motion" and "unknown-command" in faults:
                command = int(faults["unknown-command"])
                self._write(name, sm.request(sm.MotionCtrl(0, OWN_SEQUENCE, command)))

    # -- what the controller says -----------------------------------------------------------------

    def _take(self, data: bytes, channel: str) -> None:
        self._later(NETWORK_S, lambda: self._arrived(channel, data))

    def _arrived(self, channel: str, data: bytes) -> None:
        kind = self._kind(channel)
        if kind is None:
            return
        if not self._faults:
            self._session.received(kind, data, self._now_s)
            return
        if "one-read" in self._faults:
            found = sm.FrameReader()
            found.feed(data)
            if found.take() is None or found.pending_bytes:
                return
        reader = self._readers.setdefault(channel, sm.FrameReader())
        reader.feed(data)
        while (frame := reader.take()) is not None:
            order = reader.byte_order or sm.ByteOrder.LITTLE
            message = sm.wire(order).decode(frame)
            if isinstance(message, sm.Message):
                heard = self._believed(message)
                if heard is None:
                    continue
                frame = sm.wire(order).encode(heard)
                if kind == "state":
                    self._states[heard.msg_type], self._heard_s = heard, self._now_s
            if self._kind(channel) == kind:
                self._session.received(kind, frame, self._now_s)
        if reader.failure:
            del self._readers[channel]
            self._session.received(kind, data, self._now_s)

    def _believed(self, message: sm.Message) -> sm.Message | None:
        """What the driver takes a message for; None: it does not see it."""
        faults, body = self._faults, message.body
        if isinstance(body, sm.RobotStatus) and any(name in faults for name in TRUSTING):
            well = body._replace(
                drives_powered=1,
                e_stopped=0,
                in_error=0,
                mode=int(sm.ControllerMode.AUTO),
                motion_possible=1,
            )
            return message._replace(body=well)
        if isinstance(body, sm.RobotStatus) and "hasty" in faults:
            return message._replace(body=body._replace(in_motion=0))
        if not isinstance(body, sm.MotionReply):
            return message
        if body.sequence == OWN_SEQUENCE or (body.command == 0 and "unknown-command" in faults):
            return None
        asked, self._told, self._told_s = self._told, None, math.inf
        if asked is None and "impatient" in faults:
            return None
        first = body.sequence == 0 and body.subcode == sm.InvalidSubcode.DATA_START_POS
        refused = body.result == sm.MotionResult.NOT_READY
        believes = (
            ("skips-busy" in faults and body.result == sm.MotionResult.BUSY)
            or ("skips-first" in faults and first)
            or ("blind" in faults and refused and body.command not in STARTS)
            or ("takes-no-for-yes" in faults and refused and body.command in STARTS)
            or ("nan" in faults and body.result == sm.MotionResult.INVALID)
        )
        if believes:
            body = body._replace(result=int(sm.MotionResult.SUCCESS), subcode=0)
        if "skips-busy" in faults and body.command == sm.MotionCommand.CHECK_QUEUE_CNT:
            body = body._replace(subcode=max(body.subcode, 1))
        if "credulous" in faults and asked is not None:
            wanted = asked.body
            command = wanted.command if isinstance(wanted, sm.MotionCtrl) else asked.msg_type
            sequence = getattr(wanted, "sequence", body.sequence)
            body = body._replace(
                command=command, sequence=sequence, result=int(sm.MotionResult.SUCCESS)
            )
        return message._replace(body=body)

    # -- what the driver says ---------------------------------------------------------------------

    def _turn(self) -> None:
        if self._ended:
            return
        session, now_s = self._session, self._now_s
        self._connect()
        session.advance(now_s)
        self._carry()
        state = session.due_state(now_s)
        if state is not None:
            if session.reply_pending:
                session.command(self._wanted(state), now_s)
            self._carry()
        self._misbehave()
        if self._leaving and session.left:
            self._leave()

    def _wanted(self, state: RobotState) -> RobotCommand:
        """The last joint swings there and back."""
        if state.hold_reason or self._leaving:
            return HoldCommand()
        speed = SPEED_RAD_S * math.sin(2.0 * math.pi * self._now_s / SWING_S)
        return JointVelocityCommand((0.0,) * (len(state.joints) - 1) + (speed,))

    def _next_s(self) -> float:
        if self._ended:
            return self._now_s + LOOK_S
        return min(self._session.next_s, self._now_s + LOOK_S)

    def _misbehave(self) -> None:
        """What a driver with these defects does of itself."""
        faults, session, now_s = self._faults, self._session, self._now_s
        idle = session.phase is MotionPhase.IDLE and session.requests.idle
        status = session.feed.status
        if "restarts" in faults and idle and session.sessions > 1 and not self._leaving:
            session.enable(now_s)
        if "resets" in faults and idle and status is not None and status.in_error == 1:
            session.ask("reset alarm", now_s)
        if "deaf" in faults and now_s > max(self._heard_s, self._repeated_s) + STATE_S:
            self._repeated_s = now_s
            for message in tuple(self._states.values()):
                session.received("state", self._wire.encode(message), now_s)
        again_s = 1e-3 * faults.get("impatient", math.inf)
        name = self._links.get("motion")
        if self._told is not None and name is not None and now_s > self._told_s + again_s:
            self._told_s = now_s
            self._write(name, self._told)

    def _carry(self) -> None:
        """What the driver sends and closes."""
        session = self._session
        for kind in session.closing():
            name = self._links.pop(kind, None)
            if name is not None:
                self._close(name)
        for kind, data in session.outgoing():
            if kind not in self._links:
                continue
            if not self._faults:
                self._send(self._links[kind], data)
                continue
            message = self._wire.decode(data)
            assert not isinstance(message, sm.MalformedMessage)
            self._spoilt(self._links[kind], message)

    def _close(self, name: str) -> None:
        self._later(NETWORK_S, lambda: self._hear(name, kind=Kind.CLOSED))

    def _spoilt(self, name: str, message: sm.Message) -> None:
        """Send `message` as a driver with these defects would."""
        faults, body = self._faults, message.body
        if isinstance(body, sm.MotionCtrl):
            command = body.command
            left_out = (
                ("no-stop" in faults and command == sm.MotionCommand.STOP_MOTION)
                or ("no-start" in faults and command in STARTS)
                or ("leaves-mode-on" in faults and self._leaving and command in STOPS)
            )
            if left_out:
                done = sm.MotionReply(
                    body.group, body.sequence, command, sm.MotionResult.SUCCESS, 0
                )
                self._pretend(name, done)
                return
            if command == sm.MotionCommand.START_VEL_MODE and "watchdog" in faults:
                body = body._replace(data=sm.joints10((faults["watchdog"], *body.data[1:])))
        elif isinstance(body, sm.VelocityInfoRequest) and "no-info" in faults:
            arm = load_arm(OPTIONS.robot)
            accelerations = sm.joints10(joint.acceleration for joint in arm.joints)
            limits = (sm.joints10(arm.velocity), accelerations, sm.joints10(arm.lower))
            joints = len(arm.joints)
            info = sm.VelocityInfo(1, 4000, 100, 0, 1, joints, *limits, sm.joints10(arm.upper))
            self._pretend(name, info)
            return
        elif isinstance(body, sm.JointTrajPtFull):
            body = self._spoilt_point(body)
        elif isinstance(body, sm.JointVelocity):
            if body.sequence and _asleep(self._now_s, 1e-3 * faults.get("dozes", 0.0)):
                if message.comm_type == sm.CommType.SERVICE_REQUEST:
                    kind = sm.MessageType.MOTO_JOINT_VELOCITY
                    self._pretend(name, sm.MotionReply(body.group, body.sequence, kind, 0, 0))
                return
            body = self._spoilt_speeds(body)
        comm_type = message.comm_type
        asks = comm_type == sm.CommType.SERVICE_REQUEST
        if asks:
            comm_type = int(sm.CommType.TOPIC) if "topics" in faults else comm_type
            # What is awaited is what the driver's core said.
            self._told, self._told_s = message, self._now_s
            self._requests += 1
        self._write(name, message._replace(comm_type=comm_type, body=body))
        if asks and self._every("pipelines", self._requests):
            more = sm.MotionCtrl(0, OWN_SEQUENCE, sm.MotionCommand.CHECK_MOTION_READY)
            self._write(name, sm.request(more))

    def _spoilt_point(self, point: sm.JointTrajPtFull) -> sm.JointTrajPtFull:
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
        leap = self._commands % LEAP_EVERY == 0 and not first
        if leap:
            pos = _shifted(pos, faults.get("leap", 0.0) + faults.get("out-of-range", 0.0))
        if self._every("nan", self._commands):
            vel = _shifted(vel, math.nan)
        point = point._replace(pos=pos, vel=vel)
        if "fields" in faults:
            point = point._replace(valid_fields=int(faults["fields"]))
        if before is not None and not first and before.sequence + 1 == point.sequence:
            if self._every("sequence", self._commands):
                point = point._replace(sequence=max(1, before.sequence))
            if self._every("time-stands", self._commands):
                point = point._replace(time=before.time)
        return point

    def _spoilt_speeds(self, body: sm.JointVelocity) -> sm.JointVelocity:
        faults, vel, sequence = self._faults, body.vel, body.sequence
        self._commands += 1
        if not sequence and "starts-moving" in faults:
            vel = _shifted(vel, faults["starts-moving"])
        if sequence and self._commands % LEAP_EVERY == 0:
            vel = _shifted(vel, faults.get("leap", 0.0))
        if self._every("nan", self._commands):
            vel = _shifted(vel, math.nan)
        if sequence > 1 and self._every("sequence", self._commands):
            sequence -= 1
        fields = body.valid_fields
        if "fields" in faults:
            fields = int(faults["fields"]) & ~sm.ValidFields.VELOCITY
        return body._replace(vel=vel, sequence=sequence, valid_fields=fields)

    def _pretend(self, name: str, body: sm.MotionReply | sm.VelocityInfo) -> None:
        """The driver goes on as after this answer, without having asked."""
        data = self._wire.encode(sm.reply(body))

        def arrived() -> None:
            if self._kind(name) == "motion":
                self._session.received("motion", data, self._now_s)

        self._later(NETWORK_S, arrived)

    def _write(self, name: str, message: sm.Message) -> None:
        order = self._session.feed.byte_order or sm.ByteOrder.LITTLE
        if "other-order" in self._faults:
            order = sm.ByteOrder.BIG if order is sm.ByteOrder.LITTLE else sm.ByteOrder.LITTLE
        data = sm.wire(order).encode(message)
        self._sent += 1
        if self._every("truncated", self._sent):
            word = "little" if order is sm.ByteOrder.LITTLE else "big"
            data = (len(data) - 8).to_bytes(4, word) + data[4:-4]  # type: ignore[arg-type]
        late_s = 1e-3 * self._faults.get("starves", 0.0)
        point = isinstance(message.body, sm.JointTrajPtFull)
        if late_s and point and self._commands % STARVES_EVERY == 0:
            self._later(late_s, lambda: self._hear(name, data))
        elif self._every("pieces", self._sent):
            self._send(name, data[:10])
            self._later(PIECE_S, lambda: self._hear(name, data[10:]))
        else:
            self._send(name, data)

    def _send(self, name: str, data: bytes) -> None:
        self._later(NETWORK_S, lambda: self._hear(name, data))

    # -- what is done by hand ---------------------------------------------------------------------

    def _by_hand(self, what: str) -> None:
        if what == "enable":
            self._session.enable(self._now_s)
        elif what == "end":
            if "leaves-moving" in self._faults:
                self._leave()
            else:
                self._leaving = True
                self._session.leave(self._now_s)
        else:
            self._ended = self._leaving = False
            self._session = self._new_session()

    def _leave(self) -> None:
        """The program is over."""
        self._ended = True
        if "stays" not in self._faults:
            for name in self._links.values():
                self._close(name)
        self._links.clear()


def _shifted(values: sm.Joints, by: float) -> sm.Joints:
    """With so much more of the first joint."""
    return (values[0] + by, *values[1:])


def _asleep(now_s: float, for_s: float) -> bool:
    """Whether a driver sleeps that does so for `for_s` every DOZES_EVERY_S."""
    return for_s > 0.0 and now_s % DOZES_EVERY_S < for_s
