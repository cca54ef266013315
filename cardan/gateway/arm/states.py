"""State machines of an arm, each an enum and one function that returns the next state; and which
source has the authority over it.

That of the operator device, its dead-man and clutch is :mod:`cardan.gateway.operator.deadman`. The
machines are independent: each reads its own state, an :class:`ArmEvent`, and a few :class:`Facts`.
The controller calls them and acts on the result; it assigns states in one place,
`ArmController._enter`. Data of a state (reasons, the arm's motion, limits, counters) is the
controller's.

Properties that are read in every cycle are attributes of the member: a look-up of another member
takes longer than the rest of the comparison.

Read a function downwards: the first case that fits counts, and other events change nothing.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

from cardan.common.bounds import AUTHORITY_LEASE_S
from cardan.common.options import Options
from cardan.errors import ConfigurationError
from cardan.gateway.arm.status import OPERATOR, AuthorityState, Phase
from cardan.gateway.operator.deadman import Arming
from cardan.gateway.operator.input import MotionRequest
from cardan.types import NEVER_S


class RobotReadiness(enum.Enum):
    """Readiness of the robot for commands."""

    ABSENT = "absent"
    """The robot is silent, or does not act on commands; all motion is forgotten."""
    BRAKING_BLIND = "braking blind"
    """The robot sends states, is not ready, and may still obey: a motion is braked in a ramp."""
    READY = "ready"
    """The robot acts on commands."""

    def __init__(self, value: str) -> None:
        self.ready = value == "ready"


class Readings(enum.Enum):
    """Plausibility of the robot's measurements."""

    ACCEPTED = "accepted"
    """The measurements are plausible."""
    REJECTED = "rejected"
    """The measured position is implausible; re-arming accepts the readings again."""
    REJECTED_ELSEWHERE = "rejected elsewhere"
    """The robot also became ready away from its command: re-arming restarts the command from there.
    """

    def __init__(self, value: str) -> None:
        self.rejected, self.elsewhere = value != "accepted", value == "rejected elsewhere"


class MotionState(enum.Enum):
    """Source of the commanded motion."""

    UNCOMMANDED = "uncommanded"
    """The robot is sent a hold."""
    HOLDING = "holding"
    """The robot is commanded to be at rest, or to come to rest."""
    FOLLOWING = "following"
    """The operator device moves it."""
    EXECUTING = "executing"
    """A verb or a stream moves it."""
    RESYNCHRONIZING = "resynchronizing"
    """The command is brought back to a robot that is not where it was commanded to be."""
    BRAKING = "braking"
    """The motion is braking on request."""

    def __init__(self, value: str) -> None:
        self.commanded = value != "uncommanded"
        self.braking = value == "braking"


class Separation(enum.Enum):
    """Separation of command and robot, and the recovery from it."""

    NONE = "none"
    """Command and robot are together."""
    TO_RESYNCHRONIZE = "to resynchronize"
    """The command is to be brought back to its robot as soon as the robot rests."""
    UNTIL_REARMED = "until re-armed"
    """Command and robot stay separate until re-armed."""
    LEFT = "left"
    """A button ended the resynchronization; none begins until motion is requested."""

    def __init__(self, value: str) -> None:
        self.waits = value == "to resynchronize"
        self.until_rearmed = value == "until re-armed"
        self.together, self.left = value == "none", value == "left"


class Inhibit(enum.Enum):
    """Kinds of interruption from outside of the arm. The value is its name in
    records."""

    FOR_GOOD = "request_stop"
    """The motion under way brakes now, and no source moves the arm any more."""
    WHILE_SAID = "hold_off"
    """No source may move the arm from the next tick on, until the reason is set to ""."""
    ONCE = "trip"
    """The next tick disengages the source that moves the arm, as the watchdogs do; no effect if
    none does by then. The first reason counts."""
    MOTION_IGNORED = "suspend"
    """The operator's motion is ignored in the next tick; after it, teleoperation goes on."""


class ArmingAction(enum.Enum):
    """Consequences of the operator's request, beside the requested motion."""

    TRIP = "the device must not drive any longer"
    LET_GO = "the clutch was released: the arm brakes, and its authority is free"
    ARM = "the device is armed"
    TAKE = "the device takes the arm from whatever moves it, and is armed"
    ACKNOWLEDGE = "re-arming was requested where it arms nothing"


