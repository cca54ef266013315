"""The controller of one arm: robot state in, command out, one `tick`.

An operator device, a verb or a stream is a source that requests motion; the controller decides. In
each tick the robot's state is checked (:mod:`supervision`), the operator device's state becomes a
request (:mod:`cardan.gateway.operator.input`), one motion moves the commanded arm, and the output
check sees the command. Nothing here reads a clock, a socket or a file: time is part of the states,
so tests run it in virtual time.

The rule: nothing moves unless a fresh command from a live operator says so. Any interruption ends
in a braking ramp and a hold, and motion needs re-arming afterwards.
"""

from __future__ import annotations

import contextlib
import json
import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Protocol

from cardan.common.haptics import WorldMap
from cardan.gateway.arm.commanded_arm import CommandedArm, FollowingError, equal_steps
from cardan.gateway.arm.motions.base import CommandedMotion
from cardan.gateway.arm.motions.recover import NO_WAY, Recover
from cardan.gateway.arm.motions.reference_motion import Brake, FollowOperator
from cardan.gateway.arm.output_check import OutputCheck, OutputLimits
from cardan.gateway.arm.states import (
    RESTING,
    ArmEvent,
    ArmingAction,
    Authority,
    Facts,
    Inhibit,
    States,
    arming_after,
    inhibits_after,
    phase_of,
)
from cardan.gateway.arm.status import OPERATOR, TAUT_SHARE, ArmStatus, Phase
from cardan.gateway.arm.supervision import Cause, StopReason, Supervision, Watchdogs
from cardan.gateway.motion.speed_limited_reference import Reference, ReferenceLimits
from cardan.gateway.operator.deadman import Arming
from cardan.gateway.operator.input import NO_REQUEST, ArmView, MotionRequest, OperatorInput
from cardan.gateway.operator.position import resting_pose
from cardan.types import (
    NEVER_S,
    ZERO_TWIST,
    ButtonEvent,
    DeviceState,
    HoldCommand,
    RobotCommand,
    RobotState,
)

EASE_ABOVE = 0.5
"""Share of the maximum lead beyond which the reference is moved back to its robot while no motion
drives it: an arm that lags (MaxSpeedDeviation, a person in its way) then stops when the operator
releases the dead-man, not after catching up. Gravity sag stays far below it and causes no creeping.
"""

NEAR_SHARE = 0.1
"""Share of the maximum lead, and of the joints' following-error limit, within which a recovery
ends."""

BEHIND_SHARE = 0.5
"""Share of the following error's limit beyond which the arm accepts neither poses nor a clutch."""

COASTS_S = 0.5
"""Longest time for which a robot may continue at its last commanded speed."""

HELD_SHARE = 0.5
"""Share of the requested speed below which the message names the limit."""

_new = tuple.__new__
"""Makes a named tuple in half the time of its constructor, for those of every cycle."""

RequestRecorder = Callable[[int, str, str], None]
"""Receives each request of a source other than the operator device: number of ticks begun before
it, its name, and its argument as text. Called in the requesting thread."""


class Listener(Protocol):
    """Gets the outcome of the motions that it began. Called under the controller's lock."""

    def invalidate(self, reason: str) -> None:
        """End all motions under way or planned, for this reason."""

    def finished(self, reason: str) -> None:
        """Take the end of the motion; `reason`: why it ended before its goal, else empty."""


