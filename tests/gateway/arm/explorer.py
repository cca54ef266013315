"""Breadth-first walk over all states of one arm's controller.

The controller, the verbs and the servo are the real ones; the robot is an ideal one in virtual
time. :class:`Abstract` distinguishes states. In each new state every event of EVENTS is applied
once, followed by one tick, and separately by ticks until the state settles, until no new state
appears. :meth:`World.check` checks the invariants of every tick, :func:`check_state` those of every
state.
"""

from __future__ import annotations

import copy
import ctypes
import re
import sys
import types
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from cardan.common.native import NativePartError
from cardan.errors import MotionRefusedError
from cardan.gateway.arm.motions.recover import Recover
from cardan.gateway.arm.motions.reference_motion import Brake, FollowOperator
from cardan.gateway.arm.states import RESTING, Inhibit, States
from cardan.gateway.arm.status import OPERATOR, VERBS
from cardan.gateway.arm.verb_methods import ArmVerbs
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.arm.vocab import Stream
from cardan.gateway.operator.deadman import Arming
from cardan.gateway.operator.mapping import MappingOptions
from cardan.gateway.servo.compiled import CompiledServo
from cardan.gateway.servo.native import kernel_library
from cardan.robots import load_arm
from cardan.spatial import norm
from cardan.types import (
    ButtonEvent,
    CommandKind,
    DeviceLink,
    DeviceState,
    HoldCommand,
    JointCommand,
    RobotCapabilities,
    RobotLink,
    RobotState,
)

DT_S = 0.01
REST = (0.0,) * 6
STREAMER = "a"
SPEED_M_S = 0.05
"""Speed with which device, stream and verb move the TCP."""
QUICK_M_S = 0.5 * SPEED_M_S
SPACE_M = 0.06
"""Distance from the start at which the operator and the stream reverse."""
PLANT_RAD_S = 2.0
"""Greatest joint speed of the robot: it does not jump to a command."""
AWAY_RAD = 0.6
"""Displacement of a pushed robot and size of a reading's jump: above any limit of the following
error."""
STABLE_TICKS = 12
"""Ticks for which a settled state has not changed: more than any silence limit takes to act."""
SETTLES_S = 4.0
"""Time after which every state has settled: a recovery over the whole maximum lead takes
longest."""
WAIT_S = 2.6
"""Longest wait for the next state: longer than the lease of authority."""
BRAKES_S = 0.35
"""Longest motion of the arm after all sources lost permission: the age at which a device or stream
counts as silent, and the ramp."""
RECOVERS_M_S = 0.052
RECOVERED_M = 0.11
"""Longest distance of recoveries without re-arming: the maximum lead plus a tenth."""

BY_DEADMAN = MappingOptions(deadman=("left",), linear_speed_m_s=SPEED_M_S)
BY_CLUTCH = MappingOptions(clutch="left", linear_speed_m_s=SPEED_M_S)
BY_REST = MappingOptions(linear_speed_m_s=SPEED_M_S)
MAPPINGS = {"dead-man": BY_DEADMAN, "clutch": BY_CLUTCH, "rest": BY_REST}
"""Rules of re-arming, by name."""

OFF = "the motors are off"
ALARM = "the port is flooded"
UNPLUGGED = "the device is unplugged"
HELD_OFF = "the supervisor is silent"
BROKEN = "the sensor is broken"


def available() -> bool:
    """True if the compiled servo, whose state can be copied, is available."""
    try:
        kernel_library()
    except NativePartError:
        return False
    return True


class Abstract(NamedTuple):
    """Features that distinguish two states of the world: first the external inputs, then the
    controller's state."""

    robot: RobotLink
    ready: bool
    alarm: bool
    jumped: bool
    pushed: bool
    device: DeviceLink
    stale: bool
    deflected: bool
    button: bool
    streaming: bool
    held_off: bool
    filter_fault: bool
    states: States
    """States that the controller reports."""
    implausible: str
    """"", "rejected", or "rests": readings have been plausible for long enough."""
    following: bool
    was_pressed: bool
    """True if the controller has seen the button pressed."""
    owner: str
    handed_to: bool
    commanded_motion: str
    motion: str
    """"rest", "slow" or "quick"."""
    stream: Stream
    streamed: bool
    """True if a command of the stream was accepted."""
    verb: str
    """"", "running" or "waiting"."""