class ArmEvent(enum.Enum):
    """Events of an arm, beside its operator's requests."""

    READY = "a tick ends in which the robot was ready"
    UNREADY = "the robot is silent or not ready"
    FORGOTTEN = "all motion is discarded: the robot's position after its return is unknown"
    RETURNED = "the robot is ready again while its readings are rejected"
    JUMPED = "the measured position is implausible"
    PLAUSIBLE = "re-arming accepts the readings"
    PLACED = "the command was placed where the robot is, at the speed that it has"
    INVALID = "a command that is beyond a limit was not sent"
    ENGAGED = "a source has the robot commanded, from where it is"
    FOLLOWS = "the operator device begins to move the arm"
    EXECUTES = "a verb or a stream begins to move it"
    RESYNCHRONIZES = "the command begins to go back to the robot"
    BRAKES = "the moving source is commanded to rest"
    OVER = "the motion or stream has ended"
    COASTED = "a robot that moved when its command was placed came to rest"
    HELD = "the robot is not where it is commanded to be"
    DISARMED = "the operator must engage again"
    NOT_BACK = "a resynchronization ended, or must not begin, while they are apart"
    LEFT = "a button of a device that is armed ended a resynchronization"
    ASKED = "the operator asks for motion"
    ACKNOWLEDGED = "re-arming was requested"


class Facts(NamedTuple):
    """Conditions for the next state, beside the state and the event."""

    device: bool = False
    """Whether the arm has an operator device."""
    moving: bool = False
    """Whether the arm is commanded to move."""
    near: bool = False
    """Whether the command is so near its robot that no recovery is needed."""
    resynchronizes: bool = False
    """True if the options enable bringing commands back to their robots."""


class States(NamedTuple):
    """The state of each machine."""

    link: RobotReadiness = RobotReadiness.ABSENT
    readings: Readings = Readings.ACCEPTED
    motion: MotionState = MotionState.UNCOMMANDED
    separation: Separation = Separation.NONE
    arming: Arming = Arming.DISARMED

    def after(self, event: ArmEvent, facts: Facts) -> States:
        """Return the states after `event`."""
        return self._replace(
            link=link_after(self.link, event, facts),
            readings=readings_after(self.readings, event, self),
            motion=motion_after(self.motion, event, facts),
            separation=separation_after(self.separation, event, facts),
            arming=Arming.DISARMED if event is ArmEvent.DISARMED else self.arming,
        )


def link_after(link: RobotReadiness, event: ArmEvent, facts: Facts) -> RobotReadiness:
    """Return the robot's readiness after `event`."""
    match event:
        case ArmEvent.READY:
            return RobotReadiness.READY
        case ArmEvent.UNREADY:
            return RobotReadiness.BRAKING_BLIND if facts.moving else RobotReadiness.ABSENT
        case ArmEvent.FORGOTTEN if link is RobotReadiness.BRAKING_BLIND:
            return RobotReadiness.ABSENT
    return link


def readings_after(readings: Readings, event: ArmEvent, states: States) -> Readings:
    """Return the plausibility of the readings after `event` in these `states`."""
    rejected = readings.rejected
    match event:
        case ArmEvent.PLACED | ArmEvent.PLAUSIBLE:
            return Readings.ACCEPTED
        case ArmEvent.JUMPED if states.link is RobotReadiness.ABSENT:
            return Readings.REJECTED_ELSEWHERE
        case ArmEvent.JUMPED if not rejected:
            return Readings.REJECTED
        case ArmEvent.RETURNED if rejected and states.motion is MotionState.UNCOMMANDED:
            return Readings.REJECTED_ELSEWHERE
        case ArmEvent.INVALID if rejected:
            return Readings.REJECTED_ELSEWHERE
    return readings


