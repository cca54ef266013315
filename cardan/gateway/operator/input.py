"""An operator device as a source of motion: its states in, one request per control tick out. Motion
after an interruption needs re-arming: the device at rest and, if one is configured, the dead-man
button released and pressed again, or a press of the button that toggles the clutch. If the device's
pose is followed, deflections mean nothing and need not be at rest. The controller decides on
requests."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from cardan.common.haptics import WorldMap
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.absolute import AbsoluteMapping
from cardan.gateway.operator.deadman import Arming, armed_by_deadman, armed_by_rest
from cardan.gateway.operator.filters.base import TwistFilter
from cardan.gateway.operator.mapping import MappingOptions, Mode, TwistMapping
from cardan.gateway.operator.position import DevicePoseMapping, PositionMapping, is_pose
from cardan.spatial import is_finite
from cardan.types import (
    ZERO3,
    ZERO_TWIST,
    ButtonEvent,
    DeviceLink,
    DeviceState,
    Pose,
    RobotState,
    Twist,
)

NO_DEFLECTION = (0.0,) * 6

CLUTCH_WITHIN_S = 0.5
"""Oldest press that engages the clutch: this computer may have stalled. Older presses still
disengage it."""

NO_RATES: Mapping[str, float] = {}

_ARMED, _CLAIMING, _LIVE = Arming.ARMED, Arming.CLAIMING, DeviceLink.LIVE
"""A look-up of an enum's member takes longer than what is done with it in a cycle."""

_new = tuple.__new__
"""Makes a named tuple in half the time of its constructor, for those of every cycle."""


class ArmView(NamedTuple):
    """State of the arm that a request depends on."""

    robot: RobotState
    """State of the robot, with the measured pose by the arm's model, if there is one."""
    dt_s: float
    """Time by which this tick advances, s."""
    tcp: Pose | None
    """Commanded TCP pose, base frame; None before the robot was ready."""
    resting: Pose | None
    """TCP pose at rest after the hardest allowed braking, base frame."""
    arming: Arming
    """Arming of this device after the last request."""
    free: bool
    """True unless the arm is still braking a motion of another source."""
    inhibited: str = ""
    """Reason why the device cannot be re-armed now, whatever it reports."""
    behind: str = ""
    """Reason why neither a pose nor the clutch is accepted now: the robot is not at its command."""
    tripped: bool = False
    """True if another motion ended in this tick, so that no press in it counts as deliberate."""
    input_ignored: bool = False
    """True if buttons in this tick are ignored: the robot is not ready."""
    suspended: bool = False
    """True if the operator's motion is ignored in this tick."""


class MotionRequest(NamedTuple):
    """Request of an operator in one control tick."""

    arming: Arming
    """Arming after the operator's actions in this tick: the device moves or claims the arm, or
    would if it were free."""
    newly_armed: bool
    """True if the device was re-armed in this tick."""
    arming_requested: bool
    """True if re-arming was requested in this tick, accepted or not."""
    following: bool
    """True if the operator's motion moves the arm now: armed, and the dead-man held."""
    twist: Twist
    """The requested twist, after the filters."""
    rates: Mapping[str, float]
    """Requested joint speeds by name, rad/s or m/s."""
    asks: bool
    """True if motion is requested: `twist` or one of `rates` is not zero."""
    pressed: bool
    """True if any button was pressed in this tick."""
    fault: str
    """Reason why an armed device must not drive any longer; empty when all is well."""
    filter_fault: str
    """Reason why the filters give no twist; empty when all is well."""

    @property
    def armed(self) -> bool:
        """True if this device drives the arm."""
        return self.arming.armed


NO_REQUEST = MotionRequest(
    Arming.DISARMED, False, False, False, ZERO_TWIST, NO_RATES, False, False, "", ""
)


def _followed(options: MappingOptions, limits: ReferenceLimits) -> DevicePoseMapping | None:
    if options.mode is Mode.POSITION:
        return PositionMapping(options, limits)
    return AbsoluteMapping(options, limits) if options.mode is Mode.ABSOLUTE else None