class Sensed:
    """A filter that passes the twist on until its sensor breaks."""

    name = "sensed"
    broken = False

    def apply(self, twist, robot):
        if self.broken:
            raise RuntimeError(BROKEN)
        return twist

    def status(self):
        return ""


class World:
    """A robot, an operator device, a program that streams, and one that calls verbs."""

    def __init__(self, mapping: MappingOptions = BY_DEADMAN) -> None:
        self.mapping = mapping
        model = load_arm("ur5")
        able = RobotCapabilities(
            frozenset({CommandKind.JOINT}), DT_S, len(model.joints), None, 0, 0
        )
        self.verbs = ArmVerbs.alone(model, able, mapping=mapping)
        self.core = self.verbs.controller
        self.filter = Sensed()
        self.core.operator.filters = (self.filter,)
        self.verbs.set_parameters({"cpts": SPEED_M_S, "cpta": 1.0})
        self.q = np.array(model.home, dtype=float)
        self.v = np.zeros(len(self.q))
        self.offset = 0.0
        self.pushed = False
        self.now_s, self.session, self.sequence = 10.0, 1, 0
        self.link, self.hold_reason, self.alarm = RobotLink.LIVE, "", ""
        self.device = DeviceState(10.0, DeviceLink.LIVE, REST, frozenset())
        self.stale = self.streaming = self.deflected = False
        self.held_off = False
        self.way = 1.0
        self.events: list[ButtonEvent] = []
        self.motion = None
        self.command = HoldCommand()
        self.start: float | None = None
        # State of the operator, as an observer outside of the controller knows it.
        self.rearmed = self.let_go = False
        self.interrupted = False
        self.permitted_s = -1.0
        self.heard = False
        """True if a command of the stream was accepted since the last tick."""
        self.recovered_m = 0.0
        self.at = None
        self.trips = 0
        self.tick()

    def copy(self) -> World:
        """Return an independent copy of this world, which behaves identically, bit for bit."""
        verbs, servo = self.verbs, self.verbs.servo
        twin = CompiledServo(
            servo.kinematics, servo.collision, servo.options, verbs.model.task.weights
        )
        ctypes.memmove(
            ctypes.addressof(twin._state),
            ctypes.addressof(servo._state),
            ctypes.sizeof(servo._state),
        )
        shared = (
            verbs.model, verbs.planner, servo.kinematics, servo.collision, self.core.lock,
            verbs.planning, verbs.plans.measuring, verbs.options, verbs.capabilities,
            verbs.commanded._sent_as, self.mapping,
        )  # fmt: skip
        memo = {id(each): each for each in shared}
        memo[id(servo)] = twin
        other = copy.deepcopy(self, memo)
        if verbs._pending is not None:
            # A copied function still refers to the original arm: rebind its closure.
            prepare = verbs._pending[1]
            cells = (copy.deepcopy(each.cell_contents, memo) for each in prepare.__closure__)
            rebound = types.FunctionType(
                prepare.__code__,
                prepare.__globals__,
                prepare.__name__,
                prepare.__defaults__,
                tuple(map(types.CellType, cells)),
            )
            other.verbs._pending = other.verbs._pending[0], rebound
        return other

    # -- distinguishable states ------------------------------------------------------------------

    def abstract(self) -> Abstract:
        core, verbs = self.core, self.verbs
        source, watched, motion = core.operator, core.supervision, core.motion
        moves = core.commanded.moving and core.commanded.placed
        quick = moves and norm(core.commanded.twist.linear) > QUICK_M_S
        implausible = ""
        if watched.implausible:
            implausible = "rests" if watched.trustworthy else "rejected"
        verb = ""
        if verbs._pending is not None:
            verb = "waiting"
        elif verbs._motion is not None:
            verb = "running"
        return Abstract(
            self.link,
            not self.hold_reason,
            bool(self.alarm),
            self.offset != 0.0,
            self.pushed,
            self.device.link,
            self.stale,
            self.deflected,
            bool(self.device.buttons),
            self.streaming,
            self.held_off,
            self.filter.broken,
            core.state,
            implausible,
            core.following,
            source._device is not None and bool(source._device.buttons),
            core.authority.owner,
            bool(core.authority._handed_to),
            "" if motion is None else type(motion).__name__,
            "quick" if quick else "slow" if moves else "rest",
            verbs.streams.kind,
            bool(verbs.streams.owner),
            verb,
        )

    @property
    def faults(self) -> int:
        """Number of simultaneous faults."""
        return sum(
            (
                self.link is not RobotLink.LIVE,
                bool(self.hold_reason),
                bool(self.alarm),
                self.offset != 0.0,
                self.pushed,
                self.device.link is not DeviceLink.LIVE,
                self.stale,
                self.held_off,
                self.filter.broken,
            )
        )

    # -- time ------------------------------------------------------------------------------------

    def state(self) -> RobotState:
        joints = self.q.copy()
        joints[0] += self.offset
        return RobotState(
            self.now_s, self.link, self.session, self.sequence, DT_S, tuple(joints.tolist()), (),
            None, self.hold_reason, alarm=self.alarm, velocities=tuple(self.v.tolist()),
        )  # fmt: skip

    def tick(self) -> None:
        self.now_s += DT_S
        self.sequence += 1
        self._steer()
        if not self.stale:
            self.device = self.device._replace(stamp_s=self.now_s)
        events, self.events = self.events, []
        self._watch_operator(events)
        self.command = self.core.tick(self.state(), self.device, events)
        if self.core.commanded.placed and self.start is None:
            self.start = self.core.commanded.pose.position.x
        self._obey()
        self.check()
        if self.verbs._pending is not None:
            self.verbs.start_pending()
        self.heard = False
        if self.streaming:
            self.stream()

    def stream(self) -> str:
        refusal = self.verbs.stream("twist", (self.way * SPEED_M_S, 0, 0, 0, 0, 0), owner=STREAMER)
        self.heard = not refusal
        return refusal

    def _steer(self) -> None:
        """Reverse the motion before it reaches the arm's limits."""
        if self.start is not None:
            beyond = self.core.commanded.pose.position.x - self.start
            if abs(beyond) > SPACE_M:
                self.way = -1.0 if beyond > 0.0 else 1.0
        if self.deflected and not self.stale:
            self.device = self.device._replace(axes=(self.way, 0.0, 0.0, 0.0, 0.0, 0.0))

    def _obey(self) -> None:
        before = self.q
        if self.pushed:
            self.v = np.zeros(len(self.q))
        elif isinstance(self.command, JointCommand) and self.link is RobotLink.LIVE:
            most = PLANT_RAD_S * DT_S
            self.q = before + np.clip(np.array(self.command.positions) - before, -most, most)
            self.v = (self.q - before) / DT_S
        else:
            self.v = np.zeros(len(self.q))

    def settle(self) -> Abstract:
        """Tick until the state no longer changes."""
        found, stays = self.abstract(), 0
        for _ in range(round(SETTLES_S / DT_S)):
            self.tick()
            now = self.abstract()
            stays = stays + 1 if now == found else 0
            found = now
            if stays >= STABLE_TICKS:
                break
        return found

    def wait(self) -> None:
        """Tick until the state changes."""
        found = self.abstract()
        for _ in range(round(WAIT_S / DT_S)):
            self.tick()
            if self.abstract() != found:
                return

    # -- invariants of every tick ----------------------------------------------------------------

    @property
    def driveable(self) -> bool:
        """True without any fault that stops every source."""
        return not (
            self.link is not RobotLink.LIVE or self.hold_reason or self.alarm or self.held_off
        )

    def _watch_operator(self, events: list[ButtonEvent]) -> None:
        """Track, outside of the controller, whether the operator re-armed since the last
        interruption."""
        device, armed = self.device, self.core.armed
        silent = self.deflected and self.now_s - device.stamp_s > 0.1
        wrong = device.link is not DeviceLink.LIVE or self.filter.broken or not self.driveable
        if self.interrupted or wrong or silent:
            self._forget(armed)
        self._note_act(events)

    def _forget(self, armed: bool) -> None:
        """Discard the operator's earlier actions."""
        if armed or self.rearmed:
            self.let_go = False
        self.rearmed = self.interrupted = False

    def _note_act(self, events: list[ButtonEvent]) -> None:
        """Note whether re-arming is now complete."""
        device = self.device
        seen = device.link is DeviceLink.LIVE
        if self.mapping.clutch:
            up = seen and self.let_go
            for event in events:
                if event.pressed and up:
                    self.rearmed = True
                up = seen and not event.pressed
            self.let_go = seen and not device.buttons
        elif not self.mapping.deadman:
            self.rearmed = self.rearmed or (seen and not self.deflected)
        elif not device.buttons:
            self.let_go = self.let_go or (seen and not self.deflected)
        elif self.let_go and seen:
            self.rearmed = True

    def interrupt(self) -> None:
        """Require that the operator re-arms."""
        self.interrupted = True

    def check(self) -> None:
        """Check (a), (c) and (f), from the externally known state."""
        core, commanded, motion = self.core, self.core.commanded, self.core.motion
        assert (motion is None) is (core.state.motion in RESTING), "state and motion differ"
        assert core.rejects is bool(core.supervision.implausible), "rejected for no reason"
        if core.trips != self.trips:
            self.trips = core.trips
            self._forget(True)
            self._note_act([])
        if core.armed:
            assert self.rearmed, "armed without re-arming"
            if core.state.arming is Arming.CLAIMING:
                assert core.authority.owner == OPERATOR, "claimed without authority"
        by_hand = (
            core.armed
            and self.deflected
            and self.driveable
            and not self.filter.broken
            and self.device.link is DeviceLink.LIVE
            and self.now_s - self.device.stamp_s <= 0.1 + DT_S
            and (bool(self.device.buttons) or not self.mapping.deadman)
        )
        by_verb = (
            self.motion is not None and self.motion.outcome is Outcome.RUNNING and self.driveable
        )
        streams = self.verbs.streams
        by_stream = self.heard and self.driveable and core.authority.owner == STREAMER
        assert by_hand + by_verb + by_stream <= 1, "two sources have the authority"
        moving = commanded.placed and commanded.moving and not isinstance(self.command, HoldCommand)
        if isinstance(motion, Recover):
            assert norm(commanded.twist.linear) <= RECOVERS_M_S or not moving
        if by_hand or by_verb or by_stream or self.start is None:
            self.permitted_s = self.now_s
        position = commanded.pose.position if commanded.placed else None
        if by_hand or by_verb or by_stream:
            self.recovered_m = 0.0
        elif moving and core.recovering and self.at is not None:
            self.recovered_m += norm(tuple(a - b for a, b in zip(position, self.at, strict=True)))
            assert self.recovered_m <= RECOVERED_M, "recoveries without a bound"
            self.permitted_s = self.now_s
        self.at = position
        if moving:
            ago_s = self.now_s - self.permitted_s
            assert ago_s <= BRAKES_S, f"moves {ago_s:.2f} s after motion was permitted"
            if not core.braking and not isinstance(motion, (Recover, Brake)):
                owner = core.authority.owner
                if isinstance(motion, FollowOperator):
                    assert owner == OPERATOR or not core.armed
                    assert self.verbs._motion is None
                    assert streams.kind is Stream.NONE
                elif motion is not None:
                    assert owner in (VERBS, STREAMER), f"{motion} moves for {owner!r}"

    # -- actions of operators and programs -------------------------------------------------------

    def hand(self, pressed: bool) -> None:
        if pressed != bool(self.device.buttons):
            self.events.append(ButtonEvent(self.now_s, "left", pressed))
            self.recovered_m = 0.0
        self.device = self.device._replace(buttons=frozenset({"left"} if pressed else ()))

    def deflect(self, deflected: bool) -> None:
        if deflected != self.deflected:
            self.recovered_m = 0.0
        self.deflected = deflected
        self.device = self.device._replace(axes=(self.way if deflected else 0.0, *REST[1:]))

    def movl(self) -> None:
        here = list(self.verbs.stat().pose)
        here[0] = self.start - 0.5 * SPACE_M * (1.0 if here[0] > self.start else -1.0)
        self.motion = self.verbs.movl(here)