def motion_after(motion: MotionState, event: ArmEvent, facts: Facts) -> MotionState:
    """Return the source of motion after `event`."""
    match event:
        case ArmEvent.FORGOTTEN:
            return MotionState.UNCOMMANDED
        case ArmEvent.PLACED if facts.moving:
            return MotionState.BRAKING
        case ArmEvent.PLACED:
            return MotionState.HOLDING if facts.device else MotionState.UNCOMMANDED
        case ArmEvent.ENGAGED if motion is MotionState.UNCOMMANDED:
            return MotionState.HOLDING
        case ArmEvent.FOLLOWS:
            return MotionState.FOLLOWING
        case ArmEvent.EXECUTES:
            return MotionState.EXECUTING
        case ArmEvent.RESYNCHRONIZES:
            return MotionState.RESYNCHRONIZING
        case ArmEvent.BRAKES if motion not in RESTING:
            return MotionState.BRAKING
        case ArmEvent.COASTED if not facts.device:
            return MotionState.UNCOMMANDED
        case ArmEvent.OVER | ArmEvent.COASTED if motion is not MotionState.UNCOMMANDED:
            return MotionState.HOLDING
    return motion


RESTING = (MotionState.UNCOMMANDED, MotionState.HOLDING)
"""States in which nothing moves the arm; in each other one there is a motion that does."""


def separation_after(separation: Separation, event: ArmEvent, facts: Facts) -> Separation:
    """Return the separation of command and robot after `event`."""
    match event:
        case ArmEvent.UNREADY | ArmEvent.PLACED if separation is not Separation.LEFT:
            return Separation.NONE
        case ArmEvent.JUMPED | ArmEvent.RESYNCHRONIZES if separation is Separation.TO_RESYNCHRONIZE:
            return Separation.NONE
        case ArmEvent.HELD if facts.resynchronizes:
            return Separation.TO_RESYNCHRONIZE
        case ArmEvent.HELD | ArmEvent.NOT_BACK:
            return Separation.UNTIL_REARMED
        case ArmEvent.LEFT:
            return Separation.LEFT
        case ArmEvent.ASKED if separation is Separation.LEFT:
            return Separation.NONE
        case ArmEvent.ACKNOWLEDGED if separation is Separation.UNTIL_REARMED:
            again = facts.resynchronizes and not facts.near
            return Separation.TO_RESYNCHRONIZE if again else Separation.NONE
    return separation


def inhibits_after(
    inhibits: Mapping[Inhibit, str], reason: str, kind: Inhibit
) -> Mapping[Inhibit, str]:
    """Return the inhibits of the arm, each with its reason, after a request for `kind`."""
    match kind:
        case Inhibit.WHILE_SAID if not reason:
            return {each: why for each, why in inhibits.items() if each is not kind}
        case Inhibit.ONCE if inhibits.get(kind):
            return inhibits
    return {**inhibits, kind: reason}


def arming_after(
    arming: Arming, request: MotionRequest, acknowledges: bool, owns: bool, refused: bool
) -> tuple[Arming, ArmingAction | None]:
    """Return the arming after the operator's request, and its consequence, if any.

    `acknowledges`: whether there is something to acknowledge where nothing is armed; `owns`:
    whether the device has the authority over the arm; `refused`: whether it may not take it.
    """
    asked = request.arming
    match arming.armed, asked.armed:
        case _ if request.fault:
            return Arming.DISARMED, ArmingAction.TRIP
        case before, after if request.filter_fault:
            return (Arming.DISARMED, ArmingAction.TRIP) if before or after else (asked, None)
        case True, False:
            return asked, ArmingAction.LET_GO
        case False, True:
            return asked, ArmingAction.TAKE if asked.claims else ArmingAction.ARM
        case _ if request.arming_requested and acknowledges:
            return asked, ArmingAction.ACKNOWLEDGE
        case True, True if asked.claims and not owns:
            return (Arming.DISARMED, ArmingAction.TRIP) if refused else (asked, ArmingAction.TAKE)
    return asked, None


def phase_of(states: States, moving: bool, asks: bool, recovers: bool) -> Phase:
    """Return the phase of the arm that is displayed.

    `moving`: whether it is commanded to move; `asks`: whether the operator asks for motion;
    `recovers`: whether the motion brings the command back to its robot.
    """
    match states.link, states.motion:
        case RobotReadiness.ABSENT, _:
            return Phase.NO_ROBOT
        case RobotReadiness.BRAKING_BLIND, _:
            return Phase.BRAKING
        case _ if recovers:
            return Phase.RECOVERING
        case _, MotionState.EXECUTING if moving:
            return Phase.MOVING
        case _, MotionState.FOLLOWING if moving and asks:
            return Phase.MOVING
        case _ if moving:
            return Phase.BRAKING
        case _, MotionState.FOLLOWING | MotionState.EXECUTING:
            return Phase.HOLDING
    return Phase.HOLDING if states.arming.armed else Phase.DISARMED