class OperatorInput:
    """Operator device with its mapping, clutch, dead-man and filters."""

    def __init__(
        self,
        mapping: TwistMapping,
        limits: ReferenceLimits,
        filters: Sequence[TwistFilter] = (),
        device_age_s: float = 0.1,
    ) -> None:
        """`limits` are those of the reference that is moved; `device_age_s` is the age of the
        oldest report that may still drive motion. Filters are applied in their order."""
        self.mapping = mapping
        self.filters = tuple(filters)
        self._device_age_s = device_age_s
        self._position = _followed(mapping.options, limits)
        """The mapping of the device's pose; None in rate mode."""
        self._holds = bool(mapping.options.deadman_buttons or mapping.options.clutch)
        """True if an operator without motion still claims the arm, by a button."""
        self._deadman_words = " or ".join(map(repr, mapping.options.deadman_buttons))
        self._refusal = ""
        """Reason why re-arming was last refused."""
        self._device: DeviceState | None = None
        self.complaint = ""
        """Fault in the configuration of the device's buttons; empty if none is known."""

    # -- one control tick ------------------------------------------------------------------------

    def request(
        self, device: DeviceState, events: Sequence[ButtonEvent], view: ArmView
    ) -> MotionRequest:
        """Return the operator's request now; `events` are the button edges since the last call."""
        before, self._device = self._device, device
        position, options = self._position, self.mapping.options
        deadman = options.deadman_buttons
        held = not deadman or not device.buttons.isdisjoint(deadman)
        arming, fault = view.arming, ""
        if events and position is not None and self._let_go(events):
            position.release()  # Although it may be held again by now.
        if arming.armed:
            fault = self._fault(device, view.robot.stamp_s, held)
            if fault:
                arming = Arming.DISARMED
                self.disarm()
        requested = recapture = False
        if view.input_ignored:
            arming = arming if arming.armed else Arming.DISARMED
        else:
            if not arming.armed and not options.clutch:
                arming, requested = self._arm(arming, device, held, view)
            if events and (options.clutch or options.recapture):
                arming, pressed, recapture = self._take_presses(
                    before, device, events, arming, fault, view
                )
                requested = requested or pressed
        armed = arming.armed
        if events and armed and held:
            self.mapping.take_gripper(events)
        following = armed and held and view.free
        if following and position is not None and not position.engaged:
            self._refusal = self._why_not_taken(device, view)
            if self._refusal:
                arming, armed, following = Arming.DISARMED, False, False
        twist = ZERO_TWIST
        if following and position is not None:
            twist = self._by_pose(position, device, view, recapture)
        elif following and not view.suspended:
            twist = self.mapping.twist(device.axes)
        elif position is not None:
            position.release()
        filter_fault = ""
        if self.filters:
            twist, filter_fault = self._filtered(twist, view.robot)
        rates = NO_RATES
        if self.mapping.drives_joints and following and not view.suspended:
            rates = self.mapping.joint_rates(device.axes)
        if armed:
            claims = held and (self._holds or self._deflected(device))
            arming = _CLAIMING if claims else _ARMED
        return _new(
            MotionRequest,
            (
                arming,
                armed and not view.arming.armed,
                requested,
                following,
                twist,
                rates,
                twist.linear != ZERO3 or twist.angular != ZERO3 or any(rates.values()),
                bool(events) and any(event.pressed for event in events),
                fault,
                filter_fault,
            ),
        )

    def disarm(self) -> None:
        """Release the device's pose: re-arming is needed."""
        self._refusal = ""
        if self._position is not None:
            self._position.release()

    def device_map(self) -> WorldMap | None:
        """Return the map from the device's position to the TCP's commanded position, within the
        workspace; None while no pose is followed, or through axes that mirror."""
        return None if self._position is None else self._position.world_map()

    # -- words -----------------------------------------------------------------------------------

    @property
    def remark(self) -> str:
        """Return a message for an operator who drives by pose; empty: all is well."""
        return "" if self._position is None else self._position.remark

    def filter_words(self) -> tuple[str, ...]:
        """Return the effects of the filters on the operator's motion, without filters that have
        none."""
        return tuple(words for each in self.filters if (words := _status(each)))

    def advice(self, why: str, arming: Arming) -> str:
        """Return the instruction to continue from `arming`, after the prefix `why` ("" or "...;
        ")."""
        device, options, position = self._device, self.mapping.options, self._position
        if device is None:
            return why
        reason = _why_not_live(device)
        if reason:
            return why + reason if reason not in why else reason
        if self.complaint:
            return why + self.complaint
        if self._refusal:
            why = f"the clutch was not engaged: {self._refusal}; "
        deadman = self._deadman_words
        deflected = position is None and device.axes != NO_DEFLECTION
        down = device.masked.intersection(options.deadman_buttons)
        if options.clutch:
            down |= (device.masked | device.buttons) & {options.clutch}
        first = f"let go of {' and '.join(map(repr, sorted(down)))}, then " if down else ""
        if options.clutch:
            first = first or ("let go of the device, then " if deflected else "")
            while_held = f", with {deadman} held," if deadman else ""
            return f"{why}{first}press {options.clutch!r}{while_held} to move"
        if not deadman:
            return f"{why}let go of the device to go on"
        if arming is Arming.RELEASED:
            return f"{why}{first}press {deadman} to move"
        if position is not None:
            return f"{why}let go of {deadman}, then press it to go on"
        return f"{why}let go of the device and of {deadman}, then press {deadman} to go on"

    def rearming_instruction(self) -> str:
        """Return the instruction for re-arming."""
        device, options = self._device, self.mapping.options
        if options.clutch:
            instruction = f"press {options.clutch!r}"
            if device is not None and options.clutch in device.masked:
                instruction = f"let go of {options.clutch!r}, then press it"
        elif options.deadman_buttons:
            instruction = f"let go of {self._deadman_words}, then press it"
        else:
            instruction = "move the device and let it go"
        reason = "" if device is None else _why_not_live(device)
        return f"wait for the device ({reason}), then {instruction}" if reason else instruction

    # -- faults ----------------------------------------------------------------------------------

    def _fault(self, device: DeviceState, now_s: float, held: bool) -> str:
        """Return why this device must not drive any longer; `held`: its dead-man."""
        if device.link is not _LIVE:
            return _why_not_live(device)
        position = self._position
        # Their sum first: one call for all that are numbers.
        if position is None and not (math.isfinite(sum(device.axes)) or is_finite(device.axes)):
            return "the device gives values that are not numbers"
        age_s = now_s - device.stamp_s
        if age_s < -self._device_age_s:
            return f"the device gives a time {-age_s:.1f} s in the future"
        old = age_s > self._device_age_s
        if position is None:
            if device.axes != NO_DEFLECTION and old:
                return f"the device is deflected but silent for {age_s:.2f} s"
        elif held:
            pose = device.pose
            if not is_pose(pose):
                return "the device gives no pose to follow"
            if position.jumps(pose, device.stamp_s):
                return "the device's pose jumped: its tracking was lost, or it sees another hand"
            if old:
                return f"the device is silent for {age_s:.2f} s while its pose is followed"
        return ""

    def _deflected(self, device: DeviceState) -> bool:
        return self._position is not None or device.axes != NO_DEFLECTION

    def _unusable(self, device: DeviceState, now_s: float) -> bool:
        """Return whether no report of the device can re-arm it."""
        return device.link is not _LIVE or (
            self._position is None and bool(self._fault(device, now_s, False))
        )

    def _why_not_taken(self, device: DeviceState, view: ArmView) -> str:
        """Return why the clutch cannot be engaged with the present poses of device and robot."""
        if view.behind:
            return view.behind
        if self._position is not None:
            if not is_pose(device.pose):
                return "the device gives no pose"
            age_s = view.robot.stamp_s - device.stamp_s
            if age_s > self._device_age_s:
                return f"the device's pose is {age_s:.2f} s old"
            if age_s < -self._device_age_s:
                return f"the robot's pose is {-age_s:.2f} s older than the device's"
        return ""

    # -- re-arming -----------------------------------------------------------------------------

    def _arm(
        self, arming: Arming, device: DeviceState, held: bool, view: ArmView
    ) -> tuple[Arming, bool]:
        """Return the arming of a disarmed device after re-arming by the dead-man, or by rest
        alone, and whether that was requested."""
        followed = self._position is not None
        if self._unusable(device, view.robot.stamp_s):
            return (arming if arming is Arming.DEFLECTED else Arming.DISARMED), False
        at_rest = followed or device.axes == NO_DEFLECTION
        if self.mapping.options.deadman_buttons:
            arming, requested = armed_by_deadman(arming, held, at_rest, bool(view.inhibited))
            if arming.armed and followed:
                self._refusal = self._why_not_taken(device, view)
                arming = Arming.DISARMED if self._refusal else arming
        else:
            arming, requested = armed_by_rest(arming, at_rest, bool(view.inhibited))
        return arming, requested

    def _take_presses(
        self,
        before: DeviceState | None,
        device: DeviceState,
        events: Sequence[ButtonEvent],
        arming: Arming,
        fault: str,
        view: ArmView,
    ) -> tuple[Arming, bool, bool]:
        """Handle the buttons that toggle the clutch and recapture the references: return the
        arming, whether a deliberate press was made, and whether references are captured.

        A button held in `before`, or while the device was not live, does not count as pressed.
        """
        options = self.mapping.options
        was_live = before is not None and before.link is DeviceLink.LIVE
        was_up = before is not None and was_live and options.clutch not in before.buttons
        requested = recapture = False
        for event in events:
            if event.button == options.recapture:
                recapture = recapture or event.pressed
            elif event.button != options.clutch:
                continue
            elif not event.pressed:
                was_up = was_live
            elif arming.armed:
                arming, was_up = Arming.DISARMED, False
                if self._position is not None:
                    self._position.release()  # Although it may be taken up again by now.
            else:
                deliberate, was_up = was_up, False
                unusable = self._unusable(device, view.robot.stamp_s)
                if not deliberate or fault or view.tripped or unusable:
                    continue
                requested = True
                pressed_ago_s = view.robot.stamp_s - event.stamp_s
                if not view.inhibited and self._clutch_in(device, view, pressed_ago_s):
                    arming = Arming.ARMED
        return arming, requested, recapture

    def _clutch_in(self, device: DeviceState, view: ArmView, pressed_ago_s: float) -> bool:
        if pressed_ago_s > CLUTCH_WITHIN_S:
            self._refusal = f"it was pressed {pressed_ago_s:.1f} s ago"
        elif self._position is None and device.axes != NO_DEFLECTION:
            self._refusal = "the device is not at rest"
        else:
            self._refusal = self._why_not_taken(device, view)
        return not self._refusal

    def _let_go(self, events: Sequence[ButtonEvent]) -> bool:
        deadman = self.mapping.options.deadman_buttons
        return any(event.button in deadman and not event.pressed for event in events)

    # -- motion ----------------------------------------------------------------------------------

    @staticmethod
    def _by_pose(
        position: DevicePoseMapping, device: DeviceState, view: ArmView, recapture: bool
    ) -> Twist:
        """Return the twist towards the TCP pose that belongs to the device's pose."""
        pose = device.pose
        assert pose is not None  # _fault() and _why_not_taken() have seen to it.
        assert view.tcp is not None
        assert view.resting is not None
        if recapture or not position.engaged:
            position.engage(pose, device.stamp_s, view.resting)
        wanted = position.twist(pose, device.stamp_s, view.tcp, view.dt_s)
        return ZERO_TWIST if view.suspended else wanted

    def _filtered(self, wanted: Twist, robot: RobotState) -> tuple[Twist, str]:
        """Return the filters' result for `wanted`, and the fault if there is none; no filter can
        start a motion, or continue it when it fails."""
        fault = ""
        filtered = wanted
        for each in self.filters:
            wrong = ""
            try:
                filtered = each.apply(filtered, robot)
                if not (is_finite(filtered.linear) and is_finite(filtered.angular)):
                    wrong = "gives values that are not numbers"
            except Exception as error:  # In any case, the arm must still brake in a ramp.
                wrong = f"failed: {error!r}"
            if wrong:
                filtered = ZERO_TWIST
                fault = fault or f"the filter {each.name} {wrong}"
        if fault:
            return ZERO_TWIST, fault
        asked = wanted.linear != ZERO3 or wanted.angular != ZERO3
        return (filtered if asked else wanted), ""


def _why_not_live(device: DeviceState) -> str:
    """Return why the device's newest state is not usable; empty when it is."""
    if device.link is DeviceLink.LIVE:
        return ""
    return device.reason or f"the device is {device.link.value}"


def _status(each: TwistFilter) -> str:
    try:
        said = each.status()
        if not isinstance(said, str):
            raise TypeError(f"status() returned {said!r:.60}, not a text")
        return said
    except Exception as error:
        return f"the filter {each.name} failed: {error!r}"