Event = Callable[[World], object]
EVENTS: dict[str, tuple[Callable[[World], bool], Event]] = {}
"""Events by name, each with the condition under which it changes anything."""


def event(applies: Callable[[World], bool]) -> Callable[[Event], Event]:
    def recorded_request(function: Event) -> Event:
        EVENTS[function.__name__] = applies, function
        return function

    return recorded_request


def is_well(w: World) -> bool:
    return w.link is RobotLink.LIVE and not w.hold_reason


@event(is_well)
def robot_lost(w):
    w.link = RobotLink.LOST
    w.interrupt()


@event(is_well)
def robot_not_ready(w):
    w.hold_reason = OFF
    w.interrupt()


@event(lambda w: not is_well(w))
def robot_back(w):
    w.link, w.hold_reason = RobotLink.LIVE, ""


@event(lambda w: not w.offset)
def robot_jumps(w):
    w.offset = AWAY_RAD
    if w.driveable:
        w.interrupt()


@event(lambda w: bool(w.offset))
def robot_jumps_back(w):
    w.offset = 0.0
    if w.driveable:
        w.interrupt()


@event(lambda w: True)
def new_session(w):
    w.session += 1
    if is_well(w):
        w.interrupt()


@event(lambda w: not w.alarm)
def alarm(w):
    w.alarm = ALARM


