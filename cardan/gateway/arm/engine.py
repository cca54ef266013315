"""The control tick of a session: robot state and device state in, robot command out.

Control logic only. Time comes in with the states, so tests run it in virtual time; nothing here
reads a clock, a socket or a file.

The rule of arming: nothing moves unless a fresh command from a live operator says so. Whatever
interrupts that (silence, unplug, a robot that stops or restarts) ends in a braking ramp and a
hold, and going on takes a deliberate act: the device at rest and, where one is configured, the
dead-man button let go and pressed anew, or a press of the button that toggles the clutch. Where the
hand's pose is followed, its deflections mean nothing, and nothing is at rest or not.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from cardan.gateway.hand.absolute import AbsoluteMapping
from cardan.gateway.hand.filters.base import TwistFilter
from cardan.gateway.hand.mapping import Mode, TwistMapping
from cardan.gateway.hand.position import HandMapping, PositionMapping, is_pose, resting_pose
from cardan.gateway.motion.reference import Reference
from cardan.haptics import WorldMap
from cardan.spatial import is_finite, norm, rotation_between, scale, subtract
from cardan.types import (
    NEVER_S,
    ZERO3,
    ZERO_TWIST,
    ButtonEvent,
    DeviceLink,
    DeviceState,
    Frame,
    HoldCommand,
    Pose,
    PoseCommand,
    RobotCommand,
    RobotLink,
    RobotState,
    Twist,
)

if TYPE_CHECKING:  # Both import Pinocchio, which sessions without an arm's model do without.
    from cardan.gateway.servo.follower import ArmFollower
    from cardan.gateway.servo.servo import ServoStatus

NO_DEFLECTION = (0.0,) * 6

RESYNC_TIME_S = 0.2
"""Time constant with which a reference that lost its robot glides back to it: slow enough to be
watched, fast enough not to be waited for."""

RESYNC_GIVE_UP_S = 2.0
"""A reference that has not met its robot after so long, ten time constants, never will: a joint
that is measured wrongly would be chased for ever."""

MEETING_WAYS, MEETING_M, MEETING_RAD = 1.5, 0.01, 0.05
"""A reference that goes to its robot needs to go no farther than the distance between them. One
that has gone so many times as far, and a little, chases a robot that goes along."""

EASE_ABOVE = 0.5
"""Share of the leash beyond which a reference that nobody drives is brought back to its robot, so
that an arm that lags (MaxSpeedDeviation, a person in its way) stops when the hand lets go and not
a leash further on. Gravity sag is far below it and never creeps in."""

EASE_BELOW = 0.1
"""Share of the leash at which that is enough."""

CLUTCH_WITHIN_S = 0.5
"""Older presses of the clutch begin nothing: this computer may have stood still. They still end."""

CLUTCH_ERROR_SHARE = 0.5
"""Share of the following error that trips, beyond which no hand is taken up."""


class Phase(enum.Enum):
    """What a session is doing."""

    NO_ROBOT = "no robot"
    """The robot is silent or would not act on commands."""
    DISARMED = "disarmed"
    """Holding; going on takes the deliberate act."""
    HOLDING = "holding"
    """Armed and at rest: the operator may move at once."""
    MOVING = "moving"
    BRAKING = "braking"
    """Ramping down, by the operator's will or because something is wrong."""


@dataclass(frozen=True, kw_only=True)
class Watchdogs:
    """Limits on age and error; each trips into a braking ramp. All by local monotonic time."""

    device_age_s: float = 0.1
    """Oldest report that may still drive motion: six missed reports of a 62 Hz device."""
    longest_step_s: float = 0.05
    """Longest time one tick may advance: after a stall the reference resumes, it never leaps."""
    stall_s: float = 0.1
    """Longest time between two ticks: after more, the robot is no longer where it was left."""
    following_error_m: float = 0.1
    """Distance between reference and robot beyond which something else holds the arm."""
    following_error_rad: float = 0.6
    following_error_joint: float = 0.5
    """rad or m; between commanded and measured joints, where sessions command joints. At the full
    speed of an arm's wrist a position loop lags by 0.3 rad."""


