"""The motion server of the simulated Motoman controller, sans I/O: messages in, answers out.

`MotomanRobot` is its robot. `MotorosServers` adds connections, framing, the state cycle and the I/O
image.

Sources: MotoROS 1.9.12 (MotionServer.c, Controller.c) and, for the velocity mode,
docs/protocols/simple-message.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping

from cardan.protocols.simple_message.codes import (
    CommType,
    InvalidSubcode,
    MessageType,
    MotionCommand,
    MotionResult,
    NotReadySubcode,
    ValidFields,
)
from cardan.protocols.simple_message.messages import (
    DH_LINKS,
    MAX_GROUPS,
    ZEROS,
    DhLink,
    DhParameters,
    Empty,
    JointFeedback,
    Joints,
    JointTrajPtFull,
    JointTrajPtFullEx,
    JointVelocity,
    JointVelocityEx,
    Message,
    MotionCtrl,
    MotionReply,
    SelectTool,
    VelocityInfo,
    VelocityInfoRequest,
    joints10,
    reply,
)
from cardan.sim_peers.motoros_controller.dh import dh_table
from cardan.sim_peers.motoros_controller.inputs import not_ready_reason
from cardan.sim_peers.motoros_controller.options import MotorosControllerOptions
from cardan.sim_peers.motoros_controller.robot import (
    DEFAULT_WATCHDOG_MS,
    FIRST_MINOR_ALARM,
    MotomanRobot,
    Steps,
)
from cardan.sim_peers.motoros_controller.velocity import is_newer

TASK_END_S = 0.05
"""Time that the increment task continues after the end of the motion connection."""
LONGEST_TIME_S = 14400.0
"""Smallest time of a point of type 14 that is refused."""
TOOLS = 64

VELOCITY_VERSION = 1
SHORTEST_WATCHDOG_MS, LONGEST_WATCHDOG_MS = 20.0, 500.0
SMALLEST_ACCELERATION_SCALE = 0.01

_REFUSED_TYPES = frozenset(
    {
        MessageType.ROBOT_STATUS,
        MessageType.JOINT_FEEDBACK,
        MessageType.MOTO_MOTION_REPLY,
        MessageType.MOTO_JOINT_FEEDBACK_EX,
    }
)
"""Known types that are not served: the motion server closes the connection."""
_VELOCITY_TYPES = frozenset({MessageType.MOTO_JOINT_VELOCITY, MessageType.MOTO_JOINT_VELOCITY_EX})
_TRAJECTORY_FIELDS = ValidFields.TIME | ValidFields.POSITION | ValidFields.VELOCITY
_WAIT_S = 5.0
_CHECK_S = 0.05
_STOP_WAIT_S = 0.02
_STOP_CHECK_S = 0.001
_WAIT_LINE_SHARE = 75 / 110
"""Share of INIT_ROS's starting time after which it is on its WAIT line: a captured
controller reports that motion is possible between 60 and 85 ms, and replies after 110."""


class MotorosController(MotomanRobot):
    """The motion server of a controller.

    Call `advance` at `next_s`, pass each message of the motion connection to `motion` while not
    `blocked`, and send the messages in `replies`.
    """

    def __init__(self, options: MotorosControllerOptions | None = None) -> None:
        super().__init__(MotorosControllerOptions() if options is None else options)
        self.replies: list[Message] = []
        """Answers to send, oldest first; the sender removes them."""
        self.close_requested = False
        """The motion connection must be closed; the code that closes it resets this."""
        self.busy_answers = 0
        """Number of following points that are answered BUSY, as during a slow conversion."""
        self.refused_starts = 0
        """Number of following first points that are refused, as from a sagging arm."""
        self._connected = False
        self._last_reply = reply(MotionReply(0, 0, 0, 0, 0))

    # -- connections -------------------------------------------------------------------------------

    def connected(self, now_s: float) -> None:
        """Accept a new client of the motion port. Entries left in a queue are executed now."""
        self.advance(now_s)
        if self._connected or self._task_ends_s < math.inf:
            # Its place is reused at once: the tasks end before the new ones begin.
            self._end_tasks()
        self._connected = self._task_runs = True
        self._task_ends_s = math.inf
        self._abandon()
        if self._velocity_on:
            self._end_velocity_mode()
        self._last_reply = reply(MotionReply(0, 0, 0, 0, 0))
        if any(group.queue for group in self._groups):
            self._note("a new client; the queue still holds increments")

    def disconnected(self, now_s: float) -> None:
        """Handle the departure of the client of the motion port.

        A waiting request is dropped. A trajectory stops abruptly TASK_END_S later and keeps its
        queue; the velocity mode ramps to zero and ends.
        """
        self.advance(now_s)
        self._connected = False
        self._abandon()
        if self._task_runs:
            self._task_ends_s = self._now_s + TASK_END_S
        if self._velocity_on:
            self._end_velocity_mode()
            self._note("motion connection closed: the velocity mode ends")

    # -- the motion server -------------------------------------------------------------------------

    def motion(self, message: Message, now_s: float) -> None:
        """Handle a message of the motion connection, not while `blocked`.

        Answers go to `replies`, at once or later.
        """
        self.advance(now_s)
        body, msg_type = message.body, message.msg_type
        velocity_mode = self.options.velocity_mode
        if msg_type == MessageType.PING:
            self._send(message, reply(Empty(), msg_type=MessageType.PING))
        elif msg_type == MessageType.MOTO_MOTION_CTRL and isinstance(body, MotionCtrl):
            self._control(message, body)
        elif msg_type == MessageType.JOINT_TRAJ_PT_FULL and isinstance(body, JointTrajPtFull):
            self._point(message, body)
        elif msg_type == MessageType.MOTO_JOINT_TRAJ_PT_FULL_EX and isinstance(
            body, JointTrajPtFullEx
        ):
            self._points(message, body)
        elif msg_type == MessageType.MOTO_SELECT_TOOL and isinstance(body, SelectTool):
            self._select_tool(message, body)
        elif msg_type == MessageType.MOTO_GET_DH_PARAMETERS:
            self._send(message, reply(self._dh_parameters()))
        elif velocity_mode and isinstance(body, JointVelocity):
            command = JointFeedback(body.group, *body[2:])
            self._velocities(message, body.sequence, (command,))
        elif velocity_mode and isinstance(body, JointVelocityEx):
            self._velocities(message, body.sequence, body.commands)
        elif velocity_mode and isinstance(body, VelocityInfoRequest):
            self._velocity_info(message, body)
        elif msg_type in _REFUSED_TYPES:
            self._note(f"message {msg_type} is not served here: the connection is closed")
            self.close_requested = True
        else:
            self._answer(message, -1, -1, MotionResult.INVALID, InvalidSubcode.MSGTYPE)

    def remember(self, answer: Message) -> None:
        """Store a reply that another server made on the motion connection: MotoROS has one buffer
        for all of them, and sends it again for an unknown command."""
        self._last_reply = answer

    def _send(self, asked: Message, answer: Message) -> None:
        self.remember(answer)
        silent = asked.comm_type == CommType.SERVICE_REPLY or (
            asked.comm_type == CommType.TOPIC and asked.msg_type in _VELOCITY_TYPES
        )
        if not silent:
            self.replies.append(answer)

    def _answer(
        self,
        asked: Message,
        group: int,
        sequence: int,
        result: int,
        subcode: int = 0,
        data: Joints = ZEROS,
        command: int | None = None,
    ) -> None:
        """`command` is the type of the message, unless it is a MOTION_CTRL."""
        named = asked.msg_type if command is None else command
        self._send(asked, reply(MotionReply(group, sequence, named, result, subcode, data)))

    def _reason(self) -> int:
        """Return the NOT_READY subcode that applies."""
        return not_ready_reason(
            self._seen, self._job_ready, self._collaborative_stop, self._increment_error
        )

    # -- points of trajectories --------------------------------------------------------------------

    def _refusal(self) -> int:
        """Return why points are refused now, a NOT_READY subcode; 0 if they are accepted."""
        if not self.ready:
            return self._reason()
        return NotReadySubcode.OTHER_MODE_ACTIVE if self._velocity_on else 0

    def _point(self, asked: Message, point: JointTrajPtFull) -> None:
        refusal = self._refusal()
        if refusal:
            result, subcode = MotionResult.NOT_READY, refusal
        elif not 0 <= point.group < self.groups:
            result, subcode = MotionResult.INVALID, int(InvalidSubcode.GROUPNO)
        elif point.valid_fields & _TRAJECTORY_FIELDS != _TRAJECTORY_FIELDS:
            result, subcode = MotionResult.INVALID, int(InvalidSubcode.DATA_INSUFFICIENT)
        elif point.time >= LONGEST_TIME_S:
            result, subcode = MotionResult.INVALID, int(InvalidSubcode.DATA_TIME)
        elif point.sequence == 0 and self._inputs.energy_saving:
            self._start(self._wake_for_point(asked, point))
            return
        else:
            self._take_point(asked, point.sequence, point)
            return
        self._answer(asked, point.group, point.sequence, result, subcode)

    def _wake_for_point(self, asked: Message, point: JointTrajPtFull) -> Steps:
        """Wake the drives for point 0, which is kept even if they do not wake."""
        yield from self._wake()
        self._take_point(asked, point.sequence, point)
        return True

    def _take_point(
        self,
        asked: Message,
        sequence: int,
        point: JointTrajPtFull | JointFeedback,
        answered: bool = True,
    ) -> bool:
        """Return True if the point was accepted; a refusal is answered, a success if `answered`."""
        group = self._groups[point.group]
        result, subcode = MotionResult.SUCCESS, 0
        if sequence < 0:
            result, subcode = MotionResult.INVALID, int(InvalidSubcode.SEQUENCE)
        elif sequence == 0:
            subcode = group.begin(point.time, point.pos, point.vel)
            if self.refused_starts:
                self.refused_starts -= 1
                subcode = subcode or int(InvalidSubcode.DATA_START_POS)
        elif group.has_data or self.busy_answers:
            self.busy_answers = max(0, self.busy_answers - 1)
            result = MotionResult.BUSY
        else:
            subcode = group.add(point.time, point.pos, point.vel)
        if subcode:
            result = MotionResult.INVALID
        good = result == MotionResult.SUCCESS
        if good:
            self._newest_command_s = self._now_s
        if answered or not good:
            self._answer(asked, point.group, sequence, result, subcode)
        return good

    def _points(self, asked: Message, body: JointTrajPtFullEx) -> None:
        sequence, points = body.sequence, body.points
        if not points:
            # The loops over groups do nothing: the reply to the last message is sent again.
            self._send(asked, self._last_reply)
            return
        refusal = self._refusal()
        if refusal:
            self._answer(asked, points[-1].group, sequence, MotionResult.NOT_READY, refusal)
            return
        for point in points:
            if not 0 <= point.group < self.groups:
                result, subcode = MotionResult.INVALID, int(InvalidSubcode.GROUPNO)
            elif self._groups[point.group].has_data:
                result, subcode = MotionResult.BUSY, 0
            elif point.valid_fields & _TRAJECTORY_FIELDS != _TRAJECTORY_FIELDS:
                result, subcode = MotionResult.INVALID, int(InvalidSubcode.DATA_INSUFFICIENT)
            else:
                continue
            self._answer(asked, point.group, sequence, result, subcode)
            return
        if sequence == 0 and self._inputs.energy_saving:
            self._start(self._wake_for_points(asked, body))
            return
        self._take_points(asked, body)

    def _wake_for_points(self, asked: Message, body: JointTrajPtFullEx) -> Steps:
        yield from self._wake()
        self._take_points(asked, body)
        return True

    def _take_points(self, asked: Message, body: JointTrajPtFullEx) -> None:
        last = len(body.points) - 1
        for index, point in enumerate(body.points):
            if not self._take_point(asked, body.sequence, point, index == last):
                return

    # -- tools and kinematics ----------------------------------------------------------------------

    def _select_tool(self, asked: Message, body: SelectTool) -> None:
        result, subcode = MotionResult.INVALID, 0
        if not 0 <= body.group < self.groups:
            subcode = InvalidSubcode.GROUPNO
        elif not 0 <= body.tool < TOOLS:
            subcode = InvalidSubcode.DATA_TOOLNO
        else:
            result = MotionResult.SUCCESS
            self._groups[body.group].tool = body.tool
        self._answer(asked, body.group, body.sequence, result, subcode)

    def _dh_parameters(self) -> DhParameters:
        nothing = DhLink(0.0, 0.0, 0.0, 0.0)
        links = dh_table(self.arm).links
        filled = (*links, *[nothing] * (DH_LINKS - len(links)))
        empty = (nothing,) * DH_LINKS
        return DhParameters((*[filled] * self.groups, *[empty] * (MAX_GROUPS - self.groups)))

    # -- MOTION_CTRL -------------------------------------------------------------------------------

    def _control(self, asked: Message, control: MotionCtrl) -> None:
        command = control.command
        tasks: Mapping[int, Callable[[Message, MotionCtrl], Steps]] = {
            MotionCommand.STOP_MOTION: self._do_stop_motion,
            MotionCommand.START_SERVOS: self._do_start_servos,
            MotionCommand.STOP_SERVOS: self._do_stop_servos,
            MotionCommand.START_TRAJ_MODE: self._do_start_trajectory_mode,
            MotionCommand.STOP_TRAJ_MODE: self._do_stop_trajectory_mode,
            MotionCommand.DISCONNECT: self._do_stop_trajectory_mode,
        }
        velocity_mode = self.options.velocity_mode
        if command in tasks:
            self._start(tasks[command](asked, control))
        elif command == MotionCommand.CHECK_MOTION_READY:
            self._check_motion_ready(asked, control)
        elif command == MotionCommand.CHECK_QUEUE_CNT:
            if 0 <= control.group < self.groups:
                count = len(self._groups[control.group].queue)
                self._done(asked, control, MotionResult.SUCCESS, count)
            else:
                self._done(asked, control, MotionResult.FAILURE, -1)
        elif command == MotionCommand.RESET_ALARM:
            self._reset_remotely()
            self._done(asked, control, MotionResult.SUCCESS)
        elif command == MotionCommand.START_VEL_MODE and velocity_mode:
            self._start(self._do_start_velocity_mode(asked, control))
        elif command == MotionCommand.STOP_VEL_MODE and velocity_mode:
            self._stop_velocity_mode(asked, control)
        else:
            # MotoROS has no branch for it: the buffer still holds the previous reply.
            self._send(asked, self._last_reply)

    def _done(
        self,
        asked: Message,
        control: MotionCtrl,
        result: int,
        subcode: int = 0,
        data: Joints = ZEROS,
    ) -> None:
        self._answer(asked, control.group, control.sequence, result, subcode, data, control.command)

    def _check_motion_ready(self, asked: Message, control: MotionCtrl) -> None:
        if self.motion_possible:
            self._done(asked, control, MotionResult.SUCCESS)
            return
        if not self.ready:
            reason = self._reason()
        elif self._leaving:
            reason = NotReadySubcode.NOT_IN_VEL_MODE
        else:
            reason = NotReadySubcode.VEL_WATCHDOG
        self._done(asked, control, MotionResult.FAILURE, 0 if self._old else reason)

    def _do_stop_motion(self, asked: Message, control: MotionCtrl) -> Steps:
        stopped = yield from self._stop_motion()
        result = MotionResult.SUCCESS if stopped else MotionResult.FAILURE
        self._done(asked, control, result)
        return stopped

    def _stop_motion(self) -> Steps:
        """Let the fillers finish, then empty the queues. The velocity mode ramps down and latches
        instead, without waiting."""
        if self._velocity_on:
            self._latch()
        self._stopping = True
        waited_s = 0.0
        while any(group.has_data for group in self._groups) and waited_s < _STOP_WAIT_S:
            yield _STOP_CHECK_S
            waited_s += _STOP_CHECK_S
        stopped = not any(group.has_data for group in self._groups)
        for group in self._groups:
            group.clear()
        self._stopping = False
        return stopped

    def _do_start_servos(self, asked: Message, control: MotionCtrl) -> Steps:
        good = yield from self._power()
        self._done(asked, control, MotionResult.SUCCESS if good else MotionResult.FAILURE)
        return good

    def _do_stop_servos(self, asked: Message, control: MotionCtrl) -> Steps:
        yield from self._stop_motion()
        waited_s = 0.0
        while not self._still and waited_s < _WAIT_S:
            yield _CHECK_S
            waited_s += _CHECK_S
        yield self.options.servo_off_s
        self.servo(False, self._now_s)
        self._poll()
        self._done(asked, control, MotionResult.SUCCESS)
        return True

    def _reset_remotely(self) -> None:
        """Reset errors, and those alarms that are not major."""
        self._inputs.error = 0
        if self._inputs.alarm >= FIRST_MINOR_ALARM:
            self._inputs.alarm = 0
        self._poll()

    def _wake(self) -> Generator[float, None, None]:
        """Leave energy saving."""
        if self._inputs.energy_saving:
            yield self.options.eco_wake_s
            self._inputs.energy_saving = False
            self._poll()

    def _power(self) -> Steps:
        """Switch the servos on; wait at most 5 s."""
        yield from self._wake()
        self._poll()
        if self._inputs.servo:
            return True

        def on() -> None:
            if self._servo_can_be_on:
                self._note("servo power on")
                self._inputs.servo = True

        self._after(self.options.servo_on_s, on)
        waited_s = 0.0
        while not self._inputs.servo and waited_s < _WAIT_S:
            yield _CHECK_S
            waited_s += _CHECK_S
        self._poll()
        return self._seen.drives_powered

    def _do_start_trajectory_mode(self, asked: Message, control: MotionCtrl) -> Steps:
        if self._velocity_on:
            if not self._still:
                self._done(
                    asked,
                    control,
                    MotionResult.NOT_READY,
                    NotReadySubcode.OTHER_MODE_ACTIVE,
                )
                return False
            self._leave_velocity_mode()
        good = yield from self._start_job()
        if good:
            self._done(asked, control, MotionResult.SUCCESS)
        else:
            self._done(asked, control, MotionResult.NOT_READY, self._reason())
        return good

    def _start_job(self) -> Steps:
        """Run all steps of START_TRAJ_MODE until motion is possible."""
        self._poll()
        self._collaborative_stop = self._increment_error = False
        seen = self._seen
        if self.ready:
            return True
        if seen.operating or seen.estop or seen.hold or not seen.remote:
            return False
        if seen.alarm or seen.error:
            self._reset_remotely()
            waited_s = 0.0
            while self._seen.alarm and waited_s < _WAIT_S:
                yield _CHECK_S
                waited_s += _CHECK_S
                self._poll()
            if self._seen.alarm:
                return False
        if not self._seen.drives_powered:
            good = yield from self._power()
            if not good:
                return False
        for group in self._groups:
            group.restart()
        if not self._begin_job():
            return False
        yield self.options.job_start_s
        waited_s = 0.0
        while True:
            self._poll()
            if self.ready:
                self._note("INIT_ROS waits for increments")
                return True
            if waited_s >= _WAIT_S:
                return False
            yield _CHECK_S
            waited_s += _CHECK_S

    def _begin_job(self) -> bool:
        """Start INIT_ROS, if the controller allows a job to start."""
        inputs = self._inputs
        if not (inputs.play and inputs.remote and inputs.servo) or inputs.estop or inputs.hold:
            return False
        inputs.operating = True
        inputs.waiting = False
        self._job_ready = False
        self._suspended = False

        def wait_line() -> None:
            if inputs.operating:
                inputs.waiting = True

        self._poll()
        self._after(_WAIT_LINE_SHARE * self.options.job_start_s, wait_line)
        return True

    def _do_stop_trajectory_mode(self, asked: Message, control: MotionCtrl) -> Steps:
        """Execute STOP_TRAJ_MODE, or DISCONNECT, which also closes the connection."""
        stopped = False
        if not self.moving_data:
            stopped = yield from self._stop_motion()
        if not stopped:
            self._done(asked, control, MotionResult.FAILURE)
            return False
        self._inputs.waiting = False
        self._stop_job()
        if control.command == MotionCommand.DISCONNECT:
            self.close_requested = True
        else:
            self._done(asked, control, MotionResult.SUCCESS)
        return True

    # -- the velocity mode -------------------------------------------------------------------------

    def _velocity_info(self, asked: Message, body: VelocityInfoRequest) -> None:
        if not 0 <= body.group < self.groups:
            self._answer(asked, body.group, -1, MotionResult.INVALID, InvalidSubcode.GROUPNO)
            return
        law, arm = self._laws[body.group], self.arm
        info = VelocityInfo(
            VELOCITY_VERSION,
            round(self._ipc_s * 1e6),
            round(DEFAULT_WATCHDOG_MS),
            self.active_mode,
            self.groups,
            self.axes,
            joints10(law.speeds_rad_s),
            joints10(law.accelerations_rad_s2),
            joints10(arm.lower),
            joints10(arm.upper),
        )
        self._send(asked, reply(info))

    def _do_start_velocity_mode(self, asked: Message, control: MotionCtrl) -> Steps:
        watchdog_ms, scale = control.data[:2]
        if not (math.isfinite(watchdog_ms) and math.isfinite(scale)):
            self._done(asked, control, MotionResult.INVALID, InvalidSubcode.VEL_NOT_FINITE)
            return False
        if self.moving_data or any(group.has_data for group in self._groups):
            self._done(asked, control, MotionResult.BUSY)
            return False
        yield from self._wake()
        good = yield from self._start_job()
        if not good:
            self._done(asked, control, MotionResult.NOT_READY, self._reason())
            return False
        watchdog_ms = watchdog_ms or DEFAULT_WATCHDOG_MS
        self._watchdog_ms = min(max(watchdog_ms, SHORTEST_WATCHDOG_MS), LONGEST_WATCHDOG_MS)
        self._acceleration_scale = min(max(scale or 1.0, SMALLEST_ACCELERATION_SCALE), 1.0)
        self._forget_commands()
        self._velocity_on, self._leaving = True, False
        for group, law, stream in zip(self._groups, self._laws, self._streams, strict=True):
            law.place(group.command)
            law.clear_masks()
            stream.age_ms, stream.overwritten = 0.0, 0
        self._note("velocity mode")
        data = (
            float(VELOCITY_VERSION),
            self._ipc_s * 1e3,
            self._watchdog_ms,
            self._acceleration_scale,
        )
        self._done(asked, control, MotionResult.SUCCESS, 0, joints10(data))
        return True

    def _stop_velocity_mode(self, asked: Message, control: MotionCtrl) -> None:
        if not self._velocity_on:
            reason = NotReadySubcode.NOT_IN_VEL_MODE if self.ready else self._reason()
            self._done(asked, control, MotionResult.NOT_READY, reason)
            return
        ramp_s = max(law.stopping_time_s for law in self._laws)
        self._end_velocity_mode()
        self._done(asked, control, MotionResult.SUCCESS, 0, joints10((ramp_s,)))

    def _velocities(
        self, asked: Message, sequence: int, commands: tuple[JointFeedback, ...]
    ) -> None:
        result, subcode = self._velocity_verdict(sequence, commands)
        group = commands[-1].group if commands else -1
        data = ZEROS
        if result == MotionResult.SUCCESS:
            self.velocities_accepted += 1
            for command in commands:
                self._take_velocity(sequence, command)
            if asked.comm_type == CommType.SERVICE_REQUEST:
                data = self._statistics([command.group for command in commands])
        else:
            self.velocities_refused += 1
        self._answer(asked, group, sequence, result, subcode, data)

    def _velocity_verdict(
        self, sequence: int, commands: tuple[JointFeedback, ...]
    ) -> tuple[int, int]:
        """Return result and subcode for these commands, all groups or none, in the order of the
        specification's list."""
        not_ready, invalid = MotionResult.NOT_READY, MotionResult.INVALID
        if not self.ready:
            return not_ready, self._reason()
        if not self._velocity_on or self._leaving:
            return not_ready, NotReadySubcode.NOT_IN_VEL_MODE
        if not commands:
            return invalid, InvalidSubcode.DATA
        if sequence < 0:
            return invalid, InvalidSubcode.SEQUENCE
        seen = set()
        for command in commands:
            if not 0 <= command.group < self.groups:
                return invalid, InvalidSubcode.GROUPNO
            if command.group in seen:
                return invalid, InvalidSubcode.DATA
            seen.add(command.group)
            fields = command.valid_fields
            if not fields & ValidFields.VELOCITY:
                return invalid, InvalidSubcode.DATA_INSUFFICIENT
            if fields & ValidFields.POSITION:
                return invalid, InvalidSubcode.DATA
            numbers = list(command.vel)
            if fields & ValidFields.TIME:
                numbers.append(command.time)
            if fields & ValidFields.ACCELERATION:
                numbers.extend(command.acc)
            if not all(map(math.isfinite, numbers)):
                return invalid, InvalidSubcode.VEL_NOT_FINITE
        if sequence:
            for command in commands:
                stream = self._streams[command.group]
                if not stream.armed:
                    if stream.latched:
                        return not_ready, NotReadySubcode.VEL_WATCHDOG
                    return invalid, InvalidSubcode.VEL_SEQUENCE
                if not is_newer(sequence, stream.sequence):
                    return invalid, InvalidSubcode.VEL_SEQUENCE
        return MotionResult.SUCCESS, 0
