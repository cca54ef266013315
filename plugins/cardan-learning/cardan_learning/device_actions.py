"""An operator device as a source of actions: its states in, numbers by name out.

The rules of dead-man, clutch and rest are those of every session (:mod:`cardan.gateway.operator`).
There is no arm here: the device moves a virtual TCP, which starts where the operator engages it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from cardan.errors import ConfigurationError
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.deadman import Arming
from cardan.gateway.operator.input import ArmView, MotionRequest, OperatorInput
from cardan.gateway.operator.mapping import (
    GripperOptions,
    MappingOptions,
    Mode,
    Orientation,
    TwistMapping,
)
from cardan.spatial import add, from_rotation_vector, multiply, normalized, rotate, scale
from cardan.types import (
    IDENTITY_POSE,
    ButtonEvent,
    DeviceState,
    Frame,
    Pose,
    RobotLink,
    RobotState,
    Twist,
)
from cardan_learning.features import (
    CLOSE,
    CLOSING,
    MOTIONS,
    OPEN,
    OPENING,
    STAY,
    ActionKind,
    six_of,
)

LONGEST_STEP_S = 0.1
"""Longest time step: the device's TCP does not make up for a longer pause."""

DEVICE_ACTIONS = (ActionKind.DELTA, ActionKind.TARGET)


@dataclass(frozen=True)
class EventButtons:
    """Buttons for an operator's verdict on an episode; empty: none."""

    success: str = ""
    failure: str = ""
    again: str = ""
    """Button that ends the episode, which is to be recorded again."""


class DeviceEvents(NamedTuple):
    """The operator's button events since the last call."""

    intervenes: bool
    """True while the operator controls the arm, or would."""
    ends: bool
    succeeded: bool
    again: bool


class DeviceActions:
    """Actions from an operator device with its mapping and gripper buttons. For one thread; has no
    clock."""

    def __init__(
        self,
        kind: ActionKind,
        mapping: MappingOptions,
        gripper: GripperOptions,
        limits: ReferenceLimits,
        device_age_s: float,
        buttons: EventButtons | None = None,
    ) -> None:
        """Prepare the mapping. Raises ConfigurationError for a mapping that gives no actions of
        this kind."""
        if mapping.mode is Mode.ABSOLUTE:
            raise ConfigurationError(
                "mapping.mode",
                '"absolute" needs to know where the arm is: use "position" or "rate"',
            )
        if kind is ActionKind.DELTA and mapping.mode is not Mode.RATE:
            raise ConfigurationError(
                "action",
                f'"delta" is for deflections, and mapping.mode is "{mapping.mode.value}": use '
                'action = "target"',
            )
        if mapping.joints:
            raise ConfigurationError("mapping.joints", "an action has no single joints")
        self.kind = kind
        self._mapping = TwistMapping(mapping, gripper)
        self._source = OperatorInput(self._mapping, limits, (), device_age_s)
        self._buttons = buttons or EventButtons()
        self._request: MotionRequest | None = None
        self._before_s: float | None = None
        self._arming = Arming.DISARMED
        self._at = IDENTITY_POSE
        """Pose of the virtual TCP, relative to where the operator engaged it."""
        self._gripped: bool | None = None
        """True if the gripper was commanded to close; None: no new command."""
        self._ends = self._succeeded = self._again = False

    def update(self, device: DeviceState, events: Sequence[ButtonEvent], now_s: float) -> None:
        """Process the device's state of `now_s`, and the edges of its buttons since the last
        call."""
        before_s = now_s if self._before_s is None else self._before_s
        dt_s = min(max(now_s - before_s, 0.0), LONGEST_STEP_S)
        self._before_s = now_s
        was_closed = self._mapping.gripper_closed
        was_following = self._request is not None and self._request.following
        if not was_following:
            self._at = IDENTITY_POSE
        view = ArmView(
            robot=_robot(now_s, dt_s),
            dt_s=dt_s,
            tcp=self._at,
            resting=self._at,
            arming=self._arming,
            free=True,
        )
        self._request = request = self._source.request(device, events, view)
        self._arming = request.arming
        if request.following:
            self._at = moved(self._at, request.twist, dt_s)
        if self._mapping.gripper_closed is not was_closed:
            self._gripped = self._mapping.gripper_closed
        self._take_buttons(events)

    def _take_buttons(self, events: Sequence[ButtonEvent]) -> None:
        pressed = {event.button for event in events if event.pressed} - {""}
        buttons = self._buttons
        self._succeeded = self._succeeded or buttons.success in pressed
        self._again = self._again or buttons.again in pressed
        ends = {buttons.success, buttons.failure, buttons.again}
        self._ends = self._ends or not ends.isdisjoint(pressed)

    def action(self) -> dict[str, float]:
        """Return the operator's present action, with the gripper's change since the last call."""
        request = self._request
        following = request is not None and request.following
        gripped, self._gripped = self._gripped, None
        if self.kind is ActionKind.DELTA:
            numbers = [0.0] * 6
            if request is not None and following:
                numbers = self._shares(request.twist)
            reported = {None: STAY, True: CLOSE, False: OPEN}[gripped]
            return {**dict(zip(MOTIONS[self.kind], numbers, strict=True)), "gripper": reported}
        numbers = [float(following), *(six_of(self._at) if following else (0.0,) * 6)]
        reported = {None: 0.0, True: CLOSING, False: OPENING}[gripped]
        return {**dict(zip(MOTIONS[self.kind], numbers, strict=True)), "gripper_vel": reported}

    def _shares(self, twist: Twist) -> list[float]:
        options = self._mapping.options
        full = (options.linear_speed_m_s,) * 3 + (options.angular_speed_rad_s,) * 3
        return [speed / most for speed, most in zip((*twist[0], *twist[1]), full, strict=True)]

    def events(self) -> DeviceEvents:
        """Return the button events since the last call, and if the operator intervenes."""
        request = self._request
        reported = DeviceEvents(
            request is not None and (self._arming is Arming.CLAIMING or request.following),
            self._ends,
            self._succeeded,
            self._again,
        )
        self._ends = self._succeeded = self._again = False
        return reported

    def advice(self) -> str:
        """Return advice if the operator's motion moves nothing; empty: it does."""
        if self._request is not None and self._request.following:
            return ""
        return self._source.advice("", self._arming)


def turns_with_tool(mapping: MappingOptions) -> bool:
    """True if rotations are about the tool's axes, not the base's."""
    if mapping.orientation is None:
        return mapping.frame is not Frame.BASE
    return mapping.orientation is Orientation.FOLLOW_TOOL


def moved(at: Pose, twist: Twist, dt_s: float) -> Pose:
    """Return `at` moved by `twist`, along its own frame's axes, for `dt_s`."""
    way, turn = scale(twist.linear, dt_s), from_rotation_vector(scale(twist.angular, dt_s))
    if twist.frame is Frame.TOOL:
        way = rotate(at.orientation, way)
    if twist.frame is Frame.BASE:
        orientation = multiply(turn, at.orientation)
    else:
        orientation = multiply(at.orientation, turn)
    return Pose(add(at.position, way), normalized(orientation), Frame.BASE)


def _robot(now_s: float, dt_s: float) -> RobotState:
    """Return the state of a missing arm: heard now, and ready."""
    return RobotState(now_s, RobotLink.LIVE, 0, 0, dt_s, (), (), None, "")