@event(lambda w: bool(w.alarm))
def alarm_ends(w):
    w.alarm = ""


@event(lambda w: True)
def stalls(w):
    w.now_s += 0.2
    if is_well(w):
        w.interrupt()


@event(lambda w: not w.pushed)
def pushed_away(w):
    """An obstacle pushes the robot aside."""
    w.pushed = True
    for _ in range(round(AWAY_RAD / (PLANT_RAD_S * DT_S))):
        w.q = w.q.copy()
        w.q[0] += PLANT_RAD_S * DT_S
        w.tick()


@event(lambda w: w.pushed)
def let_loose(w):
    w.pushed = False


@event(lambda w: w.device.link is DeviceLink.LIVE)
def device_lost(w):
    w.deflect(False)
    w.device = w.device._replace(link=DeviceLink.LOST, reason=UNPLUGGED, buttons=frozenset())


@event(lambda w: w.device.link is not DeviceLink.LIVE)
def device_back(w):
    w.device = w.device._replace(link=DeviceLink.LIVE, reason="")


@event(lambda w: not w.stale and w.device.link is DeviceLink.LIVE)
def device_stale(w):
    w.stale = True


@event(lambda w: w.stale)
def device_fresh(w):
    w.stale = False


def talks(w: World) -> bool:
    return w.device.link is DeviceLink.LIVE and not w.stale


