"""Sans-I/O arm under ros2_control in the caller's time: states out, commands in.

Written from the controllers' documentation (ros2_controllers: joint_state_broadcaster,
forward_command_controller, joint_trajectory_controller) and JointStateTopicSystem's.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from cardan.protocols.ros2.cdr import MalformedCdr, Message, codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.robots import load_arm
from cardan.sim_peers.base import TimedActions
from cardan.sim_peers.ros2_arm.options import (
    CLOCK_STEP_AT_S,
    FAULTS as FAULTS,
    JAM_AT_S,
    RESTART_S,
    SECOND_HZ,
    SILENCE_EVERY_S,
    RosArmOptions,
)

JOINT_STATE = "sensor_msgs/msg/JointState"
TOPICS: Mapping[str, tuple[str, str]] = {
    "position": ("/forward_position_controller/commands", "std_msgs/msg/Float64MultiArray"),
    "velocity": ("/forward_velocity_controller/commands", "std_msgs/msg/Float64MultiArray"),
    "joint_state": ("/robot_joint_command", JOINT_STATE),
    "trajectory": (
        "/joint_trajectory_controller/joint_trajectory",
        "trajectory_msgs/msg/JointTrajectory",
    ),
}
"""Topic and type of each controller's commands."""

CATCH_UP_S = 0.5
"""Longest time of skipped cycles that is made up for."""
FINGER, FINGER_AT = "finger_joint", 0.01
GRIPPER_SENDER, SECOND_SENDER = 0, 255
"""Publishers in addition to the arm's own."""
NS = 1_000_000_000


class JointStateMessage(NamedTuple):
    """Message published on /joint_states."""

    sender: int
    """Node that publishes it; another one after a restart."""
    sequence: int
    data: bytes


