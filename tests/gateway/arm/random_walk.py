"""Random walk over all actions of robot, device, verbs and streams on a controller.

Every tick is checked against the controller's invariants.
"""

from __future__ import annotations

import contextlib
import math
import random

import numpy as np

from cardan.errors import CardanError
from cardan.gateway.arm.motions.recover import Recover
from cardan.gateway.arm.motions.reference_motion import Brake, FollowOperator
from cardan.gateway.arm.motions.torque import TorqueMotion
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.states import AuthorityOptions, AuthorityPolicy, Inhibit
from cardan.gateway.arm.status import OPERATOR, Phase
from cardan.gateway.arm.verb_methods import ArmVerbs
from cardan.robots import load_arm
from cardan.spatial import is_finite, norm, subtract
from cardan.types import (
    ButtonEvent,
    CommandKind,
    DeviceLink,
    DeviceState,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    PoseCommand,
    RobotCapabilities,
    RobotLink,
    RobotState,
    TorqueCommand,
)

DT_S = 0.004
REST = (0.0,) * 6
QUICK = {"cpts": 0.25, "cpta": 1.0, "cprs": 1.0, "cpra": 4.0, "cpjs": 0.5}
RECOVERY_M_S = 0.05


class Walk:
    """A robot with an arm's model, an operator device, verbs, and streams of three sources."""

    def __init__(self, seed, arm, kind, authority, mapping):
        self.random = random.Random(seed)
        kinds = frozenset({kind, CommandKind.TORQUE})
        self.model = load_arm(arm)
        able = RobotCapabilities(kinds, DT_S, len(self.model.joints), None, 0, 0)
        self.mapping = mapping
        named = "verbs" if authority is AuthorityPolicy.NAMED else ""
        self.verbs = ArmVerbs.alone(
            self.model, able,
            ControllerOptions(authority=AuthorityOptions(policy=authority, named=named)),
            mapping=mapping,
        )  # fmt: skip
        self.core = self.verbs.controller
        self.q = np.array(self.model.home, dtype=float)
        self.v = np.zeros(len(self.q))
        self.offset = np.zeros(len(self.q))
        self.now_s, self.session, self.sequence = 10.0, 1, 0
        self.link, self.hold_reason, self.alarm = RobotLink.LIVE, "", ""
        self.nonsense = None
        self.held = False
        self.period_s = DT_S
        self.device = DeviceState(10.0, DeviceLink.LIVE, REST, frozenset())
        self.fresh = True
        self.events = []
        self.command = HoldCommand()
        self.last = HoldCommand()
        self.last_v = None
        self.placed = False
        for name in ("place", "catch"):
            setattr(self.core.commanded, name, self._noted(getattr(self.core.commanded, name)))
        self.unasked_m = 0.0
        self.believed_at = None
        self.log = []
        self.verbs.set_parameters(QUICK)

    def _noted(self, placing):
        def recorded_request(*of):
            self.placed = True
            placing(*of)

        return recorded_request

    # -- the world ---------------------------------------------------------------------------

    def state(self):
        joints = tuple((self.q + self.offset).tolist())
        if self.nonsense == "nan":
            joints = (math.nan, *joints[1:])
        elif self.nonsense == "few":
            joints = joints[:-1]
        elif self.nonsense == "none":
            joints = ()
        return RobotState(
            self.now_s, self.link, self.session, self.sequence, self.period_s,
            joints, (), None, self.hold_reason, alarm=self.alarm,
            velocities=tuple(self.v.tolist()),
        )  # fmt: skip

    def tick(self, count=1):
        for _ in range(count):
            self.now_s += self.period_s
            self.sequence += 1
            if self.fresh:
                self.device = self.device._replace(stamp_s=self.now_s)
            events, self.events = self.events, []
            rested = self.core.at_rest
            before = self.core.commanded.pose if self.core.commanded.placed else None
            self.last, state = self.command, self.state()
            self.command = self.core.tick(state, self.device, events)
            self._check(rested, before)
            self._obey()

    def _obey(self):
        before, command = self.q.copy(), self.command
        if not self.held:
            if isinstance(command, JointCommand):
                self.q = np.array(command.positions)
            elif isinstance(command, JointVelocityCommand):
                self.q = self.q + np.array(command.velocities) * self.period_s
            elif isinstance(command, PoseCommand):
                self.q = self.verbs.servo.q.copy()
        self.v = (self.q - before) / self.period_s

    # -- invariants --------------------------------------------------------------------------

    def _check(self, rested, before):
        core, command, servo = self.core, self.command, self.verbs.servo
        commanded, motion, bounds = core.commanded, core.motion, servo.kinematics
        numbers = {
            JointCommand: lambda c: (*c.positions, *(c.velocities or ())),
            JointVelocityCommand: lambda c: c.velocities,
            PoseCommand: lambda c: (*c.pose.position, *c.pose.orientation, *c.twist.linear),
            TorqueCommand: lambda c: c.torques,
            HoldCommand: lambda c: (),
        }[type(command)](command)
        assert is_finite(numbers)
        assert np.all(np.abs(servo.v) <= bounds.velocity + 1e-9)
        placed, self.placed = self.placed, False
        if type(command) is type(self.last) and not isinstance(
            command, (HoldCommand, TorqueCommand)
        ):
            if self.last_v is not None and not placed:
                change = np.abs(servo.v - self.last_v)
                assert np.all(change <= bounds.acceleration * self.period_s + 1e-9)
            if isinstance(command, JointCommand) and not placed:
                step = np.abs(np.array(command.positions) - np.array(self.last.positions))
                assert np.all(step <= bounds.velocity * self.period_s + 1e-9)
        self.last_v = servo.v.copy()
        moving = commanded.moving and not isinstance(command, HoldCommand)
        if moving and not core.braking and not isinstance(motion, (Recover, Brake)):
            owner = core.authority.owner
            if isinstance(motion, FollowOperator):
                assert owner == OPERATOR
            elif motion is not None:
                assert owner not in ("", OPERATOR), (motion, owner)
        if isinstance(motion, Recover):
            assert norm(commanded.twist.linear) <= RECOVERY_M_S * 1.02 or isinstance(
                command, HoldCommand
            )
            assert core.phase in (Phase.RECOVERING, Phase.BRAKING)
        if before is not None and isinstance(motion, Recover):
            step_m = norm(subtract(commanded.pose.position, before.position))
            anew = motion.went.linear_m <= 1.01 * step_m + 1e-6
            self.unasked_m = step_m if anew else self.unasked_m + step_m
        assert self.unasked_m <= 1.1 * core.reference.limits.max_lead_m
        if core.supervision.implausible:
            here = servo.q.copy()
            if self.believed_at is None:
                self.believed_at = here
            if not isinstance(command, HoldCommand) and not isinstance(command, TorqueCommand):
                assert np.abs(here - self.believed_at).max() < 0.6
        else:
            self.believed_at = None
        if core.phase in (Phase.DISARMED, Phase.NO_ROBOT):
            assert core.message
        if core.at_rest:
            assert not commanded.moving
            assert not isinstance(command, TorqueCommand)
        if isinstance(motion, TorqueMotion) and isinstance(command, TorqueCommand):
            assert core.authority.owner != OPERATOR

    # -- possible events ---------------------------------------------------------------------

    def step(self):
        what = self.random.choice(EVENTS)
        self.log.append(what.__name__)
        what(self)
        self.tick(self.random.choice((1, 1, 2, 5, 20, 60)))

    def hand(self, axes=None, *buttons):
        pressed = frozenset(buttons)
        for name in pressed - self.device.buttons:
            self.events.append(ButtonEvent(self.now_s, name, True))
        for name in self.device.buttons - pressed:
            self.events.append(ButtonEvent(self.now_s, name, False))
        self.device = self.device._replace(axes=axes or REST, buttons=pressed)

    def act(self):
        """Re-arm as the operator."""
        self.hand()
        self.tick(2)
        if self.mapping.clutch:
            self.hand(REST, self.mapping.clutch, *self.mapping.deadman)
            self.tick(2)
            self.hand(REST, *self.mapping.deadman)
        elif self.mapping.deadman:
            self.hand(REST, *self.mapping.deadman)
        else:
            self.hand((0.5, 0, 0, 0, 0, 0))
            self.tick(2)
            self.hand()
        self.tick(2)

    def heal(self):
        """End all faults."""
        self.link, self.hold_reason, self.alarm, self.nonsense = RobotLink.LIVE, "", "", None
        self.held = False
        self.period_s = DT_S
        self.fresh = True
        self.device = self.device._replace(link=DeviceLink.LIVE, reason="")
        self.core.inhibit("", Inhibit.WHILE_SAID)
        for owner in ("a", "b", "verbs"):
            self.verbs.release(owner)
        self.verbs.stop()
        self.hand()
        self.tick(200)
        self.offset[:] = 0.0
        self.tick(400)

    def lives(self):
        """True if an operator can move the arm after some attempts at re-arming."""
        self.heal()
        for _ in range(40):
            self.act()
            if self.core.armed:
                break
            self.tick(600)
        assert self.core.armed, (self.core.message, self.core.inhibited)
        self.hand((-0.4, 0, 0.3, 0, 0, 0), *self.mapping.deadman)
        start = self.core.commanded.pose.position
        self.tick(100)
        went = norm(subtract(self.core.commanded.pose.position, start))
        assert went > 0.001 or self.core.message, (went, self.core.phase)
        self.hand()
        self.tick(200)