@event(lambda w: talks(w) and not w.deflected)
def deflects(w):
    w.deflect(True)


@event(lambda w: talks(w) and w.deflected)
def rests(w):
    w.deflect(False)


@event(lambda w: talks(w) and not w.device.buttons)
def button_down(w):
    w.hand(True)


@event(lambda w: talks(w) and bool(w.device.buttons))
def button_up(w):
    w.hand(False)


@event(talks)
def button_tapped(w):
    """Edges of a button that appear as events although no state shows them."""
    held = bool(w.device.buttons)
    w.hand(not held)
    w.hand(held)


@event(lambda w: True)
def movl(w):
    w.movl()


@event(lambda w: w.verbs.streams.kind is Stream.NONE)
def chooses_stream(w):
    w.verbs.set_parameter("cpsc", "twst", source=STREAMER)


@event(lambda w: w.verbs.streams.kind is not Stream.NONE)
def chooses_no_stream(w):
    w.verbs.set_parameter("cpsc", "nset", source=STREAMER)


@event(lambda w: not w.streaming)
def streams(w):
    w.streaming = True
    refusal = w.stream()
    if refusal:
        raise MotionRefusedError(refusal)


@event(lambda w: w.streaming)
def falls_silent(w):
    w.streaming = False


@event(lambda w: True)
def hands_over_to_hand(w):
    w.verbs.hand_over(OPERATOR, source=w.core.authority.owner or VERBS)
    w.interrupt()


@event(lambda w: True)
def hands_over_to_stream(w):
    w.verbs.hand_over(STREAMER, source=w.core.authority.owner or VERBS)
    w.interrupt()


@event(lambda w: w.core.authority.owner in (VERBS, STREAMER))
def gives_up(w):
    w.verbs.release(w.core.authority.owner)


@event(lambda w: True)
def stop(w):
    w.verbs.stop()
    w.interrupt()


@event(lambda w: True)
def acknowledge(w):
    w.verbs.acknowledge()
    w.recovered_m = 0.0


@event(lambda w: not w.held_off)
def held_off(w):
    w.held_off = True
    w.core.inhibit(HELD_OFF, Inhibit.WHILE_SAID)


@event(lambda w: w.held_off)
def held_off_no_more(w):
    w.held_off = False
    w.core.inhibit("", Inhibit.WHILE_SAID)


@event(lambda w: not w.filter.broken)
def filter_breaks(w):
    w.filter.broken = True