LEASE_S = 2.0
"""Default time until the authority of a source that does not renew it expires: longer than any
network's pause that an operator would sit out, short enough for others to wait for."""


class AuthorityPolicy(enum.Enum):
    """Policy for taking the authority from another source. Stop needs no authority."""

    OPERATOR = "device"
    """Re-arming the operator device takes it from any source; others when it is free."""
    FIRST = "first"
    """Any source takes it when it is free, the operator device included."""
    NAMED = "named"
    """Reserved for the named source and the one that this hands it over to; the name of a network
    ("ros2") includes each of its nodes ("ros2 /joystick")."""


@dataclass(frozen=True, kw_only=True)
class AuthorityOptions(Options):
    """``[authority]``: sources that may move the arm, and their precedence."""

    RENAMED: ClassVar = {f"{key} = 'hand'": f"{OPERATOR!r}" for key in ("policy", "named")}

    policy: AuthorityPolicy = AuthorityPolicy.OPERATOR
    named: str = ""
    """The source that may have it if `policy` is NAMED."""
    lease_s: Annotated[float, AUTHORITY_LEASE_S] = LEASE_S
    """Time until the authority of a source that does not renew it expires, s."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.policy is AuthorityPolicy.NAMED) is not bool(self.named):
            raise ConfigurationError(
                "named",
                'policy = "named" needs the source that it is for ("device", "verbs", or the owner '
                "of a stream); no other policy has one",
            )


class Authority:
    """The one source that may move the arm, and its lease. All times are the robot's stamps, s."""

    def __init__(self, options: AuthorityOptions | None = None, network: str = "") -> None:
        """`network`: first word of the names of sources on the arm's network, reserved for these;
        empty: the arm takes no commands from a network."""
        options = options or AuthorityOptions()
        self.policy, self.named, self.lease_s = options.policy, options.named, options.lease_s
        self.network = network
        self.owner = ""
        """The source that has it; empty: none."""
        self._since_s = self._renewed_s = NEVER_S
        self._handed_to = ""
        """Source that the authority was handed over to, until it uses it."""
        self._refused = ""

    def state(self) -> AuthorityState:
        """For status, snapshot and log."""
        return AuthorityState(self.owner, self._since_s, self._refused)

    def expire(self, now_s: float, busy: bool) -> None:
        """Free the authority of an owner that has not renewed it; one whose motion is `busy`
        keeps it."""
        if busy:
            self._renewed_s = now_s
        elif now_s - self._renewed_s > self.lease_s:
            self.owner = self._handed_to = ""

    def refuses(self, source: str) -> str:
        """Return why `source` may not take it now; empty when it may."""
        if source == self.owner:
            return ""
        if self.owner and not (self.policy is AuthorityPolicy.OPERATOR and source == OPERATOR):
            return f"{self.owner!r} has authority over the arm"
        if self.policy is AuthorityPolicy.NAMED and not self._is_named(source):
            return f"authority over the arm is reserved for {self.named!r}"
        return ""

    def _is_named(self, source: str) -> bool:
        """Return whether the arm is reserved for `source`, or for its network."""
        if source in (self.named, self._handed_to):
            return True
        is_network = bool(self.network) and self.named == self.network
        return is_network and source.startswith((f"{self.named} /", f"{self.named} #"))

    def take(self, source: str, now_s: float) -> str:
        """Give it to `source`, or renew it; return why not, or ""."""
        refusal = self.refuses(source)
        if refusal:
            self._refused = f"{source}: {refusal}"
            return refusal
        if source != self.owner:
            self.owner, self._since_s, self._handed_to = source, now_s, ""
        self._renewed_s = now_s
        return ""

    def hand_over(self, source: str, to: str, now_s: float) -> str:
        """Pass it from `source`, its owner, to `to`; return why not, or ""."""
        if source != self.owner:
            return f"{source!r} has no authority over the arm to hand over"
        self.owner, self._since_s, self._renewed_s, self._handed_to = to, now_s, now_s, to
        return ""

    def release(self, source: str) -> None:
        """Free the authority of `source`; no effect on that of another."""
        if source == self.owner:
            self.owner = self._handed_to = ""
