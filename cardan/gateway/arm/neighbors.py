"""A neighboring arm that moves by itself: its bodies, and its known state.

No I/O: time comes in as an argument. Monotonic time of this computer in s, times since the epoch,
which messages have in their stamps, in ns.

A neighbor may have moved since its newest joint states. Each of its bodies is therefore kept
farther away than an obstacle at rest, by the distance that it may move until this arm moves next,
and by its braking distance: u·t + u²/(2·a). u is the speed of the body's fastest point, plus the
a·t that it may gain; t is the age of the state and a cycle; a is the deceleration that a servo
expects of approaching bodies. Even a body at rest is kept some mm farther away than an obstacle.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from cardan.common.arm_libraries import np, pin
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import SE3, FloatArray, short_way, to_se3
from cardan.gateway.kinematics.collision import hull_of, reach_of
from cardan.gateway.servo.bounds import JointBounds
from cardan.gateway.servo.options import ServoOptions
from cardan.gateway.servo.servo import closing_deceleration
from cardan.robots import ArmModel
from cardan.types import IDENTITY_POSE, NEVER_S, Pose

NS = 1_000_000_000

CLOCKS_S = 0.01
"""Largest difference between the clocks of two computers: every state counts as older by that, and
one from farther ahead is rejected. NTP keeps them nearer on one network."""

OUTSIDE_RANGE = 0.1
"""Largest distance of a joint outside its range, rad or m: beyond, the value is another joint's, or
in other units."""

FASTEST = 1e3
"""Largest plausible joint speed, rad/s or m/s."""

FARTHEST_M = 1e3
"""Largest distance at which a body is kept away."""


class NeighborBodies:
    """Places of another arm's bodies, in the base of this one."""

    def __init__(
        self,
        name: str,
        model: ArmModel,
        base: Pose = IDENTITY_POSE,
        acceleration_share: float = 1.0,
        *,
        one_robot: bool = False,
    ) -> None:
        """`base`: the neighbor's base in this arm's. `acceleration_share`: share of its joints'
        accelerations that it may use. `one_robot`: both are arms of one robot, and bodies that do
        not move with the neighbor's joints already belong to this arm.
        """
        self.name, self.model = name, model
        self._kinematics = arm = ArmKinematics(model)
        self.names = model.joint_names
        shapes = [each for each in model.shapes if each.body > 0 or not one_robot]
        self.shapes = tuple(each._replace(name=self.label(each.name)) for each in shapes)
        """Shapes of its bodies, each in the frame of its body."""
        self.base = base
        """Pose of the neighbor's base in this arm's base frame."""
        self._base = to_se3(base)
        self._reach = reach_of(model, self.shapes)
        self._moves = (self._reach > 0.0).any(axis=0)
        hulls = [hull_of(each.shape) for each in self.shapes]
        counts = [len(points) for points, _ in hulls]
        self._points = np.array([point for points, _ in hulls for point in points])
        self._point_bodies = np.repeat([each.body for each in self.shapes], counts)
        self._around_m = np.repeat([radius_m for _, radius_m in hulls], counts)
        self._first_points = np.cumsum([0, *counts[:-1]])
        options = ServoOptions(acceleration_share=acceleration_share)
        bounds = JointBounds(arm, options.speed_share, options.acceleration_share)
        self._deceleration_m_s2 = closing_deceleration(options, bounds)
        self.lower, self.upper = arm.lower, arm.upper
        self.velocity, self.continuous = arm.velocity, arm.continuous

    def label(self, shape: str) -> str:
        """Return the name of a body of its model for messages."""
        return f"{self.name}'s {shape}"

    def frames(self, joints: Sequence[float]) -> list[SE3]:
        """Return the frame of the body of each of `shapes`, in this arm's base."""
        self._kinematics.update(np.array(joints))
        placed = self._kinematics._data.oMi
        bodies = [self._base * placed[body] for body in range(len(joints) + 1)]
        return [bodies[shape.body] for shape in self.shapes]

    @property
    def fastest_m_s(self) -> FloatArray:
        """Upper bound of the speed of any point of each of `shapes`."""
        fastest: FloatArray = self.velocity.dot(self._reach)
        return fastest

    def speeds_m_s(self, joints: FloatArray, velocities: FloatArray) -> FloatArray:
        """Speed of the fastest point of each of `shapes`."""
        kinematics = self._kinematics
        pin.forwardKinematics(kinematics.model, kinematics._spare, joints, velocities)
        motions = np.array([motion.vector for motion in kinematics._spare.v])[self._point_bodies]
        linear, angular = motions[:, :3], motions[:, 3:]
        speeds = np.linalg.norm(linear + np.cross(angular, self._points), axis=1)
        speeds += np.linalg.norm(angular, axis=1) * self._around_m
        found: FloatArray = np.maximum.reduceat(speeds, self._first_points)
        return found

    def gained_m_s(self, time_s: float) -> FloatArray:
        """Speed that the fastest point of each of `shapes` may gain in `time_s`."""
        found: FloatArray = np.multiply(self._deceleration_m_s2 * time_s, self._moves)
        return found

    def ways_m(self, speeds_m_s: FloatArray, time_s: float) -> list[float]:
        """Return the distance that each of `shapes` may move in `time_s` at its speed, plus its
        braking distance."""
        deceleration_m_s2 = self._deceleration_m_s2
        speeds = speeds_m_s + self.gained_m_s(time_s)
        way = speeds * time_s + speeds * speeds / (2.0 * deceleration_m_s2)
        found: list[float] = np.minimum(way, FARTHEST_M).tolist()
        return found