@event(lambda w: w.filter.broken)
def filter_mended(w):
    w.filter.broken = False


# -- invariants of every state -------------------------------------------------------------------


def commanded(w: World) -> tuple[object, ...]:
    """Return the state that must not change on a refusal."""
    commanded = w.core.commanded
    placed = (commanded.pose, commanded.twist) if commanded.placed else ()
    return (w.abstract()._replace(streaming=False), placed, w.core.plan_epoch)


def play(w: World, name: str) -> str:
    """Apply an event; return its refusal, which must have changed nothing (e)."""
    before = commanded(w)
    try:
        EVENTS[name][1](w)
    except MotionRefusedError as error:
        assert commanded(w) == before, f"{name} was refused and changed something"
        return str(error)
    return ""


def rests_when_left_alone(w: World) -> None:
    """(b): with neutral inputs the arm rests within the braking time, or a recovery's time."""
    w.deflect(False)
    w.hand(False)
    w.streaming = False
    if w.verbs._motion is not None or w.verbs._pending is not None:
        w.verbs.stop()
    rested = 0
    for _ in range(round(3.0 * SETTLES_S / DT_S)):
        w.tick()
        rested = 0 if w.core.commanded.moving or w.core.recovering else rested + 1
        if rested > BRAKES_S / DT_S:
            return
    raise AssertionError("moves although nobody asks for it")


def _rest(w: World) -> None:
    w.deflect(False)


def _press(w: World) -> None:
    if w.device.buttons:
        w.hand(False)
        w.tick()
    w.hand(True)


def _rest_then_press(w: World) -> None:
    w.deflect(False)
    w.hand(False)
    w.tick()
    w.hand(True)


def _move_and_let_go(w: World) -> None:
    w.deflect(True)
    w.tick()
    w.deflect(False)


def _wait(w: World) -> None:
    for _ in range(60):
        w.tick()


def _robot_back(w: World) -> None:
    robot_back(w)


def _free(w: World) -> None:
    w.pushed, w.offset = False, 0.0
    _wait(w)


def _others_let_go(w: World) -> None:
    w.streaming = False
    w.verbs.release(w.core.authority.owner)


def _device_back(w: World) -> None:
    device_back(w)


def _fresh(w: World) -> None:
    w.stale = False


ADVICE: tuple[tuple[str, Callable[[World], bool], Event], ...] = (
    (HELD_OFF, lambda w: w.held_off, EVENTS["held_off_no_more"][1]),
    (ALARM, lambda w: bool(w.alarm), EVENTS["alarm_ends"][1]),
    (BROKEN, lambda w: w.filter.broken, EVENTS["filter_mended"][1]),
    (f"{OFF}|the robot is lost|fell silent", lambda w: not is_well(w), _robot_back),
    (UNPLUGGED, lambda w: w.device.link is not DeviceLink.LIVE, _device_back),
    (r"resynchronizing", lambda w: True, _wait),
)
"""Patterns of messages, each with its condition and the reader's reaction; external conditions come
first."""

ACTS: tuple[tuple[str, Event], ...] = (
    (r"silent for|silent but|is .* s old", _fresh),
    (r"'(verbs|a)' has authority", _others_let_go),
    (r"let go of the device and of 'left', then press 'left'", _rest_then_press),
    (r"let go of the device, then let go of 'left', then press 'left'", _rest_then_press),
    (r"let go of the device, then press 'left'", _rest_then_press),
    (r"let go of 'left', then press", _rest_then_press),
    (r"press 'left'", _press),
    (r"move the device and let it go", _move_and_let_go),
    (r"let go of the device to go on", _rest),
)
"""Actions of the operator."""


def follow_advice(w: World) -> None:
    """Do one action that the message advises."""
    message = w.core.status().message
    said = message.removeprefix(f"stopped before: {w.core._trip_reason}; ")
    w.stale = False  # An operator who acts has a device that reports it.
    for pattern, is_so, act in ADVICE:
        if re.search(pattern, said) and is_so(w):
            act(w)
            return
    if re.search(
        "check what holds the arm|measured position is implausible|something else holds it", message
    ):
        _free(w)
    for pattern, act in ACTS:
        if re.search(pattern, said):
            act(w)
            return
    raise AssertionError(f"no act is named: {said!r}")