class ArmController:
    """Controller of one arm: its supervision, and the sources that move it.

    `tick` belongs to the robot's loop; all other methods may be called from any thread.
    """

    def __init__(
        self,
        commanded: CommandedArm,
        limits: ReferenceLimits,
        watchdogs: Watchdogs | None = None,
        operator: OperatorInput | None = None,
        authority: Authority | None = None,
        *,
        period_s: float = 0.0,
        output_limits: OutputLimits | None = None,
    ) -> None:
        """`limits` bound the operator's motion; `period_s` is the robot's; 0: unknown."""
        self.commanded = commanded
        self.operator = operator
        self.authority = authority or Authority()
        self.supervision = Supervision(watchdogs or Watchdogs(), period_s)
        self.reference = Reference(limits)
        """Reference that the TCP follows; it stays at the TCP during other motions."""
        self.lock = threading.RLock()
        """Guards everything that `tick` touches; never held for long."""
        self.robot: RobotState | None = None
        """The newest state."""
        self.plan_epoch = 0
        """Counts events that make plans invalid: loss of the robot, trips, stops, takeovers by the
        operator."""
        self.listener: Listener | None = None
        """Source of motions other than the operator device."""
        self.recorder: RequestRecorder | None = None
        """Records the inputs of ticks that are not their arguments."""
        self.ticks = 0
        """Counts the ticks that have begun."""
        self._recording_thread = 0
        """The thread whose present request is recorded as a whole; 0: none."""
        self.not_ready = "no state of the robot was received yet"
        """Reason why the robot cannot be commanded now; empty when it can."""
        self.state = States()
        """State of the controller; assigned by `_enter` alone."""
        self._output_check = OutputCheck(output_limits or OutputLimits.of_free_body(limits))
        self.advanced_s = 0.0
        """Time by which the last tick advanced, without lost time."""
        self._motion: CommandedMotion | None = None
        """Motion that moves the commanded arm; it comes with the state of motion."""
        self._request = NO_REQUEST
        self._trip_reason = ""
        self._trips = 0
        self._tripped_in_tick = False
        """Whether the present tick ended a motion of some source, or placed the arm."""
        self._separation_reason = ""
        """Reason why command and robot stay separate until re-armed; empty if they do not."""
        self._recovered_way = NO_WAY
        """Length of recoveries since the last re-arming."""
        self._inhibits: Mapping[Inhibit, str] = {}
        """Inhibits from outside, each with its reason; assigned as a whole."""
        self.stops, self.stopped_by = 0, ""
        """Count of stops that sources requested, and the last of these sources."""
        self._filter_fault = ""

    # -- state -----------------------------------------------------------------------------------

    @property
    def phase(self) -> Phase:
        """Phase of the arm now."""
        with self.lock:
            return phase_of(
                self.state,
                self.commanded.moving,
                self._request.asks,
                self._motion is not None and self._motion.recovers,
            )

    @property
    def motion(self) -> CommandedMotion | None:
        """Motion that moves the commanded arm; None while it holds."""
        return self._motion

    @property
    def braking(self) -> bool:
        """True while the motion is braking on request."""
        return self.state.motion.braking

    @property
    def recovering(self) -> bool:
        """True from a trip by the following error until the command is back at the arm."""
        if self.state.separation.waits:
            return True
        return self._motion is not None and self._motion.recovers

    @property
    def engaged(self) -> bool:
        """True while the robot is commanded, moving or not."""
        return self.state.motion.commanded

    @property
    def armed(self) -> bool:
        """True while the operator device may move the arm without re-arming."""
        return self.state.arming.armed

    @property
    def waits_for_rearming(self) -> bool:
        """True while command and robot stay separate until re-armed."""
        return self.state.separation.until_rearmed

    @property
    def rejects(self) -> bool:
        """True while the robot's readings are implausible."""
        return self.state.readings.rejected

    @property
    def trips(self) -> int:
        """Count of the trips: a watchdog or fault disengaged the source that moved the arm."""
        return self._trips

    @property
    def message(self) -> str:
        """Reason why nothing moves, and what to do; empty when all is well."""
        with self.lock:
            if ended := self._inhibits.get(Inhibit.FOR_GOOD):
                return ended
            if self.robot is None:
                return "waiting for the robot"
            if not self.state.link.ready:
                return self.not_ready
            if not self.state.arming.armed:
                return self._what_to_do(self.robot)
            if self.recovering:
                return "resynchronizing with the robot; any button ends it"
            if self._request.following and self.operator is not None:
                return self.operator.remark or self._held(self._request)
            return ""

    @property
    def following_error(self) -> FollowingError:
        """Following error of the last tick in which the robot was ready."""
        return self.supervision.error

    @property
    def stamp_s(self) -> float:
        """Time of the newest robot state, s; NEVER_S before the first."""
        return NEVER_S if self.robot is None else self.robot.stamp_s

    @property
    def at_rest(self) -> bool:
        """True when nothing is commanded to move, and nothing else may move the arm."""
        motion = self._motion
        if motion is not None and motion.yields:
            return False
        return not self.commanded.moving and not self.reference.moving

    @property
    def idle(self) -> bool:
        """True when nothing is commanded to move and nothing is about to be."""
        motion = self._motion
        return not self.commanded.moving if motion is None else motion.idle

    @property
    def following(self) -> bool:
        """True while the operator device moves the arm: armed, dead-man held, clutched in."""
        return self.state.arming.armed and self._request.following

    @property
    def target(self) -> MotionRequest:
        """The operator's newest request."""
        return self._request

    def device_map(self) -> WorldMap | None:
        """Map from the device's position to the commanded TCP's after the last tick, within the
        workspace; None while no pose is followed, or through axes that mirror."""
        return None if self.operator is None or not self.following else self.operator.device_map()

    def status(self) -> ArmStatus:
        """A snapshot for views and recorders."""
        with self.lock:
            commanded, operator = self.commanded, self.operator
            placed = commanded.placed and self.engaged
            arm = commanded.status() if placed else None
            by_operator = self._motion is None or self._motion.follows_operator
            if arm is not None and not self._request.asks and by_operator:
                arm = arm._replace(path_speed=1.0)  # Without a request nothing is slowed.
            return ArmStatus(
                self.phase,
                self.message,
                self._request.twist,
                commanded.twist if placed else ZERO_TWIST,
                commanded.pose if placed else None,
                self.reference.lead_used,
                self.reference.at_workspace_limit,
                operator is not None and operator.mapping.gripper_closed,
                self._trips,
                self.authority.state(),
                () if operator is None else operator.filter_words(),
                arm,
            )

    # -- states ----------------------------------------------------------------------------------

    def _on(
        self, event: ArmEvent, by: CommandedMotion | None = None, moving: bool | None = None
    ) -> None:
        """Enter the states after `event`; the arm moves `by` a motion from now on. `moving`:
        whether it moves, where that is not the commanded arm's."""
        facts = Facts(
            self.operator is not None,
            self.commanded.moving if moving is None else moving,
            not self.supervision.error.exceeds(self.supervision.limit, NEAR_SHARE),
            self.supervision.watchdogs.recovery,
        )
        self._enter(self.state.after(event, facts), by)

    def _enter(self, states: States, motion: CommandedMotion | None = None) -> None:
        """The one place where states are assigned, and the motion that moves the arm in them."""
        self.state = states
        if motion is not None:
            self._motion = motion
        elif states.motion in RESTING:
            self._motion = None

    # -- requests --------------------------------------------------------------------------------

    def record_request(self, what: str, argument: str = "") -> None:
        """Record a request that changes the next ticks, for replay, if there is a recorder."""
        if self.recorder is not None and self._recording_thread != threading.get_ident():
            self.recorder(self.ticks, what, argument)

    @contextlib.contextmanager
    def recorded_request(self, what: str, argument: str) -> Iterator[None]:
        """Record a request made inside as a whole, without the requests that it consists of. The
        caller holds the lock."""
        self.record_request(what, argument)
        outer, self._recording_thread = self._recording_thread, threading.get_ident()
        try:
            yield
        finally:
            self._recording_thread = outer

    def inhibit(self, reason: str, kind: Inhibit) -> None:
        """Interrupt the arm's motion, or keep sources from moving it, as `kind` says."""
        with self.lock:
            before, self._inhibits = self._inhibits, inhibits_after(self._inhibits, reason, kind)
            if kind is not Inhibit.WHILE_SAID or self._inhibits != before:
                self.record_request(kind.value, reason)
            if kind is Inhibit.FOR_GOOD:
                self._stop(reason)

    def stop(self, reason: str, source: str = "") -> None:
        """Brake along the path, then hold; a recovery ends as well. Needs no authority. A stop that
        `source` asks for is counted."""
        with self.lock:
            self.record_request("stop", reason)
            if source:
                self.stops, self.stopped_by = self.stops + 1, source
            self._stop(reason)

    def _stop(self, reason: str) -> None:
        if self.state.arming.armed:
            self._disarm()
        self.plan_epoch += 1
        if self.recovering:
            self._require_rearming(f"and stays so: {reason}")
        self._end_motion(reason)

    def place_neighbor(self, index: int, joints: Sequence[float], ways_m: Sequence[float]) -> None:
        """Keep away from a neighbor from the next tick on, as
        :meth:`cardan.gateway.arm.joint_space_arm.JointSpaceArm.place_neighbor` does."""
        with self.lock:
            if self.recorder is not None:
                self.record_request("place_neighbor", json.dumps((index, joints, ways_m)))
            self.commanded.place_neighbor(index, joints, ways_m)

    def acknowledge(self) -> str:
        """Re-arm after implausible readings, or after a recovery that was given up; return why it
        is too early, or ""."""
        with self.lock:
            self.record_request("acknowledge")
            return self._acknowledge()

    def _acknowledge(self) -> str:
        readings = self.state.readings
        if readings.rejected:
            if not self.supervision.trustworthy:
                return f"{self.supervision.implausible}; wait until the measured position is steady"
            self.supervision.trust()
            self._on(ArmEvent.PLAUSIBLE)
            if readings.elsewhere and self.robot is not None and self.state.link.ready:
                self._place(self.robot)
        # Again by the maximum lead towards the robot, unless it is near already.
        self._on(ArmEvent.ACKNOWLEDGED)
        self._recovered_way = NO_WAY
        return ""

    @property
    def _inhibited(self) -> str:
        """Return why no source may move the arm; empty when one may."""
        if not (inhibits := self._inhibits):
            return ""
        return inhibits.get(Inhibit.FOR_GOOD) or inhibits.get(Inhibit.WHILE_SAID, "")

    @property
    def inhibited(self) -> str:
        """Return why no source can begin a motion now; empty when one can."""
        if inhibited := self._inhibited:
            return inhibited
        if self.rejects:
            return f"{self.supervision.implausible}: the measured position is implausible"
        if self.waits_for_rearming:
            return self._separation_reason
        if self.recovering:
            return f"resynchronizing with the robot, {self._trip_reason}"
        return ""

    def begin(self, motion: CommandedMotion) -> None:
        """Start a motion on an arm at rest."""
        with self.lock:
            self.record_request("begin", type(motion).__name__)
            self._on(ArmEvent.EXECUTES, motion)
            self._trip_reason, self._recovered_way = "", NO_WAY

    def drop(self) -> None:
        """Forget a motion that rests."""
        with self.lock:
            self._on(ArmEvent.OVER)
            self._rest_reference()

    def engage(self) -> None:
        """Command the robot from now on; from its measured position if it was not yet commanded."""
        if not self.engaged:
            assert self.robot is not None
            self.commanded.place(self.robot)
            self._output_check.reset()
            self._rest_reference()
            self._on(ArmEvent.ENGAGED)

    def brake(self) -> None:
        """Bring the motion to rest; it ends then."""
        if self._motion is not None and not self.braking:
            self._motion.brake()
            self._on(ArmEvent.BRAKES)

    # -- the tick --------------------------------------------------------------------------------

    def tick(
        self,
        robot: RobotState,
        device: DeviceState | None = None,
        events: Sequence[ButtonEvent] = (),
    ) -> RobotCommand:
        """Decide the command for the control instant that `robot` reports."""
        with self.lock:
            self.ticks += 1
            self.robot = robot
            self._tripped_in_tick = False
            finding = self.supervision.look(robot, self.commanded)
            self.advanced_s = dt_s = self.supervision.step_s
            if finding is not None:
                if not self.supervision.ready:
                    return self._robot_lost(finding, robot, device, events, dt_s)
                self._act_on(finding, robot)
            if not self.state.link.ready:
                self.not_ready = ""
                self._on(ArmEvent.READY)
            if not self.state.readings.rejected:
                own = self.reference if self.operator is not None else None
                finding = self.supervision.compare(
                    robot, self.commanded, own, self._motion, self.state.motion.commanded
                )
                if finding is not None:
                    self._act_on(finding, robot)
            ignored = bool(self._inhibits) and self._heed_inhibits()
            inhibited = self._inhibits or robot.alarm
            if inhibited and self.recovering and (why := self._why_no_recovery):
                self._cancel_recovery(why)
            if self.operator is not None and device is not None:
                self._read_operator(self.operator, robot, device, events, dt_s, ignored)
            claims = self.state.arming.claims
            self.authority.expire(robot.stamp_s, claims or self._keeps_authority)
            self._move(robot, dt_s)
            return self._command(robot, dt_s)

    def _heed_inhibits(self) -> bool:
        """Trip because of present inhibits, and drop those for one tick. Return whether the
        operator's motion is ignored in this tick."""
        inhibits = self._inhibits
        reason = inhibits.get(Inhibit.ONCE) or inhibits.get(Inhibit.WHILE_SAID)
        if reason and self._driven:
            self._trip(reason)
        stay = (Inhibit.FOR_GOOD, Inhibit.WHILE_SAID)
        self._inhibits = {each: inhibits[each] for each in stay if each in inhibits}
        return Inhibit.MOTION_IGNORED in inhibits

    @property
    def _why_no_recovery(self) -> str:
        """Return why even a recovery must not move the command now; empty when it may."""
        alarm = "" if self.robot is None else self.robot.alarm
        return self._inhibited or alarm

    @property
    def _keeps_authority(self) -> bool:
        """Return whether a motion is under way whose source need not renew its authority."""
        motion = self._motion
        if motion is None or motion.recovers:
            return False
        streamed = motion.silence_s < math.inf
        return motion.driven or self.commanded.moving if streamed else not motion.idle

    # -- faults ----------------------------------------------------------------------------------

    def _act_on(self, finding: StopReason, robot: RobotState) -> None:
        """Act on a finding about the robot: the one place for its consequences."""
        cause, reason = finding
        if cause is Cause.FIRST:
            self._place(robot)
        elif cause is Cause.RETURNED:
            if self.rejects:
                self._on(ArmEvent.RETURNED)
            else:
                self._place(robot, self._before(robot))
        elif cause is Cause.NEW_SESSION:
            self._trip_if_driven("the robot's controller started a new session")
            self._place(robot, self._before(robot))
        elif cause is Cause.STALLED:
            self._trip_if_driven(reason)
            if self.rejects:
                self._rest_here(reason)
            else:
                self._place(robot, self._before(robot))
        elif cause is Cause.JUMPED:
            self._on(ArmEvent.JUMPED)
            self._trip_if_driven(reason)
            self._disarm()
            self._end_motion(reason)
        elif cause is Cause.HELD:
            if self.waits_for_rearming or self.recovering:
                return
            self._trip(reason)
            self._separation_reason = f"{reason}; recovery is switched off"
            self._on(ArmEvent.HELD)
        elif cause is Cause.ALARM and self._driven:
            self._trip(reason)
        elif cause is Cause.SILENT:
            motion = self._motion
            assert motion is not None
            if motion.outlives_silence:
                motion.release()
                if self.listener is not None:
                    self.listener.invalidate(reason)
            else:
                self._end_motion(reason)

    def _before(self, robot: RobotState) -> RobotState | None:
        """Return the state before, if the arm moved by command since and may still move."""
        before = self.supervision.previous
        if before is None or not (
            self.supervision.acted and self.engaged and self.commanded.moving
        ):
            return None
        return before if robot.stamp_s - before.stamp_s <= COASTS_S else None

    def _robot_lost(
        self,
        finding: StopReason,
        robot: RobotState,
        device: DeviceState | None,
        events: Sequence[ButtonEvent],
        dt_s: float,
    ) -> RobotCommand:
        """Handle the loss of the robot: the source that moved it has to engage again. A controller
        that still sends may still obey: then the motion is braked in a ramp."""
        cause, reason = finding
        if cause is Cause.LOST:
            self._trip_if_driven("the robot's controller fell silent")
        elif cause is Cause.NEW_SESSION:
            self._trip_if_driven("the robot's controller started a new session")
        else:
            self._trip_if_driven(reason)
        self._disarm()
        moves = cause is not Cause.LOST and self._motion is not None and self.commanded.moving
        self._on(ArmEvent.UNREADY, moving=moves)
        self.not_ready = reason
        if self.operator is not None and device is not None:
            view = ArmView(
                robot, dt_s, None, None, Arming.DISARMED, False, reason, input_ignored=True
            )
            self._request = self.operator.request(device, events, view)
        self.authority.expire(robot.stamp_s, False)
        if moves:
            self.brake()
            self._move(robot, dt_s)
            if self.commanded.moving:
                return self._command(robot, dt_s, blind=True)
        self._disengage(reason)
        return HoldCommand()

    def _disengage(self, reason: str) -> None:
        """Forget all motion: the robot's position after the loss is unknown."""
        self.plan_epoch += 1
        self._end_motion(reason)
        self._on(ArmEvent.FORGOTTEN)
        self.commanded.halt()
        self._output_check.reset()
        if self.reference.pose is not None:
            self.reference.place(self.reference.pose)

    def _place(self, robot: RobotState, before: RobotState | None = None) -> None:
        """Start from the robot's position; with a state `before`, from its speed, too."""
        self.plan_epoch += 1
        self._recovered_way = NO_WAY
        self._tripped_in_tick = True
        self._end_motion("the command was restarted from the measured position")
        self.commanded.place(
            robot, before, 0.0 if before is None else robot.stamp_s - before.stamp_s
        )
        self._output_check.reset()
        self._rest_reference()
        self._on(
            ArmEvent.PLACED,
            Brake(self.commanded, self.reference) if self.commanded.moving else None,
        )

    def _rest_here(self, reason: str) -> None:
        """Rest at the commanded position: the robot's position or motion is unknown."""
        self.plan_epoch += 1
        self._end_motion(reason)
        self._on(ArmEvent.OVER)
        self.commanded.halt()
        self._output_check.reset()
        self._rest_reference()

    def _rest_reference(self) -> None:
        if self.commanded.placed:
            self.reference.place(self.commanded.pose)

    @property
    def _driven(self) -> bool:
        if self.state.arming.armed:
            return True
        motion = self._motion
        if motion is None or self.braking or motion.recovers:
            return False
        return not motion.idle

    def _trip_if_driven(self, reason: str) -> None:
        if self._driven:
            self._trip(reason)

    def _trip(self, reason: str) -> None:
        """Disengage the source that moves the arm."""
        self._disarm()
        self._tripped_in_tick = True
        self._trip_reason = reason
        self._trips += 1
        self.plan_epoch += 1
        self._end_motion(reason)

    def _disarm(self) -> None:
        if self.state.arming.armed:
            self.authority.release(OPERATOR)
        self._on(ArmEvent.DISARMED)
        if self.operator is not None:
            self.operator.disarm()

    def _end_motion(self, reason: str) -> None:
        """Brake the motion, and give its source the reason."""
        self.brake()
        if self.listener is not None:
            self.listener.invalidate(reason)

    # -- the operator device ---------------------------------------------------------------------

    def _read_operator(
        self,
        operator: OperatorInput,
        robot: RobotState,
        device: DeviceState,
        events: Sequence[ButtonEvent],
        dt_s: float,
        ignored: bool,
    ) -> None:
        """Turn the device's state into a request, once, and choose the source that drives."""
        reference, motion, authority = self.reference, self._motion, self.authority
        state, inhibited, behind = self.state, "", ""
        recovers = motion is not None and motion.recovers
        follows = motion is not None and (motion.follows_operator or recovers)
        free = motion is None or (follows and not state.motion.braking)
        if not state.arming.armed:
            # Re-arming by the operator arms nothing now.
            inhibited = self.inhibited or robot.alarm or self._filter_fault
            inhibited = inhibited or authority.refuses(OPERATOR)
        if not inhibited and (not state.arming.armed or not self._request.following):
            if self._tripped_in_tick:
                behind = "the robot was not ready for it"
            elif self.supervision.error.exceeds(self.supervision.limit, BEHIND_SHARE):
                behind = self.supervision.error.in_words("behind")
        seen = robot
        if operator.filters and not state.readings.rejected:
            # A robot may report joints alone, or another tool's pose: filters get the model's.
            seen = robot._replace(pose=self.commanded.measured(robot))
        poses = operator.mapping.follows_pose and reference.pose is not None
        view = _new(
            ArmView,
            (
                seen,
                dt_s,
                reference.pose,
                resting_pose(reference) if poses else None,
                state.arming,
                free and not state.readings.rejected,
                inhibited,
                behind,
                self._tripped_in_tick and bool(self._trip_reason),
                False,
                ignored,
            ),
        )
        self._request = request = operator.request(device, events, view)
        recovering = state.separation.waits or recovers
        acknowledges = bool(inhibited) and not recovering
        owns = authority.owner == OPERATOR
        refused = not owns and bool(authority.refuses(OPERATOR))
        arming, action = arming_after(state.arming, request, acknowledges, owns, refused)
        if arming is not state.arming and action is not ArmingAction.TRIP:
            self._enter(state._replace(arming=arming))
        if action is not None:
            self._do(action, request.fault or request.filter_fault, robot.stamp_s)
        self._filter_fault = request.filter_fault
        if recovering and request.pressed and self.state.arming.armed and not request.asks:
            # A regrip goes on from the command's place; the rest of the way is dropped.
            self._on(ArmEvent.LEFT)
            self._end_motion("it was ended by a button")
        elif recovering and request.pressed and not self.state.arming.armed:
            self._cancel_recovery("it was ended by a button")

    def _do(self, action: ArmingAction, fault: str, now_s: float) -> None:
        """Carry out the consequence of the operator's request, which may have a `fault`."""
        match action:
            case ArmingAction.TRIP:
                self._trip(fault or self.authority.take(OPERATOR, now_s))
            case ArmingAction.LET_GO:
                self.authority.release(OPERATOR)
                self._end_motion("the clutch was released")
            case ArmingAction.ARM:
                self._trip_reason, self._recovered_way = "", NO_WAY
            case ArmingAction.TAKE:
                self._take_over(now_s)
            case ArmingAction.ACKNOWLEDGE:
                if self.authority.refuses(OPERATOR):
                    self.authority.take(OPERATOR, now_s)  # Notes the refusal.
                self._acknowledge()

    def _take_over(self, now_s: float) -> None:
        """Give the arm to the operator device; a motion under way is braked first."""
        self._trip_reason, self._recovered_way = "", NO_WAY
        self.authority.take(OPERATOR, now_s)
        self.plan_epoch += 1
        reason, motion = "the operator device took over", self._motion
        if motion is None or not (motion.follows_operator or motion.recovers):
            self._end_motion(reason)
        elif self.listener is not None:
            self.listener.invalidate(reason)

    def _cancel_recovery(self, why: str) -> None:
        self._require_rearming(f"and stays so: {why}")
        self._end_motion(why)
        self._disarm()

    def _require_rearming(self, why: str) -> None:
        """Leave command and robot separate until re-armed; `why` ends the sentence."""
        self._separation_reason = (
            "not resynchronized with the robot: "
            f"{self.supervision.error.in_words('away from')} {why}"
        )
        self._on(ArmEvent.NOT_BACK)

    # -- motion ----------------------------------------------------------------------------------

    def _move(self, robot: RobotState, dt_s: float) -> None:
        """Let the one motion move the commanded arm."""
        self._choose()
        commanded, motion = self.commanded, self._motion
        whole = motion is not None and motion.in_one_step
        longest_s = math.inf if whole else commanded.longest_step_s
        for step in [dt_s] if 0.0 < dt_s <= longest_s else equal_steps(dt_s, longest_s):
            motion = self._motion
            if motion is None:
                if commanded.moving:
                    commanded.brake(step)
                continue
            over, reason = motion.tick(robot, step)
            if motion.fault and not self.braking:
                self._trip(motion.fault)
            if over:
                self._finish(motion, reason)

    def _choose(self) -> None:
        """Choose the motion for the operator's request and the state of the recovery."""
        motion, request = self._motion, self._request
        if self.state.readings.rejected:
            return
        if motion is not None and motion.recovers:
            if self.state.arming.armed and request.asks:
                self._on(ArmEvent.OVER)  # The operator goes on from the commanded position.
                self.reference.place(self.commanded.pose)
                motion = None
            else:
                return
        if self.state.separation.waits and motion is None and not self.commanded.moving:
            self._begin_recovery()
            return
        if not self.state.arming.armed:
            if motion is None and self._drifted:
                self._begin_recovery()
            return
        if motion is None and not self.commanded.moving:
            motion = FollowOperator(self.commanded, self.reference)
            self._on(ArmEvent.FOLLOWS, motion)
        if isinstance(motion, FollowOperator):
            if request.asks:
                self._recovered_way = NO_WAY
                if self.state.separation.left:
                    self._on(ArmEvent.ASKED)
            elif self._drifted and motion.idle:
                self._begin_recovery()
                return
            # The dead-man's release brakes at once: jerk is limited only while the operator drives.
            motion.wanted, motion.smooth = request.twist, request.following
            rates = request.rates
            motion.rates = rates if rates and any(rates.values()) else None

    @property
    def _drifted(self) -> bool:
        """Return whether a reference at rest is so far from its robot that it is moved back."""
        return (
            self.reference.lead_used > EASE_ABOVE
            and self.operator is not None
            and self.engaged
            and self.state.separation.together
            and not self._why_no_recovery
            and self.supervision.watchdogs.recovery
            and not self.commanded.moving
        )

    def _begin_recovery(self) -> None:
        limits, limit = self.reference.limits, self.supervision.limit
        near = FollowingError(
            NEAR_SHARE * limits.max_lead_m,
            NEAR_SHARE * limits.max_lead_rad,
            NEAR_SHARE * limit.joint_error,
        )
        reference = self.reference
        reference.place(self.commanded.pose)
        assert self.robot is not None
        error = self.commanded.following_error(self.robot, reference, observe=True)
        motion = Recover(self.commanded, reference, near, error, self._recovered_way)
        self._on(ArmEvent.RESYNCHRONIZES, motion)

    def _finish(self, motion: CommandedMotion, reason: str) -> None:
        self._on(ArmEvent.COASTED if isinstance(motion, Brake) else ArmEvent.OVER)
        self._rest_reference()
        if isinstance(motion, Recover):
            self._recovered_way = motion.went
            if not (motion.near or self.waits_for_rearming or self.state.separation.left):
                self._require_rearming("still")
                if self.state.arming.armed:
                    self._trip("the robot moves along while the reference approaches it")
        if self.listener is not None:
            self.listener.finished(reason)

    def _command(self, robot: RobotState, dt_s: float, blind: bool = False) -> RobotCommand:
        commanded = self.commanded
        state, rejects = self.state, self.state.readings.rejected
        stays = rejects or state.separation.until_rearmed
        if not state.motion.commanded or (stays and not commanded.moving):
            commanded.halt()
            self._output_check.reset()
            return HoldCommand()
        motion = self._motion
        command = None if motion is None else motion.command
        if command is None:
            recovers = motion is not None and motion.recovers
            command = commanded.command(robot, dt_s, recovers, blind or rejects)
        wrong = self._output_check.violation(command, dt_s)
        if not wrong:
            return command
        self._trip(f"an invalid command was not sent: {wrong}")
        self._disengage(self._trip_reason)
        self._on(ArmEvent.INVALID)
        if not self.rejects and commanded.obstacle(robot, False) == "":
            self._place(robot)
        return HoldCommand()

    # -- words -----------------------------------------------------------------------------------

    def _held(self, request: MotionRequest) -> str:
        """Reason why the arm does not follow the operator."""
        motion, reference = self._motion, self.reference
        if not request.asks or not isinstance(motion, FollowOperator):
            return ""
        if reference.lead_used > TAUT_SHARE:
            behind = self.supervision.error.in_words("behind")
            return f"the robot does not follow: {behind}"
        if motion.share < HELD_SHARE:
            held = self.commanded.held_by()
            return f"the arm does not follow: {held}" if held else ""
        if reference.at_workspace_limit:
            return "the TCP is at the limit of the workspace"
        return ""

    def _what_to_do(self, robot: RobotState) -> str:
        why = f"stopped before: {self._trip_reason}; " if self._trip_reason else ""
        if inhibited := self._inhibited:
            return inhibited
        if robot.alarm or self._filter_fault:
            return robot.alarm or self._filter_fault
        if self.recovering:
            return f"{why}resynchronizing with the robot; any button ends it"
        step = "" if self.operator is None else f": {self.operator.rearming_instruction()} to go on"
        if self.rejects:
            why = self.supervision.implausible
            return f"{why}; the measured position is implausible, the arm holds{step}"
        if self.waits_for_rearming:
            return (
                f"{why}{self._separation_reason}: check what holds the arm and whether it is "
                f"measured right, then {step.removeprefix(': ') or 'acknowledge it'}"
            )
        if self.operator is None:
            return why.removesuffix("; ")
        refusal = self.authority.refuses(OPERATOR)
        return f"{why}{refusal}" if refusal else self.operator.advice(why, self.state.arming)
