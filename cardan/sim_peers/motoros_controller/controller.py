"""The robot inside the simulated Motoman controller, sans I/O: MotoROS's motion server and state.

Messages and times in, answers and a moving arm out. What `MotorosServers` adds is connections,
framing, the state cycle and the I/O image.

Sources: MotoROS 1.9.12 (MotionServer.c, Controller.c, CtrlGroup.c) and, for the velocity mode,
docs/protocols/motoros-velocity-mode.md. Where MotoROS leaves something to the controller that it
runs on, this is decided so:

- An increment more than a tenth above an axis's highest speed, or out of its range, is refused,
  which latches INC_MOVE_ERROR. Increments that come while an input forbids motion are not executed
  and latch nothing: the poll that clears the queue is at most 10 ms away.
- Whatever stops motion stops the job INIT_ROS; a collaborative stop alone only suspends it.
- Alarms below 4000 are major: they take the servos off, and only an operator resets them.
"""

from __future__ import annotations

import functools
import heapq
import itertools
import math
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence

from cardan.protocols.simple_message import (
    DH_LINKS,
    JOINTS,
    MAX_GROUPS,
    ZEROS,
    ActiveMode,
    CommType,
    ControllerMode,
    DhLink,
    DhParameters,
    Empty,
    InvalidSubcode,
    JointFeedback,
    Joints,
    JointTrajPtFull,
    JointTrajPtFullEx,
    JointVelocity,
    JointVelocityEx,
    Message,
    MessageType,
    MotionCommand,
    MotionCtrl,
    MotionReply,
    MotionResult,
    NotReadySubcode,
    RobotStatus,
    SelectTool,
    ValidFields,
    VelocityInfo,
    VelocityInfoRequest,
    joints10,
    reply,
)
from cardan.sim_peers.motoros_controller.dh import dh_table
from cardan.sim_peers.motoros_controller.group import START_PULSES, ControlGroup
from cardan.sim_peers.motoros_controller.inputs import POLL_S, Inputs, not_ready_reason
from cardan.sim_peers.motoros_controller.options import MotorosControllerOptions
from cardan.sim_peers.motoros_controller.plant import Plant
from cardan.sim_peers.motoros_controller.velocity import VelocityLaw, is_newer

BURST_S = 0.1
"""After a stall no more than this is made up for; the rest of the time did not happen."""
TASK_END_S = 0.05
"""The increment task outlives the motion connection by this."""
LONGEST_TIME_S = 14400.0
"""Points of type 14 are refused from here on."""
TOOLS = 64

VELOCITY_VERSION = 1
DEFAULT_WATCHDOG_MS = 100.0
SHORTEST_WATCHDOG_MS, LONGEST_WATCHDOG_MS = 20.0, 500.0
SMALLEST_ACCELERATION_SCALE = 0.01

FIRST_SIGNAL = 11120
"""Bit address of MotoROS's first feedback output."""

_REFUSED_TYPES = frozenset(
    {
        MessageType.ROBOT_STATUS,
        MessageType.JOINT_FEEDBACK,
        MessageType.MOTO_MOTION_REPLY,
        MessageType.MOTO_JOINT_FEEDBACK_EX,
    }
)
"""Known, but not served: the motion server closes the connection."""
_VELOCITY_TYPES = frozenset({MessageType.MOTO_JOINT_VELOCITY, MessageType.MOTO_JOINT_VELOCITY_EX})
_TRAJECTORY_FIELDS = ValidFields.TIME | ValidFields.POSITION | ValidFields.VELOCITY
_WAIT_S = 5.0
_CHECK_S = 0.05
_STOP_WAIT_S = 0.02
_STOP_CHECK_S = 0.001
_FIRST_MINOR_ALARM = 4000
_TOLERANCE_S = 1e-9
_KEPT_EVENTS = 1000

_Steps = Generator[float, None, bool]
"""A server's task that waits: it yields for how long, and returns whether it succeeded."""


class _Stream:
    """The velocity commands of one group: one slot, the newest wins."""

    def __init__(self, accelerations: Sequence[float]) -> None:
        self.armed = False
        self.latched = False
        """Was armed, until the watchdog or STOP_MOTION."""
        self.sequence = 0
        self.target: list[float] | None = None
        """rad/s; None: nothing to follow."""
        self.accelerations = list(accelerations)
        self.heard_s = -math.inf
        self.unused = False
        self.age_ms = 0.0
        """Of the command that was used last, when it was first used."""
        self.overwritten = 0
        self.offset_s = math.inf
        """Smallest difference of local time and the sender's."""
        self.worst_lateness_s = 0.0

    def disarm(self, latched: bool = False) -> None:
        self.latched = latched and (self.armed or self.latched)
        self.armed = False
        self.target = None
        self.unused = False