def leads_to_motion(w: World) -> int:
    """(d): following the messages and then moving the device moves the arm; return the number of
    actions."""
    said = []
    for acts in range(16):
        message = w.core.status().message
        said.append(message)
        if w.core.armed and not w.core.recovering:
            w.stale = False
            w.deflect(True)
            if w.mapping.deadman:
                w.hand(True)
            for _ in range(round(BRAKES_S / DT_S)):
                w.tick()
                if norm(w.core.commanded.twist.linear) > QUICK_M_S and w.core.following:
                    return acts
            message = w.core.status().message
        if message or not w.core.armed:
            assert message, "no motion, and no message"
            follow_advice(w)
        for _ in range(2):
            w.tick()
    raise AssertionError(f"a dead end: {said[-1]}")


# -- the walk ------------------------------------------------------------------------------------


class Found(NamedTuple):
    """Results of a walk."""

    states: dict[Abstract, tuple[str, ...]]
    """States, each with the shortest sequence of events to it."""
    transitions: int
    refusals: int

    @property
    def deepest(self) -> tuple[str, ...]:
        """Longest of these shortest sequences."""
        return max(self.states.values(), key=len)


class ViolationError(AssertionError):
    """A violated invariant, and the sequence of events to it."""


def way_to(way: tuple[str, ...], mapping: MappingOptions = BY_DEADMAN) -> World:
    """A new world after the events of `way`; a name with "+" ticks until the state has settled."""
    w = World(mapping)
    for each in way:
        take(w, each)
    return w


def take(w: World, step: str) -> str:
    name, settled, _ = step.partition("+")
    refusal = "" if name == "wait" else play(w, name)
    if name == "wait":
        w.wait()
    else:
        w.tick()
    if settled:
        w.settle()
    return refusal


def check_state(w: World) -> None:
    """Check (b) and (d), each on a copy."""
    rests_when_left_alone(w.copy())
    leads_to_motion(w.copy())


def explore(
    mapping: MappingOptions = BY_DEADMAN,
    most_faults: int = 1,
    deepest: int = 1000,
    judge: Callable[[World], object] = check_state,
    reported: Callable[[str, tuple[str, ...]], object] | None = None,
) -> Found:
    """Walk until no new state appears, or to `deepest` events from the start, with at most
    `most_faults` simultaneous faults. `reported` receives violations; without it the first is
    raised."""
    first = World(mapping)
    first.settle()
    states: dict[Abstract, tuple[str, ...]] = {first.abstract(): ()}
    queue = deque([(first, ())])
    transitions = refusals = 0

    def failed(why: str, way: tuple[str, ...]) -> None:
        if reported is None:
            raise ViolationError(f"{why}, after {' '.join(way) or 'nothing'}")
        reported(why, way)

    def reached(w: World, way: tuple[str, ...]) -> bool:
        nonlocal transitions
        transitions += 1
        found = w.abstract()
        if found in states:
            return False
        states[found] = way
        queue.append((w, way))
        return True

    while queue:
        w, way = queue.popleft()
        try:
            judge(w)
        except AssertionError as error:
            failed(str(error), way)
        if len(way) >= deepest:
            continue
        for name, (applies, _) in EVENTS.items():
            if not applies(w):
                continue
            after, step = w.copy(), name
            try:
                refused = take(after, name)
                refusals += bool(refused)
                if after.faults > most_faults:
                    continue
                if reached(after, (*way, name)):
                    after = after.copy()
                step = f"{name}+"
                after.settle()
                reached(after, (*way, step))
            except AssertionError as error:
                failed(str(error), (*way, step))
        try:
            after = w.copy()
            after.wait()
            reached(after, (*way, "wait"))
        except AssertionError as error:
            failed(str(error), (*way, "wait"))
    return Found(states, transitions, refusals)


def main() -> None:
    """Walk with the rule of re-arming, number of faults and number of events from the command line,
    and print the results."""
    act, most_faults, deepest = sys.argv[1:]

    def reported(why: str, way: tuple[str, ...]) -> None:
        print(f"violated: {why}, after {' '.join(way)}", flush=True)

    found = explore(MAPPINGS[act], int(most_faults), int(deepest), reported=reported)
    print(f"states {len(found.states)}, transitions {found.transitions}, refused {found.refusals}")
    print(f"deepest {len(found.deepest)}: {' '.join(found.deepest)}")


if __name__ == "__main__":
    main()