def event(function):
    EVENTS.append(function)
    return function


EVENTS: list = []


@event
def nothing(w):
    pass


@event
def deflect(w):
    axes = tuple(w.random.uniform(-1, 1) for _ in range(6))
    w.hand(axes, *w.device.buttons)


@event
def act(w):
    w.act()


@event
def drive(w):
    w.act()
    w.hand(tuple(w.random.uniform(-1, 1) for _ in range(6)), *w.mapping.deadman)
    w.tick(w.random.choice((10, 50, 100)))


@event
def let_go(w):
    w.hand()


@event
def press_any(w):
    w.hand(w.device.axes, *w.device.buttons, w.random.choice(("left", "right", "clutch")))


@event
def release_any(w):
    w.hand(w.device.axes, *sorted(w.device.buttons)[1:])


@event
def bounce(w):
    for pressed in (True, False, True, False):
        w.events.append(ButtonEvent(w.now_s, w.random.choice(("left", "clutch")), pressed))


@event
def device_link(w):
    link = w.random.choice(list(DeviceLink))
    w.device = w.device._replace(link=link, axes=w.device.axes if w.random.random() < 0.2 else REST)


@event
def device_back(w):
    w.device = w.device._replace(link=DeviceLink.LIVE)


@event
def device_nan(w):
    w.device = w.device._replace(axes=(math.nan,) * 6)