class MotorosController:
    """The motion side of one controller.

    All times are monotonic s and never go back; the first call starts the clock. Call `advance`
    at `next_s`, hand each message of the motion connection to `motion` while not `blocked`, and
    send what is in `replies`.
    """

    def __init__(self, options: MotorosControllerOptions | None = None) -> None:
        self.options = options = MotorosControllerOptions() if options is None else options
        self.arm = arm = options.arm
        self.axes = len(arm.joints)
        self.groups = options.groups
        self._ipc_s = options.ipc_s
        start = arm.home if options.start is None else options.start
        self._per_rad = options.axis_pulses
        accelerations = options.axis_accelerations
        self._groups = [
            ControlGroup(
                self._per_rad,
                options.axis_speeds,
                arm.lower,
                arm.upper,
                start,
                options.ipc_s,
                options.queue_increments,
            )
            for _ in range(options.groups)
        ]
        self._plants = [
            Plant(options.plant_model, options.ipc_s, group.command) for group in self._groups
        ]
        self._laws = [
            VelocityLaw(
                options.axis_speeds,
                accelerations,
                arm.lower,
                arm.upper,
                self._per_rad,
                options.ipc_s,
            )
            for _ in self._groups
        ]
        self._streams = [_Stream(accelerations) for _ in self._groups]
        self._executed: list[Sequence[int]] = [[0] * self.axes for _ in self._groups]
        self._nothing = [0] * self.axes
        self._inputs = Inputs(servo=options.servo_on, play=options.play, remote=options.remote)
        self._seen = self._inputs.copy()
        """As the last poll saw them."""
        self._job_ready = False
        self._suspended = False
        """Old firmware: the job goes on when play is back."""
        self._collaborative_stop = False
        self._increment_error = False
        self._stopping = False
        self._connected = False
        self._task_ends_s = math.inf
        self._task_runs = False
        self._old = options.old_firmware
        self._speed_share: float | None = None
        self._refuse_next = False
        self._fields = 2 if self._old else options.feedback_fields

        self._velocity_on = False
        self._leaving = False
        """The velocity mode ends at standstill."""
        self._latched = False
        self._watchdog_ms = DEFAULT_WATCHDOG_MS
        self._acceleration_scale = 1.0

        self.replies: list[Message] = []
        """Answers to send, oldest first; whoever sends them takes them out."""
        self.close_requested = False
        """The motion connection is to be closed; whoever does so resets it."""
        self.velocities_accepted = self.velocities_refused = 0
        """Messages 2040 and 2041 since the start."""
        self.connections: set[str] = set()
        """Of "motion", "state" and "io", those that have a client; the servers keep it."""
        self.events: deque[tuple[float, str]] = deque(maxlen=_KEPT_EVENTS)
        """What happened lately, with its time."""
        self.log: list[tuple[float | int | str, ...]] = []
        """Group 0, one row an IPC, when options.log is given; whoever writes it empties it."""
        self._last_reply = reply(MotionReply(0, 0, 0, 0, 0))
        self._newest_command_s = -math.inf

        self._now_s = -math.inf
        self._start_s = math.nan
        self._ticks = self._polls = 0
        self._tick_s = self._poll_s = -math.inf
        self._steps: _Steps | None = None
        self._resume_s = math.inf
        self._timers: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()

    # -- time -------------------------------------------------------------------------------------

    @property
    def next_s(self) -> float:
        """When `advance` has something to do next; -inf before the first call."""
        if self._now_s == -math.inf:
            return -math.inf
        timer_s = self._timers[0][0] if self._timers else math.inf
        return min(self._tick_s, self._poll_s, self._resume_s, timer_s)

    def advance(self, now_s: float) -> None:
        """Everything that is due up to `now_s`: IPCs, polls of the inputs, waiting tasks."""
        if self._now_s == -math.inf:
            self._begin_time(now_s)
        if now_s <= self._now_s:
            return
        if now_s - self._tick_s > BURST_S + self._ipc_s:
            self._stand_still(now_s - self._tick_s - BURST_S)
        until_s = now_s + _TOLERANCE_S
        while True:
            timer_s = self._timers[0][0] if self._timers else math.inf
            due_s = min(self._tick_s, self._poll_s, self._resume_s, timer_s)
            if due_s > until_s:
                break
            self._now_s = max(self._now_s, due_s)
            if timer_s == due_s:
                heapq.heappop(self._timers)[2]()
            elif self._poll_s == due_s:
                self._polls += 1
                self._poll_s = self._start_s + self._polls * POLL_S
                self._poll()
            elif self._resume_s == due_s:
                self._resume()
            else:
                self._ticks += 1
                self._tick_s = self._start_s + self._ticks * self._ipc_s
                self._tick()
        self._now_s = now_s

    def _begin_time(self, now_s: float) -> None:
        self._now_s = self._start_s = now_s
        self._ticks = self._polls = 1
        self._tick_s, self._poll_s = now_s + self._ipc_s, now_s + POLL_S
        acts: dict[str, Callable[[float], None]] = {
            "remote-off": lambda at_s: self.remote(False, at_s),
            "job-stop": self.job_stop,
            "energy-saving": lambda at_s: self.energy_saving(True, at_s),
            "increment-error": self.increment_error,
        }
        for name, act in acts.items():
            if name in self.options.faults:
                self._after(self.options.faults[name], functools.partial(self._act_now, act))

    def _act_now(self, act: Callable[[float], None]) -> None:
        act(self._now_s)

    def _stand_still(self, lost_s: float) -> None:
        """This process did not run: the controller's clock stood still, and nobody was late."""
        lost_s = math.floor(lost_s / self._ipc_s) * self._ipc_s
        self._note(f"the simulation stood still for {lost_s:.3f} s")
        self._start_s += lost_s
        self._tick_s += lost_s
        self._poll_s += lost_s
        self._resume_s += lost_s
        self._task_ends_s += lost_s
        self._timers = [(due_s + lost_s, order, act) for due_s, order, act in self._timers]
        for stream in self._streams:
            stream.heard_s += lost_s

    def _after(self, delay_s: float, act: Callable[[], None]) -> None:
        heapq.heappush(self._timers, (self._now_s + delay_s, next(self._count), act))

    def _note(self, text: str) -> None:
        self.events.append((self._now_s, text))

    # -- connections ------------------------------------------------------------------------------

    def connected(self, now_s: float) -> None:
        """A client of the motion port has come. What a queue still holds is executed now."""
        self.advance(now_s)
        if self._connected or self._task_ends_s < math.inf:
            # Its place is taken at once: the tasks end before the new ones begin.
            self._end_tasks()
        self._connected = self._task_runs = True
        self._task_ends_s = math.inf
        self._steps, self._resume_s, self._stopping = None, math.inf, False
        self._last_reply = reply(MotionReply(0, 0, 0, 0, 0))
        if any(group.queue for group in self._groups):
            self._note("a new client; the queue still holds increments")

    def disconnected(self, now_s: float) -> None:
        """The client of the motion port has gone.

        A trajectory stops dead TASK_END_S later, with its queue kept; the velocity mode ramps to
        zero and ends.
        """
        self.advance(now_s)
        self._connected = False
        if self._task_runs:
            self._task_ends_s = self._now_s + TASK_END_S
        if self._velocity_on:
            self._forget_commands()
            self._leaving = True
            self._note("motion connection closed: the velocity mode ends")

    def _end_tasks(self) -> None:
        self._task_runs = False
        self._task_ends_s = math.inf
        for group in self._groups:
            if group.has_data:
                # The filler is deleted, which is what a controller that is not ready does too.
                group.fill(False)
            group.forget_owed()

    @property
    def moving_data(self) -> bool:
        """A queue holds increments or the arm is commanded to move: nobody else may come."""
        return any(group.holding_data for group in self._groups) or not self._still

    @property
    def blocked(self) -> bool:
        """The motion server waits inside a message and takes no other one."""
        return self._steps is not None

    # -- what others see --------------------------------------------------------------------------

    def status(self) -> RobotStatus:
        """ROBOT_STATUS."""
        seen = self._seen
        lagging = any(
            abs(measured - command) > START_PULSES
            for plant, group in zip(self._plants, self._groups, strict=True)
            for measured, command in zip(plant.measured, group.command, strict=True)
        )
        return RobotStatus(
            drives_powered=int(seen.drives_powered),
            e_stopped=int(seen.estop),
            error_code=seen.alarm,
            in_error=int(seen.alarm != 0),
            in_motion=int(lagging or self.moving_data),
            mode=ControllerMode.AUTO if seen.play else ControllerMode.MANUAL,
            motion_possible=int(self.ready and not self._latched),
        )

    def feedback(self, group: int) -> JointFeedback:
        """JOINT_FEEDBACK of one group, from its encoders."""
        plant = self._plants[group]
        speeds = ZEROS
        if self._fields & ValidFields.VELOCITY:
            speeds = joints10(
                change / each / self._ipc_s
                for change, each in zip(plant.change, self._per_rad, strict=True)
            )
        return JointFeedback(
            group, self._fields, 0.0, joints10(self.measured_rad(group)), speeds, ZEROS
        )

    def signals(self) -> Mapping[int, bool]:
        """MotoROS's feedback outputs by bit address; the first two are those of INIT_ROS."""
        connections = self.connections
        values = (
            self._inputs.waiting,
            not self._inputs.operating,
            True,
            True,
            "motion" in connections,
            "state" in connections,
            "io" in connections,
            False,
        )
        return {FIRST_SIGNAL + bit: value for bit, value in enumerate(values)}

    @property
    def ready(self) -> bool:
        """MotoROS's motion-ready predicate, from the inputs as the last poll saw them."""
        seen = self._seen
        return (
            self._job_ready
            and seen.operating
            and seen.remote
            and not (self._collaborative_stop or self._increment_error or self._stopping)
        )

    @property
    def active_mode(self) -> ActiveMode:
        """What may be commanded now."""
        if self._velocity_on:
            return ActiveMode.VELOCITY
        return ActiveMode.TRAJECTORY if self.ready else ActiveMode.NONE

    @property
    def newest_command_age_s(self) -> float:
        """Time since a point or a velocity was accepted; inf before the first."""
        return self._now_s - self._newest_command_s

    @property
    def worst_lateness_s(self) -> float:
        """By how much the latest velocity command trailed the promptest, by its sender's time."""
        return max(stream.worst_lateness_s for stream in self._streams)

    def command_pulses(self, group: int) -> tuple[int, ...]:
        """The commanded position."""
        return tuple(self._groups[group].command)

    def command_rad(self, group: int) -> tuple[float, ...]:
        """The commanded position, rad or m."""
        return tuple(
            pulses / each
            for pulses, each in zip(self._groups[group].command, self._per_rad, strict=True)
        )

    def measured_rad(self, group: int) -> tuple[float, ...]:
        """What the encoders say, whole pulses in rad or m."""
        return tuple(
            int(pulses) / each
            for pulses, each in zip(self._plants[group].measured, self._per_rad, strict=True)
        )

    def velocity_rad_s(self, group: int) -> tuple[float, ...]:
        """The commanded speed: the velocity mode's, else what the last increments make."""
        if self._velocity_on:
            return tuple(self._laws[group].velocity)
        return tuple(
            pulses / each / self._ipc_s
            for pulses, each in zip(self._executed[group], self._per_rad, strict=True)
        )

    def queue_count(self, group: int) -> int:
        """Increments in the queue."""
        return len(self._groups[group].queue)

    def tool(self, group: int) -> int:
        """The tool that SELECT_TOOL chose."""
        return self._groups[group].tool

    @property
    def _still(self) -> bool:
        return not self._velocity_on or all(law.still for law in self._laws)

    # -- the operator's hands ---------------------------------------------------------------------

    def emergency_stop(self, now_s: float) -> None:
        """Press an emergency stop: servos off, job stopped."""
        self.advance(now_s)
        self._note("emergency stop")
        self._inputs.estop = True
        self._inputs.servo = False
        self._stop_job()

    def release_emergency_stop(self, now_s: float) -> None:
        """Pull it out again; the servos stay off."""
        self.advance(now_s)
        self._note("emergency stop released")
        self._inputs.estop = False

    def alarm(self, code: int, now_s: float) -> None:
        """Raise an alarm; below 4000 it is a major one."""
        self.advance(now_s)
        self._note(f"alarm {code}")
        self._inputs.alarm = code
        if code < _FIRST_MINOR_ALARM:
            self._inputs.servo = False
        self._stop_job()

    def error(self, code: int, now_s: float) -> None:
        """Raise an error, which is less than an alarm; it stops the job too."""
        self.advance(now_s)
        self._note(f"error {code}")
        self._inputs.error = code
        self._stop_job()

    def reset_alarm(self, now_s: float) -> None:
        """Reset alarms and errors at the pendant, major ones too."""
        self.advance(now_s)
        self._note("alarms reset")
        self._inputs.alarm = self._inputs.error = 0

    def servo(self, on: bool, now_s: float) -> None:
        """Servo power, at once; an emergency stop or a major alarm keeps it off."""
        self.advance(now_s)
        if not on:
            self._note("servo power off")
            self._inputs.servo = False
            self._stop_job()
        elif self._servo_can_be_on:
            self._note("servo power on")
            self._inputs.servo = True

    def mode(self, which: str, now_s: float) -> None:
        """Turn the key to "play" or "teach"."""
        if which not in ("play", "teach"):
            raise ValueError(f"mode {which!r} is neither 'play' nor 'teach'")
        self.advance(now_s)
        self._note(f"mode {which}")
        self._inputs.play = which == "play"
        if which == "teach":
            self._suspended = self._suspended or (self._old and self._inputs.operating)
            self._inputs.operating = False
        elif self._suspended:
            self._suspended = False
            self._inputs.operating = True

    def remote(self, on: bool, now_s: float) -> None:
        """Give or take remote control."""
        self.advance(now_s)
        self._note(f"remote {'on' if on else 'off'}")
        self._inputs.remote = on
        if not on:
            self._stop_job()

    def hold(self, on: bool, now_s: float) -> None:
        """Press or release hold; the job does not go on by itself."""
        self.advance(now_s)
        self._note(f"hold {'on' if on else 'off'}")
        self._inputs.hold = on
        if on:
            self._stop_job()

    def energy_saving(self, on: bool, now_s: float) -> None:
        """The drives go to sleep after long standstill, or are woken."""
        self.advance(now_s)
        self._note(f"energy saving {'on' if on else 'off'}")
        self._inputs.energy_saving = on

    def collaborative_stop(self, now_s: float) -> None:
        """The arm touches somebody; latched until START_TRAJ_MODE."""
        self.advance(now_s)
        self._note("collaborative stop")
        self._inputs.collaborative_stop = True

    def speed_limit(self, fraction: float | None, now_s: float) -> None:
        """The functional safety unit lets this share of the axes' speeds through; None: all."""
        if fraction is not None and not 0.0 <= fraction <= 1.0:
            raise ValueError(f"speed limit {fraction!r} is not within 0 to 1")
        self.advance(now_s)
        self._note("no speed limit" if fraction is None else f"speed limit {fraction:g}")
        self._speed_share = fraction

    def job_stop(self, now_s: float) -> None:
        """Stop the job INIT_ROS."""
        self.advance(now_s)
        self._note("job stopped")
        self._stop_job()

    def increment_error(self, now_s: float) -> None:
        """The next increments are refused."""
        self.advance(now_s)
        self._refuse_next = True

    def _stop_job(self) -> None:
        self._inputs.operating = False
        self._suspended = False

    @property
    def _servo_can_be_on(self) -> bool:
        inputs = self._inputs
        return not inputs.estop and not 0 < inputs.alarm < _FIRST_MINOR_ALARM

    # -- polls and IPCs ---------------------------------------------------------------------------

    def _poll(self) -> None:
        """Take over the inputs, and what MotoROS does when they changed."""
        inputs, before = self._inputs, self._seen
        if inputs.collaborative_stop:
            inputs.collaborative_stop = False
            if self._job_ready:
                self._collaborative_stop = True
                self._clear("collaborative stop")
        if inputs.waiting and not before.waiting:
            self._job_ready = True
        elif before.waiting and not inputs.waiting:
            self._job_ready = False
            self._clear("INIT_ROS has left its WAIT line")
        self._seen = inputs.copy()
        if self._job_ready and not (inputs.operating and inputs.remote and inputs.servo):
            if self._old:
                self._leave_velocity_mode()
            else:
                self._job_ready = False
                self._clear("motion is no longer possible")
        elif self._velocity_on and inputs.energy_saving:
            self._leave_velocity_mode()
            self._note("energy saving ends the velocity mode")

    def _clear(self, reason: str) -> None:
        """Queues and points go, and with them what moved."""
        if self.moving_data or any(group.has_data for group in self._groups):
            self._note(f"motion ends: {reason}")
        for group in self._groups:
            group.clear()
        self._leave_velocity_mode()

    def _leave_velocity_mode(self) -> None:
        if self._velocity_on:
            for group, law in zip(self._groups, self._laws, strict=True):
                law.halt()
                group.restart()
        self._forget_commands()
        self._velocity_on = self._leaving = self._latched = False

    def _tick(self) -> None:
        """One IPC: the increment task, then the fillers, then the arm follows."""
        now_s, groups = self._now_s, self._groups
        if now_s >= self._task_ends_s - _TOLERANCE_S:
            self._end_tasks()
            self._note("motion connection closed: the increment task ends")
        moves = self._inputs.moves
        for index in range(len(groups)):
            self._executed[index] = self._nothing
        if self._velocity_on:
            self._tick_velocity(moves)
        elif self._task_runs and any(group.queue or group.owes for group in groups) and self.ready:
            if moves:
                self._tick_trajectory()
        else:
            for group in groups:
                group.forget_owed()
        for index, group in enumerate(groups):
            if group.has_data and self._task_runs:
                group.fill(self.ready)
            self._plants[index].step(group.command)
        if self.options.log:
            self._log()

    def _tick_trajectory(self) -> None:
        groups, resend, share = self._groups, not self._old, self._speed_share
        wanted = [group.take(resend) for group in groups]
        if self._refuse_next or any(
            group.refuses(each) for group, each in zip(groups, wanted, strict=True)
        ):
            self._refuse()
            return
        for index, (group, each) in enumerate(zip(groups, wanted, strict=True)):
            executed = each if share is None else group.limited(each, share)
            group.execute(executed, resend)
            self._executed[index] = executed

    def _refuse(self) -> None:
        self._refuse_next = False
        self._increment_error = True
        self._clear("the controller refuses an increment")

    def _tick_velocity(self, moves: bool) -> None:
        now_s = self._now_s
        for stream in self._streams:
            if stream.armed and (now_s - stream.heard_s) * 1e3 > self._watchdog_ms + 1e-6:
                self._note("velocity watchdog")
                self._latch()
                break
        if not moves:
            for law in self._laws:
                law.halt()
            return
        if self._refuse_next and not self._still:
            self._refuse()
            return
        for index, (group, law, stream) in enumerate(
            zip(self._groups, self._laws, self._streams, strict=True)
        ):
            if stream.unused:
                stream.unused = False
                stream.age_ms = (now_s - stream.heard_s) * 1e3
            increments: Sequence[int] = law.step(stream.target, stream.accelerations)
            if self._speed_share is not None:
                executed = group.limited(increments, self._speed_share)
                if executed is not increments:
                    group.execute(executed, False)
                    law.discard(group.command)
                    self._executed[index] = executed
                    continue
            group.execute(increments, False)
            self._executed[index] = increments
        if self._leaving and self._still:
            self._leave_velocity_mode()
            self._note("the velocity mode has ended")

    @property
    def log_columns(self) -> tuple[str, ...]:
        """What is in a row of `log`. The age is that of the newest accepted command; counts are of
        messages of velocity since the start."""
        names = self.arm.joint_names
        return (
            "time_s",
            "mode",
            "queue",
            "command_age_s",
            "accepted",
            "refused",
            *[f"command_{name}" for name in names],
            *[f"measured_{name}" for name in names],
        )

    def _log(self) -> None:
        self.log.append(
            (
                self._now_s,
                self.active_mode.name.lower(),
                len(self._groups[0].queue),
                self.newest_command_age_s,
                self.velocities_accepted,
                self.velocities_refused,
                *self.command_rad(0),
                *self.measured_rad(0),
            )
        )

    # -- the motion server ------------------------------------------------------------------------

    def motion(self, message: Message, now_s: float) -> None:
        """One message of the motion connection, not while `blocked`.

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
            self._answer(message, -1, -1, msg_type, MotionResult.INVALID, InvalidSubcode.MSGTYPE)

    def _send(self, asked: Message, answer: Message) -> None:
        self._last_reply = answer
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
        command: int,
        result: int,
        subcode: int = 0,
        data: Joints = ZEROS,
    ) -> None:
        self._send(asked, reply(MotionReply(group, sequence, command, result, subcode, data)))

    def _reason(self) -> int:
        """The NOT_READY subcode that applies."""
        return not_ready_reason(
            self._seen, self._job_ready, self._collaborative_stop, self._increment_error
        )

    # -- points of trajectories -------------------------------------------------------------------

    def _refusal(self) -> int:
        """Why no point is taken now, a NOT_READY subcode; 0 when one is."""
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
        elif not point.time < LONGEST_TIME_S:
            result, subcode = MotionResult.INVALID, int(InvalidSubcode.DATA_TIME)
        elif point.sequence == 0 and self._inputs.energy_saving:
            self._start(self._wake_for_point(asked, point))
            return
        else:
            self._take_point(asked, point.sequence, point)
            return
        self._answer(asked, point.group, point.sequence, asked.msg_type, result, subcode)

    def _wake_for_point(self, asked: Message, point: JointTrajPtFull) -> _Steps:
        yield from self._wake()
        refusal = self._refusal()
        if refusal:
            self._answer(
                asked,
                point.group,
                point.sequence,
                asked.msg_type,
                MotionResult.NOT_READY,
                refusal,
            )
            return False
        self._take_point(asked, point.sequence, point)
        return True

    def _take_point(
        self,
        asked: Message,
        sequence: int,
        point: JointTrajPtFull | JointFeedback,
        answered: bool = True,
    ) -> bool:
        """Whether the point was taken; a refusal is always answered, success if `answered`."""
        group = self._groups[point.group]
        result, subcode = MotionResult.SUCCESS, 0
        if not all(map(math.isfinite, (point.time, *point.pos, *point.vel))):
            # C makes some integer of it, which the arm's own checks refuse sooner or later.
            result, subcode = MotionResult.INVALID, int(InvalidSubcode.DATA)
        elif sequence < 0:
            result, subcode = MotionResult.INVALID, int(InvalidSubcode.SEQUENCE)
        elif sequence == 0:
            subcode = group.begin(point.time, point.pos, point.vel)
        elif group.has_data:
            result = MotionResult.BUSY
        else:
            subcode = group.add(point.time, point.pos, point.vel)
        if subcode:
            result = MotionResult.INVALID
        good = result == MotionResult.SUCCESS
        if good:
            self._newest_command_s = self._now_s
        if answered or not good:
            self._answer(asked, point.group, sequence, asked.msg_type, result, subcode)
        return good

    def _points(self, asked: Message, body: JointTrajPtFullEx) -> None:
        sequence, points = body.sequence, body.points
        if not points:
            # The loops over groups do nothing: what the last message was answered with goes out.
            self._send(asked, self._last_reply)
            return
        refusal = self._refusal()
        if refusal:
            self._answer(
                asked,
                points[-1].group,
                sequence,
                asked.msg_type,
                MotionResult.NOT_READY,
                refusal,
            )
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
            self._answer(asked, point.group, sequence, asked.msg_type, result, subcode)
            return
        if sequence == 0 and self._inputs.energy_saving:
            self._start(self._wake_for_points(asked, body))
            return
        self._take_points(asked, body)

    def _wake_for_points(self, asked: Message, body: JointTrajPtFullEx) -> _Steps:
        yield from self._wake()
        self._points(asked, body)
        return True

    def _take_points(self, asked: Message, body: JointTrajPtFullEx) -> None:
        last = len(body.points) - 1
        for index, point in enumerate(body.points):
            if not self._take_point(asked, body.sequence, point, index == last):
                return

    # -- tools and kinematics ---------------------------------------------------------------------

    def _select_tool(self, asked: Message, body: SelectTool) -> None:
        result, subcode = MotionResult.INVALID, 0
        if not 0 <= body.group < self.groups:
            subcode = InvalidSubcode.GROUPNO
        elif not 0 <= body.tool < TOOLS:
            subcode = InvalidSubcode.DATA_TOOLNO
        else:
            result = MotionResult.SUCCESS
            self._groups[body.group].tool = body.tool
        self._answer(asked, body.group, body.sequence, asked.msg_type, result, subcode)

    def _dh_parameters(self) -> DhParameters:
        nothing = DhLink(0.0, 0.0, 0.0, 0.0)
        links = dh_table(self.arm).links
        filled = (*links, *[nothing] * (DH_LINKS - len(links)))
        empty = (nothing,) * DH_LINKS
        return DhParameters((*[filled] * self.groups, *[empty] * (MAX_GROUPS - self.groups)))

    # -- MOTION_CTRL ------------------------------------------------------------------------------

    def _control(self, asked: Message, control: MotionCtrl) -> None:
        command = control.command
        tasks: Mapping[int, Callable[[Message, MotionCtrl], _Steps]] = {
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
            # MotoROS has no branch for it: the buffer still holds the reply before.
            self._send(asked, self._last_reply)

    def _done(
        self,
        asked: Message,
        control: MotionCtrl,
        result: int,
        subcode: int = 0,
        data: Joints = ZEROS,
    ) -> None:
        self._answer(asked, control.group, control.sequence, control.command, result, subcode, data)

    def _check_motion_ready(self, asked: Message, control: MotionCtrl) -> None:
        if self.ready and not self._latched:
            self._done(asked, control, MotionResult.SUCCESS)
            return
        reason = NotReadySubcode.VEL_WATCHDOG if self.ready else self._reason()
        self._done(asked, control, MotionResult.FAILURE, 0 if self._old else reason)

    def _start(self, steps: _Steps) -> None:
        """Begin a task of the motion server, which may wait."""
        self._steps = steps
        self._resume()

    def _resume(self) -> None:
        steps = self._steps
        assert steps is not None
        self._resume_s = math.inf
        try:
            delay_s = next(steps)
        except StopIteration:
            if self._steps is steps:
                self._steps = None
            return
        self._resume_s = self._now_s + delay_s

    def _do_stop_motion(self, asked: Message, control: MotionCtrl) -> _Steps:
        stopped = yield from self._stop_motion()
        result = MotionResult.SUCCESS if stopped else MotionResult.FAILURE
        self._done(asked, control, result)
        return stopped

    def _stop_motion(self) -> _Steps:
        """Let the fillers come to an end, then empty the queues. The velocity mode ramps down and
        latches instead, while this goes on at once."""
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

    def _do_start_servos(self, asked: Message, control: MotionCtrl) -> _Steps:
        good = yield from self._power()
        self._done(asked, control, MotionResult.SUCCESS if good else MotionResult.FAILURE)
        return good

    def _do_stop_servos(self, asked: Message, control: MotionCtrl) -> _Steps:
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
        """Errors, and those alarms that are not major."""
        self._inputs.error = 0
        if self._inputs.alarm >= _FIRST_MINOR_ALARM:
            self._inputs.alarm = 0
        self._poll()

    def _wake(self) -> Generator[float, None, None]:
        """Leave energy saving."""
        if self._inputs.energy_saving:
            yield self.options.eco_wake_s
            self._inputs.energy_saving = False
            self._poll()

    def _power(self) -> _Steps:
        """Servo on, waiting for it at most 5 s."""
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

    def _do_start_trajectory_mode(self, asked: Message, control: MotionCtrl) -> _Steps:
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

    def _start_job(self) -> _Steps:
        """Everything that START_TRAJ_MODE does until motion is possible."""
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
        """Start INIT_ROS, if the controller lets a job be started."""
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
        self._after(max(0.0, self.options.job_start_s - POLL_S), wait_line)
        return True

    def _do_stop_trajectory_mode(self, asked: Message, control: MotionCtrl) -> _Steps:
        """STOP_TRAJ_MODE, and DISCONNECT, which closes the connection besides."""
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

    # -- the velocity mode ------------------------------------------------------------------------

    def _velocity_info(self, asked: Message, body: VelocityInfoRequest) -> None:
        if not 0 <= body.group < self.groups:
            self._answer(
                asked,
                body.group,
                -1,
                asked.msg_type,
                MotionResult.INVALID,
                InvalidSubcode.GROUPNO,
            )
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

    def _do_start_velocity_mode(self, asked: Message, control: MotionCtrl) -> _Steps:
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
        self._velocity_on, self._leaving, self._latched = True, False, False
        for group, law in zip(self._groups, self._laws, strict=True):
            law.place(group.command)
            law.clear_masks()
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
        self._forget_commands()
        if self._still:
            self._leave_velocity_mode()
        else:
            self._leaving = True
        self._done(asked, control, MotionResult.SUCCESS, 0, joints10((ramp_s,)))

    def _forget_commands(self) -> None:
        for stream in self._streams:
            stream.disarm()

    def _latch(self) -> None:
        """Ramp to zero, and take nothing but sequence 0."""
        self._latched = True
        for stream in self._streams:
            stream.disarm(latched=True)

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
                data = self._statistics(group)
        else:
            self.velocities_refused += 1
        self._answer(asked, group, sequence, asked.msg_type, result, subcode, data)

    def _velocity_verdict(
        self, sequence: int, commands: tuple[JointFeedback, ...]
    ) -> tuple[int, int]:
        """Result and subcode for these commands, all groups or none."""
        not_ready, invalid = MotionResult.NOT_READY, MotionResult.INVALID
        if not self.ready:
            return not_ready, self._reason()
        if not self._velocity_on or self._leaving:
            return not_ready, NotReadySubcode.NOT_IN_VEL_MODE
        if not commands:
            return invalid, InvalidSubcode.DATA
        if sequence < 0:
            return invalid, InvalidSubcode.SEQUENCE
        for command in commands:
            if not 0 <= command.group < self.groups:
                return invalid, InvalidSubcode.GROUPNO
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
                    if self._latched or stream.latched:
                        return not_ready, NotReadySubcode.VEL_WATCHDOG
                    return invalid, InvalidSubcode.VEL_SEQUENCE
                if not is_newer(sequence, stream.sequence):
                    return invalid, InvalidSubcode.VEL_SEQUENCE
        return MotionResult.SUCCESS, 0

    def _take_velocity(self, sequence: int, command: JointFeedback) -> None:
        """Sequence 0 arms, whatever was before. The sender's time does not decide about stale
        commands, the sequence does; it tells how late they come."""
        stream, now_s = self._streams[command.group], self._now_s
        if sequence == 0:
            self._latched = False
            stream.armed = True
            stream.offset_s = math.inf
            stream.worst_lateness_s = 0.0
        if stream.unused:
            stream.overwritten += 1
        stream.sequence = sequence
        stream.heard_s = self._newest_command_s = now_s
        stream.unused = True
        stream.target = list(command.vel[: self.axes])
        given = command.valid_fields & ValidFields.ACCELERATION
        for axis, own in enumerate(self._laws[command.group].accelerations_rad_s2):
            limit = own * self._acceleration_scale
            asked = command.acc[axis]
            stream.accelerations[axis] = min(asked, limit) if given and asked > 0.0 else limit
        if command.valid_fields & ValidFields.TIME:
            offset_s = now_s - command.time
            stream.offset_s = min(stream.offset_s, offset_s)
            stream.worst_lateness_s = max(stream.worst_lateness_s, offset_s - stream.offset_s)

    def _statistics(self, group: int) -> Joints:
        """What became of the commands since the last reply: limited axes, age, overwritten ones.

        The command that is answered acts from the next IPC on and is not among them.
        """
        law, stream = self._laws[group], self._streams[group]
        data = (
            float(law.speed_mask),
            float(law.acceleration_mask),
            float(law.position_mask),
            stream.age_ms,
            float(stream.overwritten),
        )
        law.clear_masks()
        stream.overwritten = 0
        return data + ZEROS[: JOINTS - len(data)]