class EngineStatus(NamedTuple):
    """What the last tick decided, for people and for recorders."""

    phase: Phase
    message: str
    """Why nothing moves and what to do about it; empty when all is well."""
    target: Twist
    """What is asked for, along `target.frame`: the operator's twist after the filters."""
    twist: Twist
    """What is commanded, base axes."""
    pose: Pose | None
    """Where the TCP is told to be."""
    leash_used: float
    at_workspace_limit: bool
    gripper_closed: bool
    trips: int
    """How often a watchdog or fault took the operator's hand off the robot."""
    filters: tuple[str, ...] = ()
    """What the filters do to the operator's motion, in words; those that do nothing are silent."""
    arm: ServoStatus | None = None
    """What the servo met, where the session has an arm's model."""


class TeleopEngine:
    """Rate or position control of a TCP with a virtual reference point."""

    def __init__(
        self,
        mapping: TwistMapping,
        reference: Reference,
        watchdogs: Watchdogs,
        filters: Sequence[TwistFilter] = (),
        arm: ArmFollower | None = None,
    ) -> None:
        """With `arm` the joints are commanded by its model, and keep its limits."""
        self.mapping = mapping
        self.reference = reference
        self.watchdogs = watchdogs
        self.filters = tuple(filters)
        """Shared control: applied in this order between mapping and reference."""
        self.arm = arm
        self._position: HandMapping | None = None
        """How the hand's pose is followed; None in rate mode."""
        if mapping.options.mode is Mode.POSITION:
            self._position = PositionMapping(mapping.options, reference.limits)
        elif mapping.options.mode is Mode.ABSOLUTE:
            self._position = AbsoluteMapping(mapping.options, reference.limits)
        self._following = False
        self._clutch_was_up = self._was_live = False
        """Whether the button that toggles the clutch was seen up, and the device live, before."""
        self._recapture = False
        self._refusal = ""
        """Why the clutch was pressed in vain."""
        self._disturbed = False
        """Whether anything in this tick makes a press of the clutch no deliberate act."""
        self._let_run_out = False
        """Whether the operator ended the motion, so that it may end as softly as it went."""
        self._misfit = ""
        self._filter_fault = ""
        self._phase = Phase.NO_ROBOT
        self._session: int | None = None
        self._target = ZERO_TWIST
        self._message = "waiting for the robot"
        self._trip_reason = ""
        self._trips = 0
        self._armed = False
        self._deadman_was_up = False
        self._resyncing = False
        self._resync_s = 0.0
        self._joints_asked = False
        self._easing = False
        self._meeting = False
        self._way_m = self._way_rad = 0.0
        """How far the reference may still go to meet its robot."""
        self._ticked_s = NEVER_S
        self._stop_reason = ""
        self._objection = ""
        """Why somebody else wants the operator's hand off the robot, from the next tick on."""
        self._suspended = False

    @property
    def phase(self) -> Phase:
        """What the session is doing now."""
        return self._phase

    @property
    def at_rest(self) -> bool:
        """True when nothing is commanded to move."""
        return not self._moving

    @property
    def following(self) -> bool:
        """True while the operator's hand drives the robot: armed, dead-man held, clutched in."""
        return self._following

    def hand_map(self) -> WorldMap | None:
        """Where the TCP is told to go for any place of the hand, as things stand after the last
        tick, within the workspace; None while no hand's pose is followed, or through axes that
        mirror."""
        if self._position is None or not self._following:
            return None
        return self._position.world_map()

    @property
    def _moving(self) -> bool:
        return self.reference.moving or (self.arm is not None and self.arm.moving)

    def status(self) -> EngineStatus:
        """A snapshot for views and recorders."""
        reference = self.reference
        return EngineStatus(
            self._phase,
            self._message,
            self._target,
            reference.twist,
            reference.pose,
            reference.leash_used,
            reference.at_workspace_limit,
            self.mapping.gripper_closed,
            self._trips,
            tuple(words for each in self.filters if (words := each.status())),
            None if self.arm is None or self.reference.pose is None else self.arm.status(),
        )

    def request_stop(self, reason: str) -> None:
        """Brake and stay: from now on no operator input moves the robot."""
        self._stop_reason = self._message = reason
        self._let_run_out = False

    def trip(self, reason: str) -> None:
        """Take the operator's hand off the robot in the next tick, as the watchdogs do; without
        effect where nobody drives it by then."""
        self._objection = self._objection or reason

    def suspend(self) -> None:
        """In the next tick the operator asks for no motion, whatever the hand does; after it, the
        hand is followed as before."""
        self._suspended = True

    def tick(
        self, robot: RobotState, device: DeviceState, events: Sequence[ButtonEvent] = ()
    ) -> RobotCommand:
        """Decide the command for the control instant that `robot` reports."""
        stalled_s, self._ticked_s = robot.stamp_s - self._ticked_s, robot.stamp_s
        objection, self._objection = self._objection, ""
        suspended, self._suspended = self._suspended, False
        self._disturbed = self._recapture = False
        measured = self._measured(robot) if robot.ready else None
        if measured is None:
            self._see_clutch(device)
            return self._without_robot(robot)
        if robot.session != self._session:
            if self._session is not None and self._armed:
                self._trip("the robot's controller started a new session")
            self._session = robot.session
            self._armed = self._deadman_was_up = False
            self._place(measured, robot)
        elif self._phase is Phase.NO_ROBOT or self.reference.pose is None:
            self._place(measured, robot)
        elif stalled_s > self.watchdogs.stall_s:
            if self._armed:
                self._trip(f"this computer stalled for {stalled_s:.1f} s")
            self._deadman_was_up = False
            self._place(measured, robot)
        if events and self._position is not None and self._let_go(events):
            self._position.release()  # Although it may be held again by now.
        self.reference.observe(measured)
        self._supervise(robot, device, objection)
        self._arm(robot, device)
        if events:
            self._take_presses(robot, device, events)
        self._see_clutch(device)
        if events and self._armed and self.mapping.deadman_held(device):
            self.mapping.take_gripper(events)

        dt_s = min(max(robot.period_s, 0.0), self.watchdogs.longest_step_s)
        wanted = ZERO_TWIST
        self._following = self._armed and self.mapping.deadman_held(device)
        if self._following and self._position is not None:
            wanted = self._follow(self._position, robot, device, dt_s)
        elif self._following:
            wanted = self.mapping.twist(device.axes)
        if self._position is not None and not self._following:
            self._position.release()
        if suspended:
            wanted = ZERO_TWIST
        if self.filters:
            # A robot may report joints alone, or another tool's pose: filters get the model's.
            seen = robot if self.arm is None else robot._replace(pose=measured)
            wanted = self._filter(wanted, seen)
        self._target = wanted
        rates: dict[str, float] = {}
        if self.mapping.drives_joints and self._following and not suspended:
            rates = self.mapping.joint_rates(device.axes)
        self._joints_asked = any(rates.values())
        asked = self._joints_asked or wanted.linear != ZERO3 or wanted.angular != ZERO3
        used = self.reference.leash_used
        # From rest only: a robot that lags may still be on its way while the reference brakes.
        rests = self._easing or not self._moving
        self._easing = (
            rests
            and (not asked or self._resyncing)
            and used > (EASE_BELOW if self._easing else EASE_ABOVE)
        )
        given_up = self._resyncing and self._resync_s > RESYNC_GIVE_UP_S
        meeting = (self._easing or self._resyncing) and not given_up
        if meeting and not self._meeting:
            self._way_m = MEETING_WAYS * self.reference.ahead_m + MEETING_M
            self._way_rad = MEETING_WAYS * self.reference.ahead_rad + MEETING_RAD
        self._meeting = meeting
        smooth = self._armed or (
            self._let_run_out and not (robot.alarm or self._filter_fault or self._resyncing)
        )
        before = self.reference.pose
        if self._easing and not given_up:
            wanted = self._resync_twist(measured)
        if self.arm is None:
            self.reference.advance(wanted, dt_s, smooth=smooth)
        elif given_up:
            self.reference.place(self.arm.halt(dt_s))
        elif self._resyncing or self._easing:
            self.reference.place(self.arm.glide(robot, RESYNC_TIME_S, dt_s))
        else:
            for step_s in self.arm.steps(dt_s):
                self.reference.shape(wanted, step_s, smooth=smooth)
                self.arm.advance(self.reference, step_s, rates)
        if meeting:
            self._count_way(before)
        self._settle(robot, device)
        if self.arm is not None:
            return self.arm.command(robot, meeting)
        pose = self.reference.pose
        assert pose is not None
        return PoseCommand(pose, self.reference.twist)

    def _let_go(self, events: Sequence[ButtonEvent]) -> bool:
        deadman = self.mapping.options.deadman
        return any(event.button in deadman and not event.pressed for event in events)

    def _follow(
        self, position: HandMapping, robot: RobotState, device: DeviceState, dt_s: float
    ) -> Twist:
        """What the hand asks for, taken up first where it was not before."""
        if not position.engaged:
            self._refusal = self._why_not_taken(robot, device)
            if self._refusal:
                self._armed = self._following = self._deadman_was_up = False
                return ZERO_TWIST
        hand, tcp = device.pose, self.reference.pose
        assert hand is not None  # _supervise() and _why_not_taken() have seen to it.
        assert tcp is not None
        if self._recapture or not position.engaged:
            position.engage(hand, device.stamp_s, resting_pose(self.reference))
        return position.twist(hand, device.stamp_s, tcp, dt_s)

    def _see_clutch(self, device: DeviceState) -> None:
        """Note whether the button that toggles the clutch is up. Held through a loss, it is not
        pressed anew."""
        self._was_live = device.link is DeviceLink.LIVE
        self._clutch_was_up = self._was_live and self.mapping.options.clutch not in device.buttons

    def _take_presses(
        self, robot: RobotState, device: DeviceState, events: Sequence[ButtonEvent]
    ) -> None:
        """Act on the edges of the buttons that toggle the clutch and take the references anew."""
        options = self.mapping.options
        if not options.clutch and not options.recapture:
            return
        for event in events:
            if event.button == options.recapture:
                self._recapture = self._recapture or event.pressed
            elif event.button != options.clutch:
                continue
            elif not event.pressed:
                self._clutch_was_up = self._was_live
            elif self._armed:
                self._armed = self._clutch_was_up = False
                self._let_run_out = True
                if self._position is not None:
                    self._position.release()  # Although it may be taken up again by now.
            else:
                deliberate, self._clutch_was_up = self._clutch_was_up, False
                tripped = self._disturbed and self._trip_reason
                if deliberate and not (tripped or self._resyncing or self._obstacle(robot, device)):
                    self._clutch_in(robot, device, robot.stamp_s - event.stamp_s)

    def _clutch_in(self, robot: RobotState, device: DeviceState, pressed_ago_s: float) -> None:
        if pressed_ago_s > CLUTCH_WITHIN_S:
            self._refusal = f"it was pressed {pressed_ago_s:.1f} s ago"
        elif self._position is None and device.axes != NO_DEFLECTION:
            self._refusal = "the device is not at rest"
        else:
            self._refusal = self._why_not_taken(robot, device)
        if not self._refusal:
            self._armed, self._trip_reason, self._let_run_out = True, "", False

    def _obstacle(self, robot: RobotState, device: DeviceState) -> bool:
        """Whether anything that the message names by itself keeps the operator from arming."""
        return bool(
            self._stop_reason
            or robot.alarm
            or self._filter_fault
            or device.link is not DeviceLink.LIVE
            or (self._position is None and not is_finite(device.axes))
        )

    def _why_not_taken(self, robot: RobotState, device: DeviceState) -> str:
        """Why neither hand nor robot are as they must be to take the hand up, in words."""
        limits = self.watchdogs
        if self._disturbed:
            return "the robot was not ready for it"
        if self._position is not None:
            if device.pose is None or not is_pose(device.pose):
                return "the device gives no pose"
            age_s = robot.stamp_s - device.stamp_s
            if age_s > limits.device_age_s:
                return f"the hand's pose is {age_s:.2f} s old"
            if age_s < -limits.device_age_s:
                return f"the robot's pose is {-age_s:.2f} s older than the hand's"
        error_m, error_rad = self.reference.ahead_m, self.reference.ahead_rad
        joint, joint_error = "", 0.0
        if self.arm is not None:
            joint, joint_error = self.arm.worst_joint(robot)
        if (
            error_m > CLUTCH_ERROR_SHARE * limits.following_error_m
            or error_rad > CLUTCH_ERROR_SHARE * limits.following_error_rad
            or joint_error > CLUTCH_ERROR_SHARE * limits.following_error_joint
        ):
            joints = f" ({joint} by {joint_error:.2f})" if joint else ""
            return (
                f"the robot is {error_m * 1e3:.0f} mm and {error_rad:.2f} rad behind its "
                f"reference{joints}"
            )
        return ""

    def _count_way(self, before: Pose | None) -> None:
        """Give up a reference that goes on and on and does not meet its robot."""
        after = self.reference.pose
        assert before is not None
        assert after is not None
        self._way_m -= norm(subtract(after.position, before.position))
        self._way_rad -= norm(rotation_between(before.orientation, after.orientation))
        if self._way_m < 0.0 or self._way_rad < 0.0:
            if self._armed:
                self._trip("the robot goes along when its reference is brought back to it")
            self._resyncing, self._resync_s = True, math.inf

    def _measured(self, robot: RobotState) -> Pose | None:
        """The TCP's measured pose, by the arm's model where there is one."""
        if self.arm is None:
            return robot.pose
        new = robot.session != self._session or self._phase is Phase.NO_ROBOT
        self._misfit = self.arm.obstacle(robot, new)
        return None if self._misfit else self.arm.measured(robot)

    def _place(self, measured: Pose, robot: RobotState) -> None:
        self._resyncing = self._easing = self._meeting = False
        self._disturbed = True
        self.reference.place(measured)
        if self.arm is not None:
            self.arm.place(robot)

    def _filter(self, wanted: Twist, robot: RobotState) -> Twist:
        """What the filters make of `wanted`; none can start a motion, or go on when it fails."""
        self._filter_fault = ""
        filtered = wanted
        for each in self.filters:
            wrong = ""
            try:
                filtered = each.apply(filtered, robot)
                if not (is_finite(filtered.linear) and is_finite(filtered.angular)):
                    wrong = "gives values that are not numbers"
            except Exception as error:  # Whatever it is, the arm must still brake in a ramp.
                wrong = f"failed: {error!r}"
            if wrong:
                filtered = ZERO_TWIST
                self._filter_fault = self._filter_fault or f"the filter {each.name} {wrong}"
        if self._filter_fault:
            if self._armed:
                self._trip(self._filter_fault)
            return ZERO_TWIST
        asked = wanted.linear != ZERO3 or wanted.angular != ZERO3
        return filtered if asked else wanted

    def _without_robot(self, robot: RobotState) -> RobotCommand:
        """No robot to command: whoever was moving it must take it up anew."""
        if self._armed:
            if robot.link is not RobotLink.LIVE:
                self._trip("the robot's controller fell silent")
            elif robot.session != self._session:
                self._trip("the robot's controller started a new session")
            else:
                self._trip(robot.hold_reason or self._misfit or "the robot reports no pose")
        self._phase = Phase.NO_ROBOT
        self._deadman_was_up = False  # Held through the silence, it is no deliberate act.
        if self.filters:
            self._filter(ZERO_TWIST, robot)
        self._target, self._joints_asked = ZERO_TWIST, False
        self._resyncing = self._easing = False
        if self.reference.pose is not None:
            self.reference.place(self.reference.pose)
        self._message = robot.hold_reason or self._misfit or "the robot reports no pose"
        return HoldCommand()

    def _trip(self, reason: str) -> None:
        self._armed = self._following = self._let_run_out = False
        self._deadman_was_up = False
        self._disturbed = True
        self._refusal = ""
        self._trip_reason = reason
        self._trips += 1

    def _supervise(self, robot: RobotState, device: DeviceState, objection: str) -> None:
        """Take the operator's hand off the robot when anything is wrong."""
        error_m, error_rad = self.reference.ahead_m, self.reference.ahead_rad
        limits = self.watchdogs
        joint, joint_error = "", 0.0
        if self.arm is not None:
            joint, joint_error = self.arm.worst_joint(robot)
        if (
            error_m > limits.following_error_m
            or error_rad > limits.following_error_rad
            or joint_error > limits.following_error_joint
        ):
            if not self._resyncing:
                self._resyncing, self._resync_s = True, 0.0
                joints = f" ({joint} by {joint_error:.2f})" if joint else ""
                reason = (
                    f"the robot is {error_m * 1e3:.0f} mm and {error_rad:.2f} rad away from its "
                    f"reference{joints}: something else holds it"
                )
                self._trip(reason)
        elif self._resyncing and not self._easing and not self._moving:
            self._resyncing = False
        if self._resyncing:
            self._resync_s += min(max(robot.period_s, 0.0), limits.longest_step_s)
        if not self._armed:
            return
        age_s = robot.stamp_s - device.stamp_s
        if self._stop_reason:
            self._armed = False
        elif robot.alarm:
            self._trip(robot.alarm)
        elif device.link is not DeviceLink.LIVE:
            self._trip(device.reason or f"the device is {device.link.value}")
        elif objection:
            self._trip(objection)
        elif self._position is None and not is_finite(device.axes):
            self._trip("the device gives values that are not numbers")
        elif age_s < -limits.device_age_s:
            self._trip(f"the device gives a time that is {-age_s:.1f} s to come")
        elif self._position is None:
            if device.axes != NO_DEFLECTION and age_s > limits.device_age_s:
                self._trip(f"the device is deflected but silent for {age_s:.2f} s")
        elif self.mapping.deadman_held(device):
            pose = device.pose
            if pose is None or not is_pose(pose):
                self._trip("the hand is followed, but the device gives no pose")
            elif self._position.leaps(pose, device.stamp_s):
                self._trip("the hand leapt: it is another one, or the sensor lost it")
            elif age_s > limits.device_age_s:
                self._trip(f"the hand is followed, but the device is silent for {age_s:.2f} s")

    def _arm(self, robot: RobotState, device: DeviceState) -> None:
        """Arm after the deliberate act: device at rest, dead-man up, dead-man pressed anew."""
        options = self.mapping.options
        if self._armed or self._resyncing or options.clutch:
            return
        if self._obstacle(robot, device):
            self._deadman_was_up = False
            return
        at_rest = self._position is not None or device.axes == NO_DEFLECTION
        if not options.deadman:
            self._armed = at_rest and self._position is None
        elif not self.mapping.deadman_held(device):
            self._deadman_was_up = self._deadman_was_up or at_rest
        elif self._deadman_was_up and self._position is None:
            self._armed = True
        elif self._deadman_was_up:
            self._refusal = self._why_not_taken(robot, device)
            self._armed = not self._refusal
            self._deadman_was_up = self._armed
        if self._armed:
            self._trip_reason = ""

    def _resync_twist(self, measured: Pose) -> Twist:
        """The gentle way back to a robot that is not where its reference is."""
        pose = self.reference.pose
        assert pose is not None
        gain = 1.0 / RESYNC_TIME_S
        return Twist(
            scale(subtract(measured.position, pose.position), gain),
            scale(rotation_between(pose.orientation, measured.orientation), gain),
            Frame.BASE,
        )

    def _settle(self, robot: RobotState, device: DeviceState) -> None:
        """Name the phase and say what stands in the way."""
        asked = self._joints_asked or self._target.linear != ZERO3 or self._target.angular != ZERO3
        if self._moving and (asked and self._armed):
            self._phase = Phase.MOVING
        elif self._moving:
            self._phase = Phase.BRAKING
        else:
            self._phase = Phase.HOLDING if self._armed else Phase.DISARMED
        self._message = "" if self._armed else self._what_to_do(robot, device)
        if self._following and self._position is not None:
            self._message = self._position.remark

    def _what_to_do(self, robot: RobotState, device: DeviceState) -> str:
        why = f"stopped before: {self._trip_reason}; " if self._trip_reason else ""
        if self._stop_reason:
            return self._stop_reason
        if robot.alarm or self._filter_fault:
            return robot.alarm or self._filter_fault
        if self._resyncing and self._resync_s > RESYNC_GIVE_UP_S:
            return (
                f"{why}the robot does not come together with its reference: stop the session, see "
                "what holds the arm or whether its joints are measured right, and start again"
            )
        if self._resyncing:
            return f"{why}bringing the reference back to the robot"
        if device.link is not DeviceLink.LIVE:
            reason = device.reason or f"the device is {device.link.value}"
            return why + reason if reason not in why else reason
        if self._refusal:
            why = f"the clutch was not taken: {self._refusal}; "
        options = self.mapping.options
        deadman = " or ".join(repr(button) for button in options.deadman)
        deflected = self._position is None and device.axes != NO_DEFLECTION
        if options.clutch:
            first = "let go of the device, then " if deflected else ""
            if options.clutch in device.buttons:
                first = f"let go of {options.clutch!r}, then "
            while_held = f", with {deadman} held," if deadman else ""
            return f"{why}{first}press {options.clutch!r}{while_held} to move"
        if not deadman:
            return f"{why}let go of the device to go on"
        if self._deadman_was_up:
            return f"{why}press {deadman} to move"
        if self._position is not None:
            return f"{why}let go of {deadman}, then press it to go on"
        return f"{why}let go of the device and of {deadman}, then press {deadman} to go on"
