"""The robot behind the motion server: time, inputs, operator actions, and a moving arm.

`controller` handles the messages; this module runs the time between them: the inputs are polled,
tasks of the server wait, and every interpolation period (IPC) the arm is commanded and follows.

Sources: MotoROS 1.9.12 (Controller.c, CtrlGroup.c, MotionServer.c) and, for the velocity mode,
docs/protocols/simple-message.md. Decisions for behavior that MotoROS leaves to the controller:

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
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence

from cardan.protocols.simple_message.codes import ActiveMode, ControllerMode, ValidFields
from cardan.protocols.simple_message.messages import (
    ZEROS,
    JointFeedback,
    Joints,
    RobotStatus,
    joints10,
)
from cardan.sim_peers.motoros_controller.group import START_PULSES, ControlGroup
from cardan.sim_peers.motoros_controller.inputs import POLL_S, Inputs
from cardan.sim_peers.motoros_controller.options import MotorosControllerOptions
from cardan.sim_peers.motoros_controller.plant import Plant
from cardan.sim_peers.motoros_controller.velocity import GroupVelocityStream, VelocityLaw

BURST_S = 0.1
"""Longest time that is made up for after a stall; the rest is skipped."""
DEFAULT_WATCHDOG_MS = 100.0
FIRST_MINOR_ALARM = 4000
FIRST_SIGNAL = 11120
"""Bit address of MotoROS's first feedback output."""

_TOLERANCE_S = 1e-9
_MAX_EVENTS = 1000

Steps = Generator[float, None, bool]
"""Waiting task of a server: it yields how long to wait, and returns whether it succeeded."""