@event
def stale(w):
    w.fresh = not w.fresh


@event
def future(w):
    w.device = w.device._replace(stamp_s=w.now_s + 5.0)


@event
def jump(w):
    w.offset = (
        w.offset
        + w.random.choice((0.0, 0.3, -0.3, 2.0)) * np.eye(len(w.q))[w.random.randrange(len(w.q))]
    )


@event
def jump_back(w):
    w.offset = np.zeros(len(w.q))


@event
def sag(w):
    w.offset = w.offset + 0.02 * np.array([w.random.uniform(-1, 1) for _ in w.q])


@event
def hold(w):
    w.held = not w.held


@event
def push(w):
    w.held = True
    way = np.array([w.random.uniform(-1, 1) for _ in w.q])
    for _ in range(60):
        w.q = w.q + 0.004 * way
        w.tick()


@event
def robot_link(w):
    w.link = w.random.choice(list(RobotLink))


@event
def robot_back(w):
    w.link, w.hold_reason, w.nonsense, w.alarm = RobotLink.LIVE, "", None, ""


@event
def not_ready(w):
    w.hold_reason = "motors are off"


@event
def flicker(w):
    w.nonsense = w.random.choice(("nan", "few", "none"))
    w.tick(w.random.choice((1, 1, 3, 100)))
    w.nonsense = None


@event
def session(w):
    w.session += 1


@event
def alarm(w):
    w.alarm = "" if w.alarm else "the port is flooded"


@event
def stall(w):
    w.now_s += w.random.choice((0.05, 0.2, 0.6, 3.0))


@event
def period(w):
    w.period_s = w.random.choice((DT_S, DT_S, 2 * DT_S, 0.002, 0.01))


@event
def stop(w):
    w.verbs.stop()


@event
def acknowledge(w):
    w.core.acknowledge()


@event
def violation(w):
    w.core.inhibit("the force guard objects", Inhibit.ONCE)


@event
def suspend(w):
    w.core.inhibit("the force is in doubt", Inhibit.MOTION_IGNORED)


@event
def hold_off(w):
    w.core.inhibit(w.random.choice(("", "", "the supervisor is silent")), Inhibit.WHILE_SAID)


@event
def verb(w):
    try:
        here = np.array(w.verbs.stat().pose)
        step = [w.random.uniform(-0.1, 0.1) for _ in range(3)]
        name = w.random.choice(("movl", "movj", "movv", "gcmp", "forc", "relj", "retract"))
        if name == "movv":
            w.verbs.movv([w.random.uniform(-0.2, 0.2) for _ in range(6)])
        elif name == "gcmp":
            w.verbs.gcmp()
        elif name == "forc":
            w.verbs.forc([*(100 * s for s in step), 0, 0, 0])
        elif name == "relj":
            w.verbs.relj([*step, 0, 0, 0])
        elif name == "retract":
            w.verbs.retract(step[0])
        else:
            getattr(w.verbs, name)([*(here[:3] + step), *here[3:]])
    except CardanError:
        pass


@event
def pending(w):
    w.verbs.start_pending()


@event
def choose(w):
    with contextlib.suppress(CardanError):
        w.verbs.set_parameter("cpsc", w.random.choice(("twst", "pose", "jnts", "wrnc", "nset")))


@event
def stream(w):
    owner = w.random.choice(("a", "b", ""))
    way = [w.random.uniform(-0.2, 0.2) for _ in range(6)]
    for _ in range(w.random.choice((1, 10, 40))):
        kind = w.verbs.streams.kind.name
        if kind == "TWIST":
            w.verbs.stream("twist", way, owner=owner)
        elif kind == "JOINT":
            w.verbs.stream("joints", [w.random.uniform(-0.5, 0.5) for _ in w.q], owner=owner)
        elif kind == "WRENCH":
            w.verbs.stream("wrench", [10 * x for x in way], owner=owner)
        elif kind == "POSE":
            w.verbs.stream("jog", [0.02 * x for x in way], owner=owner)
        w.tick()


@event
def hand_over(w):
    with contextlib.suppress(CardanError):
        w.verbs.hand_over(w.random.choice(("a", "b", OPERATOR)))


@event
def give_up(w):
    w.verbs.release(w.random.choice(("a", "b", "verbs")))


@event
def tool(w):
    with contextlib.suppress(CardanError):
        w.verbs.tool([0, 0, w.random.choice((0.0, 0.05, 0.2)), 0, 0, 0])
