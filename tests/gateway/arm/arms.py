"""A robot in virtual time that is exactly at its command, except for injected faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cardan.gateway.arm.options import STREAM_LIMITS, ControllerOptions
from cardan.gateway.arm.status import Phase
from cardan.gateway.arm.verb_methods import ArmVerbs
from cardan.gateway.operator.mapping import MappingOptions
from cardan.robots import load_arm
from cardan.sim_peers.motoros_controller.plant import PLANTS, Plant
from cardan.spatial import from_rotation_vector, multiply, to_rotation_vector
from cardan.types import (
    CommandKind,
    DeviceLink,
    DeviceState,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    Pose,
    PoseCommand,
    RobotCapabilities,
    RobotLink,
    RobotState,
    TorqueCommand,
    Vector3,
)

DT_S = 0.004
PULSES_RAD = 1e7
QUICK = {"cpts": 0.25, "cpta": 1.0, "cprs": 1.0, "cpra": 4.0, "cpjs": 0.5}
GOFA = "gofa_crb15000_5"
REST = (0.0,) * 6
JOINT = frozenset({CommandKind.JOINT, CommandKind.TORQUE})


class World:
    """A controller and an ideal robot, stepped tick by tick, with a check of every joint limit.

    With a `plant` of the simulated Motoman the robot lags behind its commanded joints.
    """

    def __init__(self, arm="ur5", commands=JOINT, options=None, start=None, plant="ideal", **more):
        self.model = load_arm(arm)
        self.capabilities = RobotCapabilities(
            commands, DT_S, len(self.model.joints), None, 0, 0,
            lag_s=0.0 if plant == "ideal" else 0.4,
        )  # fmt: skip
        self.verbs = ArmVerbs.alone(self.model, self.capabilities, options, **more)
        self.q = np.array(self.model.home if start is None else start, dtype=float)
        self.v = np.zeros(len(self.q))
        self.now_s = 10.0
        self.session = 1
        self.sequence = 0
        self.hold_reason = ""
        self.link = RobotLink.LIVE
        self.alarm = ""
        self.sag = np.zeros(len(self.q))
        self.creep_rad_s = np.zeros(len(self.q))
        self.jammed = False
        self.pose: Pose | None = None
        self.plant, self.asked = None, self.q
        if plant != "ideal":
            self.plant = Plant(PLANTS[plant], DT_S, self._pulses())
        self.command = HoldCommand()
        self.commanded_before = None
        self.driven_before = False
        self.sent_before = None
        self.tick()

    def state(self):
        return RobotState(
            self.now_s, self.link, self.session, self.sequence, DT_S,
            tuple((self.q + self.sag).tolist()), (), self.pose, self.hold_reason,
            alarm=self.alarm, velocities=tuple(self.v.tolist()),
        )  # fmt: skip

    def tick(self, count=1):
        for _ in range(count):
            self.now_s += DT_S
            self.sequence += 1
            self.command = self.verbs.controller.tick(self.state())
            self._obey()
            self._watch()

    def _obey(self):
        command = self.command
        before = self.q.copy()
        if self.jammed:
            self.v[:] = 0.0
            return
        if isinstance(command, JointCommand):
            # A servo that sags keeps its offset and does not jump to a new command.
            self.q = np.array(command.positions)
            self.v = np.array(command.velocities)
            self._lag_behind(before)
            return
        elif isinstance(command, JointVelocityCommand):
            asked = self.q if self.plant is None else self.asked
            self.q = asked + (np.array(command.velocities) + self.creep_rad_s) * DT_S
        elif isinstance(command, PoseCommand):
            self.pose = command.pose
            self.q = self.verbs.servo.q.copy()
        if isinstance(command, TorqueCommand):
            self.q, self.sag = self.q + self.sag, np.zeros(len(self.q))
            return
        self.v = (self.q - before) / DT_S
        self._lag_behind(before)

    def _pulses(self):
        return [round(each * PULSES_RAD) for each in self.q]

    def _lag_behind(self, before):
        if self.plant is not None:
            self.asked = self.q
            self.plant.step(self._pulses())
            self.q = np.array(self.plant.measured) / PULSES_RAD
            self.v = (self.q - before) / DT_S

    def _watch(self):
        """Check commanded position, speed and acceleration at every tick."""
        servo = self.verbs.servo
        kinematics = servo.kinematics
        driven = isinstance(self.command, (JointCommand, JointVelocityCommand, PoseCommand))
        assert np.all(np.abs(servo.v) <= kinematics.velocity + 1e-9)
        if driven and self.driven_before:
            change = np.abs(servo.v - self.commanded_before)
            assert np.all(change <= kinematics.acceleration * DT_S + 1e-9)
        if driven:
            assert np.all(servo.q >= kinematics.lower - 1e-6)
            assert np.all(servo.q <= kinematics.upper + 1e-6)
        if isinstance(self.command, JointVelocityCommand):
            sent = np.array(self.command.velocities)
            assert np.all(np.abs(sent) <= kinematics.velocity + 1e-9)
            if self.sent_before is not None:
                change = np.abs(sent - self.sent_before)
                assert np.all(change <= kinematics.acceleration * DT_S + 1e-9)
            self.sent_before = sent
        else:
            self.sent_before = None
        self.commanded_before, self.driven_before = servo.v.copy(), driven

    @property
    def tcp(self):
        """Pose of the TCP at the commanded joints: position, rotation matrix."""
        commanded = isinstance(self.command, JointCommand)
        q = self.verbs.servo.q if commanded else self.q
        placement = self.verbs.servo.kinematics.forward(q)
        return placement.translation.copy(), placement.rotation.copy()

    def six(self):
        """The arm's reported pose as six numbers: commanded if known, else measured."""
        return np.array(self.verbs.stat().pose)

    def moved(self, *step):
        """The reported pose, shifted by x y z in m."""
        return [*(self.six()[:3] + step), *self.six()[3:]]

    def run(self, motion, limit_s=60.0):
        """Tick until the motion has ended."""
        for _ in range(int(limit_s / DT_S)):
            self.verbs.start_pending()
            if motion.over:
                return motion
            self.tick()
        raise AssertionError(f"{motion} is not over after {limit_s} s")

    def rest(self, limit_s=20.0):
        """Tick until the arm is at rest."""
        for _ in range(int(limit_s / DT_S)):
            if self.verbs.at_rest:
                return
            self.tick()
        raise AssertionError("still moving")


