"""The ROS 2 arm driver and a simulated arm in virtual time, with a bad network between them."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math

from cardan.drivers.ros2_arm import Ros2Arm
from cardan.drivers.ros2_arm.session import STATE_TYPE
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.sim_peers.arm.plant import ArmPlant
from cardan.sim_peers.link import FaultyLink
from cardan.sim_peers.ros2_arm import RosArm, RosArmOptions
from tests.drivers.bus_device_bench import key_of, message

STEP_S = 0.002
"""Step of the simulated arm."""

KEY = key_of("joint_states", STATE_TYPE)
received = functools.partial(message, key=KEY)


def joint_states(names, position, velocity=(), effort=(), stamp_s=1.0):
    message = default_message(STATE_TYPE)
    stamp_ns = round(stamp_s * 1e9)
    message["header"]["stamp"] = {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}
    message |= {"name": list(names), "position": list(position)}
    message |= {"velocity": list(velocity), "effort": list(effort)}
    return codec_of(STATE_TYPE).encode(message)


class Wire:
    """The driver's transport, with the simulated arm behind it."""

    def __init__(self, faults=None, controller="position", rate_hz=100.0, robot="ur5", **more):
        faults = faults or {}
        self.core = RosArm(
            RosArmOptions(
                faults=faults, controller=controller, rate_hz=rate_hz, robot=robot, **more
            )
        )
        self.period_s = 1.0 / rate_hz
        # Longer steps than the arm's own, for a shorter computation.
        coarse = dataclasses.replace(self.core.options.plant, step_s=min(STEP_S, self.period_s))
        self.core.plant = ArmPlant(self.core.arm, coarse)
        self.to_pc, self.to_robot = FaultyLink(faults, 2), FaultyLink(faults, 3)
        self.now_s = 0.0
        self.sent = []
        self.path = []
        self.ready = []

    def now(self):
        return self.now_s

    def send(self, data):
        self.sent.append((self.now_s, data))
        self.to_robot.push(self.now_s, data)

    def wait(self):
        until_s = self.now_s + 0.1
        while not self.ready and self.now_s < until_s:
            self.pass_cycle()
        return self.waiting()

    def waiting(self):
        found, self.ready = self.ready, []
        return found

    def taken(self):
        return self.core.loaded and self.core.up

    def description(self):
        return self.core.arm.urdf

    def close(self):
        pass

    def pass_cycle(self):
        self.now_s += self.period_s
        for data in self.to_robot.pop(self.now_s):
            self.core.receive(data)
        for state in self.core.cycle(1000.0):
            self.to_pc.push(self.now_s, state)
        for state in self.to_pc.pop(self.now_s):
            self.ready.append(received(state.data, state.sequence, state.sender))
        self.path.append(self.core.plant.positions)

    def run_on(self, seconds):
        """Stop the gateway's process for that time."""
        for _ in range(round(seconds / self.period_s)):
            self.pass_cycle()

    def speeds(self, joint):
        return [(b[joint] - a[joint]) / self.period_s for a, b in itertools.pairwise(self.path)]

    def fastest(self, joint=0):
        """Return the highest speed of a joint, rad/s, as a mean over 50 ms: network delays shift
        commands by a cycle."""
        cycles = max(round(0.05 / self.period_s), 1)
        way = zip(self.path, self.path[cycles:], strict=False)
        return max(abs(b[joint] - a[joint]) for a, b in way) / (cycles * self.period_s)

    def rests(self, for_s=0.3):
        there = self.path[-round(for_s / self.period_s) :]
        return all(max(row) - min(row) < 1e-3 for row in zip(*there, strict=True))


class WiredArm(Ros2Arm):
    def __init__(self, wire, **options):
        options.setdefault("command", wire.core.options.controller)
        options.setdefault("rate_hz", wire.core.options.rate_hz)
        super().__init__(**options)
        self.wire = wire

    def _join(self):
        if self.options.limits is None:
            self._session = type(self._session)(self.options, self._described(self.wire))
        self._session.taken = self.wire.taken
        return self.wire


def follow(robot, until_s, target, stall=(math.inf, 0.0)):
    """Send `target(state, time)` for each state until `until_s`; return the states.

    `stall`: start and duration of a stop of the process.
    """
    states = []
    for state in robot.cycles():
        states.append(state)
        if state.stamp_s >= until_s:
            break
        if state.stamp_s >= stall[0]:
            robot.wire.run_on(stall[1])
            stall = (math.inf, 0.0)
        if state.ready:
            robot.send(target(state, state.stamp_s))
    return states