class RosArm:
    """The arm and its controller manager. Times are the caller's, s.

    The broadcaster publishes joints in alphabetical order, not in kinematic.
    """

    def __init__(self, options: RosArmOptions) -> None:
        """Raises ExtraMissingError if the libraries for an arm's model are missing."""
        from cardan.sim_peers.arm.plant import ArmPlant

        self.options = options
        self.arm = load_arm(options.robot)
        self.plant = ArmPlant(self.arm, options.plant)
        self.ignored: Counter[str] = Counter()
        """Commands without effect, by reason."""
        self.taken = 0
        """Commands that had an effect."""
        self.loaded = True
        """True if the controller is loaded."""
        self.up = True
        """True if the nodes run."""
        self.sender = 1
        """Publisher of joint states; incremented at each restart."""
        self._names = [joint.name for joint in self.arm.joints]
        self._codec = codec_of(TOPICS[options.controller][1])
        self._states = codec_of(JOINT_STATE)
        self._cycles = self._sequence = self._gripper_sequence = self._second_sequence = 0
        self._second_s = math.inf
        """Time of the second publisher's next message; infinite without one."""
        self._start_s: float | None = None
        self._random = random.Random(options.seed)
        self._stale: bytes | None = None
        self._stale_on = False
        self._clock_step_s = 0.0
        self._up_again_s = 0.0
        self._points: list[tuple[float, list[float]]] = []
        """Points of the trajectory: simulated time and joint positions."""
        self._from: tuple[float, list[float]] = (0.0, [])
        faults = options.faults
        self._renamed = self._lacking = False
        others = []
        if "clock-step" in faults:
            others.append((CLOCK_STEP_AT_S, self._step_clock))
        if "jam" in faults:
            others.append((JAM_AT_S, self._jam))
        self._actions = TimedActions(
            faults,
            {
                "restart": self.go_down,
                "stale": self._freeze,
                "wrong-names": self._rename,
                "missing": self._drop_joint,
                "inactive": self.unload,
                "second-publisher": self.second,
            },
            *others,
        )

    # -- faults ---------------------------------------------------------------------------------

    def go_down(self) -> None:
        """End the nodes; they restart after RESTART_S. The arm stands."""
        self.plant.hold()
        self._points = []
        self.up = False
        self._up_again_s = self.plant.time_s + RESTART_S

    def _come_up(self) -> None:
        self.up = True
        self.sender += 1
        self._sequence = 0

    def _freeze(self) -> None:
        self._stale_on = True

    def _rename(self) -> None:
        self._renamed = True

    def _drop_joint(self) -> None:
        self._lacking = True

    def unload(self) -> None:
        """Unload the controller; the arm stands."""
        self._points = []
        self.loaded = False
        self.plant.hold()

    def second(self) -> None:
        """Start another node's publications of the arm's joints, as zeros."""
        self._second_s = 0.0

    def _step_clock(self) -> None:
        self._clock_step_s = self.options.faults["clock-step"]

    def _jam(self) -> None:
        self.plant.jammed = int(self.options.faults["jam"]) - 1

    # -- commands -------------------------------------------------------------------------------

    def receive(self, data: bytes) -> None:
        """Handle a message on the controller's topic."""
        if not (self.up and self.loaded):
            self.ignored["no controller"] += 1
            return
        message = self._codec.decode(data)
        reason = message.reason if isinstance(message, MalformedCdr) else self._obey(message)
        if reason:
            self.ignored[reason] += 1
        else:
            self.taken += 1

    def _obey(self, message: Message) -> str:
        """Execute a message; return why it is refused, empty if it is executed."""
        kind = self.options.controller
        if kind in ("position", "velocity"):
            return self._forward(message["data"])
        if kind == "trajectory":
            return self._begin_trajectory(message)
        return self._take_joint_state(message)

    def _forward(self, values: Sequence[float]) -> str:
        """Execute any numbers at once, as a forward_command_controller does."""
        if len(values) != self.plant.joints:
            return f"{len(values)} values for {self.plant.joints} joints"
        if not all(map(math.isfinite, values)):
            return "not finite"
        if self.options.controller == "velocity":
            self.plant.command_speeds(values)
        else:
            self.plant.command_positions(values)
        return ""

    def _ordered(self, names: Sequence[str], values: Sequence[float]) -> list[float] | None:
        if sorted(names) != sorted(self._names) or len(values) != len(names):
            return None
        return [values[names.index(name)] for name in self._names]

    def _take_joint_state(self, message: Message) -> str:
        positions = self._ordered(message["name"], message["position"])
        if positions is None or not all(map(math.isfinite, positions)):
            return "names or positions that do not match the joints"
        speeds = self._ordered(message["name"], message["velocity"])
        if speeds is not None and not all(map(math.isfinite, speeds)):
            return "speeds that are not finite"
        self.plant.command_positions(positions, speeds)
        return ""

    def _begin_trajectory(self, message: Message) -> str:
        """Start a trajectory in place of the previous one, from the present motion."""
        points = []
        last_s = 0.0
        for point in message["points"]:
            positions = self._ordered(message["joint_names"], point["positions"])
            if positions is None or not all(map(math.isfinite, positions)):
                return "names or positions that do not match the joints"
            duration = point["time_from_start"]
            at_s = duration["sec"] + duration["nanosec"] / NS
            if at_s <= last_s:
                return "times that do not increase"
            if any(point["velocities"]) and point is message["points"][-1]:
                return "a speed at the end"
            last_s = at_s
            points.append((self.plant.time_s + at_s, positions))
        if not points:
            return "no points"
        self._from = self.plant.time_s, self._wanted(self.plant.time_s)
        self._points = points
        return ""

    def _wanted(self, at_s: float) -> list[float]:
        """Return the joints of the trajectory, on straight lines between points without speeds."""
        if not self._points:
            return list(self.plant.positions)
        from_s, from_ = self._from
        for to_s, to in self._points:
            if at_s < to_s:
                share = (at_s - from_s) / (to_s - from_s)
                return [a + (b - a) * share for a, b in zip(from_, to, strict=True)]
            from_s, from_ = to_s, to
        return from_

    # -- cycles ---------------------------------------------------------------------------------

    def cycle(self, now_s: float, missed: int = 0) -> list[JointStateMessage]:
        """Run a cycle of the controller manager; return the messages to publish.

        `missed`: cycles skipped before it, in which the arm and its clock advanced, for CATCH_UP_S
        at most. Beyond that the whole process was paused, and they with it.
        """
        self._cycles += 1 + min(missed, round(CATCH_UP_S / self.options.period_s))
        time_s = self._cycles * self.options.period_s
        if self._start_s is None:
            self._start_s = now_s - time_s
        if self._points:
            self.plant.command_positions(self._wanted(time_s))
        self.plant.advance(time_s)
        for _, action in self._actions.due(time_s):
            action()
        return [*self._own(time_s), *self._of_second(time_s)]

    def _of_second(self, time_s: float) -> list[JointStateMessage]:
        if time_s < self._second_s:
            return []
        self._second_s = time_s + 1.0 / SECOND_HZ
        self._second_sequence += 1
        message = default_message(JOINT_STATE) | {
            "header": self._header(time_s),
            "name": self._names,
            "position": [0.0] * len(self._names),
        }
        return [
            JointStateMessage(SECOND_SENDER, self._second_sequence, self._states.encode(message))
        ]

    def _own(self, time_s: float) -> list[JointStateMessage]:
        if not self.up:
            if time_s < self._up_again_s:
                return []
            self._come_up()
        silence_s = self.options.faults.get("silence", 0.0)
        if time_s >= SILENCE_EVERY_S and time_s % SILENCE_EVERY_S < silence_s:
            return []
        self._sequence += 1
        if self._stale is None or not self._stale_on:
            self._stale = self._states.encode(self._message(time_s))
        found = [JointStateMessage(self.sender, self._sequence, self._stale)]
        if "gripper" in self.options.faults:
            self._gripper_sequence += 1
            gripper = default_message(JOINT_STATE) | {"name": [FINGER], "position": [FINGER_AT]}
            found.append(
                JointStateMessage(
                    GRIPPER_SENDER, self._gripper_sequence, self._states.encode(gripper)
                )
            )
        return found

    def _header(self, time_s: float) -> Message:
        """Return a header stamped by the clock of the arm's computer."""
        header: Message = default_message(JOINT_STATE)["header"]
        if "no-stamps" not in self.options.faults:
            stamp_s = (self._start_s or 0.0) + time_s + self._clock_step_s
            stamp_ns = max(round(stamp_s * NS), 1)
            header["stamp"] = {"sec": stamp_ns // NS, "nanosec": stamp_ns % NS}
        return header

    def _message(self, time_s: float) -> Message:
        faults, chance = self.options.faults, self._random.random
        values = {
            name: list(row)
            for name, *row in zip(
                self._names,
                self.plant.positions,
                self.plant.velocities,
                self.plant.torques,
                strict=True,
            )
        }
        if chance() < faults.get("nan", 0.0):
            values[self._names[0]][0] = float("nan")
        if chance() < faults.get("absurd", 0.0):
            values[self._names[-1]][0] = 1e9
        if self._lacking:
            del values[self._names[-1]]
        if "extra" in faults:
            values[FINGER] = [FINGER_AT, 0.0, 0.0]
        names = sorted(values)
        message = default_message(JOINT_STATE)
        message["header"] = self._header(time_s)
        message["name"] = [f"other_{name}" for name in names] if self._renamed else names
        for index, key in enumerate(("position", "velocity", "effort")):
            message[key] = [values[name][index] for name in names]
        return message