class HandWorld(World):
    """A robot with an arm's model, moved by verbs and by an operator device."""

    def __init__(self, arm=GOFA, mapping=None, **more):
        self.device = DeviceState(10.0, DeviceLink.LIVE, REST, frozenset())
        self.events = ()
        super().__init__(arm, mapping=mapping or MappingOptions(deadman=("left",)), **more)

    def tick(self, count=1):
        for _ in range(count):
            self.now_s += DT_S
            self.sequence += 1
            self.device = self.device._replace(stamp_s=self.now_s)
            events, self.events = self.events, ()
            self.command = self.verbs.controller.tick(self.state(), self.device, events)
            self._obey()
            self._watch()

    def hand(self, axes=REST, *buttons):
        self.device = self.device._replace(axes=axes, buttons=frozenset(buttons))
        return self

    def arm_hand(self):
        self.hand().tick()
        self.hand(REST, "left").tick()
        assert self.verbs.controller.phase is Phase.HOLDING


def streams(**limits):
    """Options with the default limits of streams, except these."""
    return ControllerOptions(streams=replace(STREAM_LIMITS, **limits))


def quick(arm=GOFA, **more):
    world = World(arm, **more)
    world.verbs.set_parameters(QUICK)
    return world


def streaming(kind, **more):
    world = quick(**more)
    world.verbs.set_parameter("cpsc", kind)
    return world


def turned(six, rotation):
    """`six`, rotated by the rotation vector `rotation` in base axes."""
    after = multiply(
        from_rotation_vector(Vector3(*rotation)), from_rotation_vector(Vector3(*six[3:]))
    )
    return [*six[:3], *to_rotation_vector(after)]