class MotomanRobot:
    """The arms of a controller, and the actions of its operator.

    All times are monotonic s and never go back; the first call starts the clock.
    """

    def __init__(self, options: MotorosControllerOptions) -> None:
        self.options = options
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
        self._streams = [GroupVelocityStream(accelerations) for _ in self._groups]
        self._executed: list[Sequence[int]] = [[0] * self.axes for _ in self._groups]
        self._nothing = [0] * self.axes
        self._inputs = Inputs(servo=options.servo_on, play=options.play, remote=options.remote)
        self._seen = self._inputs.copy()
        """Inputs at the last poll."""
        self._job_ready = False
        self._suspended = False
        """Old firmware: the job continues when play is back."""
        self._collaborative_stop = False
        self._increment_error = False
        self._stopping = False
        self._task_ends_s = math.inf
        self._task_runs = False
        self._old = options.old_firmware
        self._speed_share: float | None = None
        self._refuse_next = False
        self._fields = 2 if self._old else options.feedback_fields

        self._velocity_on = False
        self._leaving = False
        """The velocity mode ends at standstill."""
        self._watchdog_ms = DEFAULT_WATCHDOG_MS
        self._acceleration_scale = 1.0

        self.velocities_accepted = self.velocities_refused = 0
        """Messages 2040 and 2041 since the start."""
        self.connections: set[str] = set()
        """Ports with a client, of "motion", "state" and "io"; kept by the servers."""
        self.events: deque[tuple[float, str]] = deque(maxlen=_MAX_EVENTS)
        """Recent events, with their times."""
        self.log: list[tuple[float | int | str, ...]] = []
        """Group 0, one row an IPC, when options.log is given; the writer empties it."""
        self._newest_command_s = -math.inf

        self._now_s = -math.inf
        self._start_s = math.nan
        self._ticks = self._polls = 0
        self._tick_s = self._poll_s = -math.inf
        self._steps: Steps | None = None
        self._resume_s = math.inf
        self._timers: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()

    # -- time --------------------------------------------------------------------------------------

    @property
    def next_s(self) -> float:
        """Time of the next work of `advance`; -inf before the first call."""
        if self._now_s == -math.inf:
            return -math.inf
        timer_s = self._timers[0][0] if self._timers else math.inf
        return min(self._tick_s, self._poll_s, self._resume_s, timer_s)

    def advance(self, now_s: float) -> None:
        """Do all work due up to `now_s`: IPCs, polls of the inputs, waiting tasks."""
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
        actions: dict[str, Callable[[float], None]] = {
            "remote-off": lambda at_s: self.remote(False, at_s),
            "job-stop": self.job_stop,
            "energy-saving": lambda at_s: self.energy_saving(True, at_s),
            "increment-error": self.increment_error,
        }
        for name, action in actions.items():
            if name in self.options.faults:
                self._after(self.options.faults[name], functools.partial(self._do_now, action))

    def _do_now(self, action: Callable[[float], None]) -> None:
        action(self._now_s)

    def _stand_still(self, lost_s: float) -> None:
        """Shift times after a pause of this process: the clock stood still, no command was late."""
        lost_s = math.floor(lost_s / self._ipc_s) * self._ipc_s
        self._note(f"the simulation stalled for {lost_s:.3f} s")
        self._start_s += lost_s
        self._tick_s += lost_s
        self._poll_s += lost_s
        self._resume_s += lost_s
        self._task_ends_s += lost_s
        self._timers = [(due_s + lost_s, order, action) for due_s, order, action in self._timers]
        for stream in self._streams:
            stream.heard_s += lost_s

    def _after(self, delay_s: float, action: Callable[[], None]) -> None:
        heapq.heappush(self._timers, (self._now_s + delay_s, next(self._count), action))

    def _note(self, text: str) -> None:
        self.events.append((self._now_s, text))

    # -- state -------------------------------------------------------------------------------------

    @property
    def moving_data(self) -> bool:
        """True if a queue has increments or a command moves the arm: it refuses further clients."""
        return any(group.holding_data for group in self._groups) or not self._still

    def status(self) -> RobotStatus:
        """Return ROBOT_STATUS."""
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
            motion_possible=int(self.motion_possible),
        )

    def feedback(self, group: int) -> JointFeedback:
        """Return JOINT_FEEDBACK of one group, from its encoders."""
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
        """Return MotoROS's feedback outputs by bit address; the first two are those of INIT_ROS."""
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
        """Return MotoROS's motion-ready predicate for the inputs at the last poll."""
        seen = self._seen
        return (
            self._job_ready
            and seen.operating
            and seen.remote
            and not (self._collaborative_stop or self._increment_error or self._stopping)
        )

    @property
    def motion_possible(self) -> bool:
        """True if a command would act: not while the velocity mode ends, nor while the stream of
        any group is latched."""
        return (
            self.ready and not self._leaving and not any(stream.latched for stream in self._streams)
        )

    @property
    def active_mode(self) -> ActiveMode:
        """Kind of commands that are accepted now."""
        if self._velocity_on:
            return ActiveMode.VELOCITY
        return ActiveMode.TRAJECTORY if self.ready else ActiveMode.NONE

    @property
    def newest_command_age_s(self) -> float:
        """Time since a point or a velocity was accepted; inf before the first."""
        return self._now_s - self._newest_command_s

    @property
    def worst_lateness_s(self) -> float:
        """Largest delay of a velocity command relative to the fastest one, by its sender's time."""
        return max(stream.worst_lateness_s for stream in self._streams)

    def command_pulses(self, group: int) -> tuple[int, ...]:
        """Return the commanded position, pulses."""
        return tuple(self._groups[group].command)

    def command_rad(self, group: int) -> tuple[float, ...]:
        """Return the commanded position, rad or m."""
        return tuple(
            pulses / each
            for pulses, each in zip(self._groups[group].command, self._per_rad, strict=True)
        )

    def measured_rad(self, group: int) -> tuple[float, ...]:
        """Encoder positions: whole pulses, in rad or m."""
        return tuple(
            int(pulses) / each
            for pulses, each in zip(self._plants[group].measured, self._per_rad, strict=True)
        )

    def velocity_rad_s(self, group: int) -> tuple[float, ...]:
        """Return the commanded speed: the velocity mode's, else that of the last increments."""
        if self._velocity_on:
            return tuple(self._laws[group].velocity)
        return tuple(
            pulses / each / self._ipc_s
            for pulses, each in zip(self._executed[group], self._per_rad, strict=True)
        )

    def queue_count(self, group: int) -> int:
        """Return the number of increments in the queue."""
        return len(self._groups[group].queue)

    def tool(self, group: int) -> int:
        """Return the tool that SELECT_TOOL chose."""
        return self._groups[group].tool

    @property
    def velocity_moves(self) -> bool:
        """True while the velocity mode moves the arm: no other client is accepted, not even at a
        port that is free again."""
        return not self._still

    @property
    def _still(self) -> bool:
        return not self._velocity_on or all(law.still for law in self._laws)

    # -- operator actions --------------------------------------------------------------------------

    def _happens(self, now_s: float, text: str) -> None:
        self.advance(now_s)
        self._note(text)

    def emergency_stop(self, now_s: float) -> None:
        """Press an emergency stop: servos off, job stopped."""
        self._happens(now_s, "emergency stop")
        self._inputs.estop = True
        self._inputs.servo = False
        self._stop_job()

    def release_emergency_stop(self, now_s: float) -> None:
        """Release the emergency stop; the servos stay off."""
        self._happens(now_s, "emergency stop released")
        self._inputs.estop = False

    def alarm(self, code: int, now_s: float) -> None:
        """Raise an alarm; below 4000 it is a major one."""
        self._happens(now_s, f"alarm {code}")
        self._inputs.alarm = code
        if code < FIRST_MINOR_ALARM:
            self._inputs.servo = False
        self._stop_job()

    def error(self, code: int, now_s: float) -> None:
        """Raise an error, which is less severe than an alarm; it stops the job too."""
        self._happens(now_s, f"error {code}")
        self._inputs.error = code
        self._stop_job()

    def reset_alarm(self, now_s: float) -> None:
        """Reset alarms and errors at the pendant, major ones too."""
        self._happens(now_s, "alarms reset")
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
        self._happens(now_s, f"mode {which}")
        self._inputs.play = which == "play"
        if which == "teach":
            self._suspended = self._suspended or (self._old and self._inputs.operating)
            self._inputs.operating = False
        elif self._suspended:
            self._suspended = False
            self._inputs.operating = True

    def remote(self, on: bool, now_s: float) -> None:
        """Give or take remote control."""
        self._happens(now_s, f"remote {'on' if on else 'off'}")
        self._inputs.remote = on
        if not on:
            self._stop_job()

    def hold(self, on: bool, now_s: float) -> None:
        """Press or release hold; the job does not continue by itself."""
        self._happens(now_s, f"hold {'on' if on else 'off'}")
        self._inputs.hold = on
        if on:
            self._stop_job()

    def energy_saving(self, on: bool, now_s: float) -> None:
        """Enter or leave energy saving, as after a long standstill."""
        self._happens(now_s, f"energy saving {'on' if on else 'off'}")
        self._inputs.energy_saving = on

    def collaborative_stop(self, now_s: float) -> None:
        """Simulate contact with a person; latched until START_TRAJ_MODE."""
        self._happens(now_s, "collaborative stop")
        self._inputs.collaborative_stop = True

    def speed_limit(self, fraction: float | None, now_s: float) -> None:
        """Limit the axes' speeds to this share by the functional safety unit; None: no limit."""
        if fraction is not None and not 0.0 <= fraction <= 1.0:
            raise ValueError(f"speed limit {fraction!r} is not within 0 to 1")
        self._happens(now_s, "no speed limit" if fraction is None else f"speed limit {fraction:g}")
        self._speed_share = fraction

    def job_stop(self, now_s: float) -> None:
        """Stop the job INIT_ROS."""
        self._happens(now_s, "job stopped")
        self._stop_job()

    def increment_error(self, now_s: float) -> None:
        """Refuse the next increments."""
        self.advance(now_s)
        self._refuse_next = True

    def _stop_job(self) -> None:
        self._inputs.operating = False
        self._suspended = False

    @property
    def _servo_can_be_on(self) -> bool:
        inputs = self._inputs
        return not inputs.estop and not 0 < inputs.alarm < FIRST_MINOR_ALARM

    # -- tasks that wait ---------------------------------------------------------------------------

    @property
    def blocked(self) -> bool:
        """True while the motion server waits inside a message and accepts no other."""
        return self._steps is not None

    def _start(self, steps: Steps) -> None:
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

    def _abandon(self) -> None:
        """End the waiting task in place."""
        self._steps, self._resume_s, self._stopping = None, math.inf, False

    def _end_tasks(self) -> None:
        """End the increment task and the fillers."""
        self._task_runs = False
        self._task_ends_s = math.inf
        for group in self._groups:
            if group.has_data:
                # The filler is deleted, as in a controller that is not ready.
                group.fill(False)
            group.forget_owed()

    # -- polls and IPCs ----------------------------------------------------------------------------

    def _poll(self) -> None:
        """Read the inputs, and react to changes as MotoROS does."""
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
        """Clear queues and points, which ends all motion."""
        if self.moving_data or any(group.has_data for group in self._groups):
            self._note(f"motion ends: {reason}")
        for group in self._groups:
            group.clear()
        self._leave_velocity_mode()

    def _tick(self) -> None:
        """Run one IPC: the increment task, then the fillers, then the arm follows."""
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
        share = 1.0 if self._speed_share is None else self._speed_share
        for index, (group, law, stream) in enumerate(
            zip(self._groups, self._laws, self._streams, strict=True)
        ):
            if stream.unused:
                stream.unused = False
                stream.age_ms = (now_s - stream.heard_s) * 1e3
            increments = law.step(stream.target, stream.accelerations, share)
            group.execute(increments, False)
            self._executed[index] = increments
        if self._leaving and self._still:
            self._leave_velocity_mode()
            self._note("the velocity mode has ended")

    @property
    def log_columns(self) -> tuple[str, ...]:
        """Return the columns of a row of `log`. The age is that of the newest accepted command;
        counts are of velocity messages since the start."""
        names = self.arm.joint_names
        return (
            "monotonic_s",
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

    # -- streams of velocities ---------------------------------------------------------------------

    def _take_velocity(self, sequence: int, command: JointFeedback) -> None:
        """Accept a velocity; sequence 0 arms in any state. The sequence and not the sender's time
        decides which commands are stale; the time gives their delay."""
        stream, now_s = self._streams[command.group], self._now_s
        if sequence == 0:
            stream.armed, stream.latched = True, False
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

    def _statistics(self, groups: Iterable[int]) -> Joints:
        """Return statistics of the commands since the last reply: limited axes of any of these
        groups, the greatest age, all overwritten ones.

        The command of this reply acts from the next IPC on and is not among them.
        """
        speed = acceleration = position = overwritten = 0
        age_ms = 0.0
        for group in groups:
            law, stream = self._laws[group], self._streams[group]
            speed |= law.speed_mask
            acceleration |= law.acceleration_mask
            position |= law.position_mask
            age_ms = max(age_ms, stream.age_ms)
            overwritten += stream.overwritten
            law.clear_masks()
            stream.overwritten = 0
        return joints10(map(float, (speed, acceleration, position, age_ms, overwritten)))

    def _forget_commands(self) -> None:
        for stream in self._streams:
            stream.disarm()

    def _latch(self) -> None:
        """Ramp every armed group to zero; from then on accept only sequence 0."""
        for stream in self._streams:
            stream.disarm(latched=True)

    def _end_velocity_mode(self) -> None:
        """Leave the velocity mode at standstill, now or at the end of a ramp."""
        self._forget_commands()
        if self._still:
            self._leave_velocity_mode()
        else:
            self._leaving = True

    def _leave_velocity_mode(self) -> None:
        """Leave the velocity mode at once."""
        if self._velocity_on:
            for group, law in zip(self._groups, self._laws, strict=True):
                law.halt()
                group.restart()
        self._forget_commands()
        self._velocity_on = self._leaving = False