class NeighborWatch:
    """Plausibility check of a neighbor's joint states, with their speeds and ages."""

    def __init__(self, bodies: NeighborBodies, topic: str, max_age_s: float) -> None:
        """`max_age_s`: with an older state this arm must not be moved."""
        self.bodies, self._max_age_s = bodies, max_age_s
        self._who, self.topic = f"the neighbor {bodies.name}", topic
        self._names = bodies.names
        self._order: tuple[tuple[str, ...], tuple[int, ...]] = (), ()
        self.joints: tuple[float, ...] = bodies.model.home
        """Joints of the newest state; home before the first."""
        self.speeds_m_s = bodies.fastest_m_s
        """Speeds of its bodies; their upper bounds while only a single state is known."""
        self.refused: Counter[str] = Counter()
        """Counts of rejected messages, by the reason."""
        self._problem = ""
        """Reason for rejecting the newest message; empty if it was accepted."""
        self._stamp_ns = 0
        self._state_s = self._second_s = NEVER_S
        self._sender = b""
        """Sender of the newest state."""

    def age_s(self, now_s: float) -> float:
        """Largest possible age of the known state; infinite before the first one."""
        return now_s - self._state_s

    def refuse(self, reason: str, details: str = "") -> None:
        """Reject a message; count its `reason`."""
        self.refused[reason] += 1
        self._problem = f"{reason}{details}"

    def take(
        self,
        names: Sequence[str],
        positions: Sequence[float],
        velocities: Sequence[float],
        stamp_ns: int,
        now_s: float,
        now_ns: int,
        sender: bytes = b"",
    ) -> None:
        """Take the neighbor's joint states, which may include further joints; `velocities` may be
        empty. `sender`: their publisher; empty if unknown. With two publishers at a time both are
        rejected."""
        found = self._order_of(tuple(names))
        if found is None:
            return
        if sender and self._sender not in (b"", sender) and self.age_s(now_s) <= self._max_age_s:
            self._second_s = now_s
            self.refuse("joint states of a second publisher")
            return
        if len(positions) != len(names) or len(velocities) not in (0, len(names)):
            self.refuse("joint states with other numbers of values than of joints")
            return
        joints = np.array([positions[index] for index in found])
        reported = np.array([velocities[index] for index in found] if velocities else 0.0)
        if not (np.isfinite(joints).all() and np.isfinite(reported).all()):
            self.refuse("joint states that are not numbers")
            return
        if np.abs(reported).max() > FASTEST:
            self.refuse("joint states with speeds that no joint has")
            return
        bodies = self.bodies
        outside = np.maximum(bodies.lower - joints, joints - bodies.upper)
        if (worst := int(np.argmax(outside))) >= 0 and outside[worst] > OUTSIDE_RANGE:
            self.refuse(
                "joint states outside the joints' ranges",
                f": {self._names[worst]} at {joints[worst]:.4g}; check that its `model` is that "
                "arm's, and the units",
            )
            return
        late_s = (now_ns - stamp_ns) / NS
        if late_s < -CLOCKS_S:
            self.refuse(
                "joint states from the future",
                f": by {-late_s:.3g} s; synchronize the clocks of the computers (NTP)",
            )
            return
        if late_s + CLOCKS_S > self._max_age_s:
            self.refuse(
                "joint states that are old",
                f": their stamp is {late_s:.3g} s old; let it stamp them, and synchronize the "
                "clocks of the computers (NTP)",
            )
            return
        known = self.age_s(now_s) <= self._max_age_s
        if known and stamp_ns <= self._stamp_ns:
            self.refuse("joint states with the stamp of earlier ones")
            return
        if known:
            way = short_way(joints - np.array(self.joints), bodies.continuous)
            since_s = (stamp_ns - self._stamp_ns) / NS
            self.speeds_m_s = bodies.speeds_m_s(joints, way / since_s)
            if velocities:
                self.speeds_m_s = np.maximum(self.speeds_m_s, bodies.speeds_m_s(joints, reported))
            else:
                # This is the speed halfway between the two states.
                self.speeds_m_s += bodies.gained_m_s(0.5 * since_s)
        else:
            self.speeds_m_s = bodies.fastest_m_s
        self.joints = tuple(joints.tolist())
        self._stamp_ns, self._problem, self._sender = stamp_ns, "", sender
        self._state_s = now_s - max(0.0, late_s) - CLOCKS_S

    def _order_of(self, names: tuple[str, ...]) -> tuple[int, ...] | None:
        """Return the places of its joints in `names`; None: refused."""
        if names == self._order[0]:
            return self._order[1]
        missing = [each for each in self._names if each not in names]
        if len(missing) == len(self._names):
            self.refuse("joint states of other joints")
            return None
        if missing:
            self.refuse("joint states without some of its joints", f": {', '.join(missing)}")
            return None
        if len(set(names)) < len(names):
            self.refuse("joint states with a joint twice")
            return None
        self._order = names, tuple(map(names.index, self._names))
        return self._order[1]

    def fault(self, now_s: float) -> str:
        """Return why this arm must not be moved, with advice; empty while the neighbor is known."""
        age_s = self.age_s(now_s)
        if age_s <= self._max_age_s:
            if now_s - self._second_s > self._max_age_s:
                return ""
            return (
                f"two nodes publish joint states of {self._who} on {self.topic}: stop one of them "
                "(`cardan net list` lists the nodes)"
            )
        what = f"nothing was received from {self._who} yet"
        if age_s < math.inf:
            what = f"the position of {self._who} was last known {age_s:.1f} s ago"
        if self._problem:
            return f"{what}: {self.topic} has {self._problem}"
        return f"{what}: start what publishes its joint states on {self.topic}"
