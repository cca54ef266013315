"""The control tick: from the goal of the TCP to the motion of every joint in the next period.

Unknowns are the joint velocities v and the path speed s. Each tick solves

    min  ½‖W(J·v - feedback - s·feed-forward)‖² + ½λ‖v‖² + ½μ‖N(v - posture)‖² + ½ρ(1 - s)²
    s.t. bounds on v that hold speed, acceleration and range (hard), 0 <= s <= 1,
         closing speed of every near pair of bodies (soft)

in TCP axes. The loop is closed on the commanded joint positions, not on the measured ones: gravity
sag and servo error cannot creep into the path (Łukawski, Victores and Balaguer 2023, section 4). By
s an arm that cannot keep up slows along its path instead of leaving it; while it slides, each part
of the twist has an s of its own. Damping by the smallest singular value follows Nakamura and
Hanafusa 1986 (doi:10.1115/1.3143764), dampers between bodies Faverjon and Tournassoud 1987
(doi:10.1109/ROBOT.1987.1087982).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from cardan.common.arm_libraries import daqp, eigenpy, np, pin
from cardan.common.braking import stopping_speed
from cardan.gateway.kinematics.base import SE3, FloatArray, Kinematics, to_pose, to_se3
from cardan.gateway.kinematics.collision import Closest, CollisionModel
from cardan.gateway.servo.bounds import JointBounds
from cardan.gateway.servo.options import Policy, ServoOptions
from cardan.gateway.servo.response_lag import ResponseLag, farthest
from cardan.gateway.servo.status import SLOWED, ServoStatus
from cardan.robots import SixWeights
from cardan.spatial import moved
from cardan.types import Pose, Vector3

TwistParts = FloatArray | tuple[Vector3, Vector3]
"""Linear and angular velocity, 2×3."""

UNBOUNDED = 1e30
"""daqp's infinity."""

SOFT = 8
"""daqp's mark of a constraint that may be violated rather than leave no solution."""

MAX_PARTS = 3
"""Parts of a twist that slides, each with a path speed of its own."""

MAX_ROWS = 16
"""Largest number of closing pairs in one program, the most urgent first: more cannot act on nine
joints."""

CLOSING_LEVER_M = 0.13
"""Lever that converts a revolute joint's acceleration to a deceleration of the bodies it moves:
shorter than those that move a TCP fast."""

AT_REST = 1e-5
"""Speed, rad/s or m/s, that counts as rest: the tail of an exponential approach, which no drive
resolves. Also the pace below which no motion is requested."""

POSTURE_FULL_AT_M_S = 0.02
"""Length-weighed speed of the TCP from which the posture has its full gain."""

TIGHT_M_S = 1e-4
"""Difference of a closing speed to its limit below which it ends the motion."""

LONGEST_SERVO_STEP_S = 0.005
"""Longest step of the servo; a longer tick is divided. Near a singularity the servo is only as good
as its linear model: at 20 ms a GP8 with a stretched elbow would oscillate by 30 mm for ever."""

OFF_LINE_M, OFF_LINE_RAD = 0.005, math.radians(2.0)
"""Error at which Policy.PATH gives up its pace rather than more of its line."""

LEAST_STIFFNESS = 1e-3
"""Least share of the price of slowing, so that an error that can be removed freely does not stop an
arm."""

SWEEPS = 10
"""Most projections onto each pair in the way; a motion into narrow corners beyond them is
slowed."""

AT_END = 1e-3
"""Distance to an end of a joint's range, rad or m, within which the joint is not relied on."""

FREE_DIRECTION = 1e-9
"""Regularization of projections onto an arm's possible motions; far below any real direction."""


def _closing_with(bounds: JointBounds) -> FloatArray:
    """Return the deceleration, m/s², with which each joint brakes its bodies."""
    found: FloatArray = np.where(bounds.prismatic, 1.0, CLOSING_LEVER_M) * bounds.acceleration
    return found


def closing_deceleration(options: ServoOptions, bounds: JointBounds) -> float:
    """Return the deceleration, m/s², expected of bodies that close in, for any joint that moves
    them."""
    return min(options.closing_deceleration_m_s2, float(_closing_with(bounds).min()))


def closing_decelerations(
    options: ServoOptions, bounds: JointBounds, collision: CollisionModel
) -> FloatArray:
    """Return the deceleration of each pair, m/s²: that of the joints between its bodies."""
    able = np.where(collision.sweeps > 0.0, _closing_with(bounds), math.inf)
    lowest: FloatArray = able.min(axis=1, initial=options.closing_deceleration_m_s2)
    return lowest


def safety_distances(options: ServoOptions, collision: CollisionModel) -> list[float]:
    """Return the least distance between the bodies of each pair, m."""
    clearance_m: list[float] = np.where(
        collision.with_obstacle, options.safety_distance_m, options.self_distance_m
    ).tolist()
    return clearance_m


class Servo:
    """Commanded joint positions `q` and velocities `v`, moved one period at a time."""

    def __init__(
        self,
        kinematics: Kinematics,
        collision: CollisionModel | None = None,
        options: ServoOptions | None = None,
        weights: SixWeights = (1.0,) * 6,
    ) -> None:
        """`weights` of x y z rx ry rz along TCP axes; 0 leaves a direction free."""
        self.not_compiled = ""
        """Reason why this servo runs and not the compiled one; empty if it was chosen
        explicitly."""
        self.kinematics = kinematics
        self.collision = collision
        self.options = options = options or ServoOptions()
        n = self.joints = kinematics.joints
        self.q: FloatArray = np.zeros(n)
        """Commanded joint positions, rad or m."""
        self.v: FloatArray = np.zeros(n)
        """Commanded joint velocities, rad/s or m/s."""
        self._continuous: list[bool] = kinematics.continuous.tolist()
        self.keep_past(0.0)
        self._moves: bool | None = None
        """True if `v` is a motion; None: not checked since it changed."""
        self.posture: FloatArray | None = None
        """Preferred joint positions for the task's free directions; None: none. A continuous joint
        has no preference beyond half a turn: its counted turns are not unwound."""
        self._half_turns = np.where(np.isfinite(kinematics.lower), math.inf, math.pi)
        self.policy = options.policy
        self.twist: FloatArray = np.zeros((2, 3))
        """Motion of the reference in this period: linear, angular; base axes."""
        self.path_speed = 1.0
        self.reachable: Pose | None = None
        """The goal of the last tick without the directions that the arm lacks joints for, whose
        error would otherwise accumulate and appear in others; None for arms with all directions."""
        length = options.length_m
        self._weights = np.array(weights) * (1.0, 1.0, 1.0, length, length, length)
        self._column_weights = self._weights[:, None]
        # Priorities among directions must not make an arm look singular.
        self._equal_weights = len({w for w in weights if w}) == 1 and max(weights) == 1.0
        self._scales = (self._weights != 0.0) * np.array((1.0, 1.0, 1.0, length, length, length))
        rank = min(int(np.count_nonzero(self._weights)), n)
        self.projects = rank < 6
        """True if the arm lacks joints for some directions."""
        self._smallest = n - rank
        self._singular = eigenpy.SelfAdjointEigenSolver(n)
        self._solver = eigenpy.LLT(n)
        self._task = np.zeros((6, n + 1))
        self._task_of_joints, self._task_of_path = self._task[:, :n], self._task[:, n]
        self._normal = np.zeros((n + 1, n + 1))
        self._diagonal = np.einsum("ii->i", self._normal)
        self._joint_block = self._normal[:n, :n]
        self._linear = np.zeros(n + 1)
        self._feedback = np.zeros(6)
        self._wanted = np.zeros(6)
        self._own_axes = self._wanted.reshape(2, 3)
        self._rows = np.zeros((MAX_ROWS, n + 1))
        self._rows_of_joints = self._rows[:, :n]
        self._gradients = np.zeros((0 if collision is None else len(collision.pairs), n))
        self._highest = np.full(n + 1 + MAX_ROWS, UNBOUNDED)
        self._lowest = np.zeros(n + 1 + MAX_ROWS)
        self._sense = np.zeros(n + MAX_PARTS + MAX_ROWS, dtype=np.int32)
        self._sense[n + MAX_PARTS :] = SOFT
        self._sigma = math.inf
        self._lambda = 0.0
        self._error_m = self._error_rad = 0.0
        self._unreachable = (0.0, 0.0)
        # For errors this small the gain alone counts: slow, and far from overshooting.
        gain = options.gain_1_s
        self._small_m = min(
            0.5 * options.linear_deceleration_m_s2 / gain**2, options.linear_speed_m_s / gain
        )
        self._small_rad = min(
            0.5 * options.angular_deceleration_rad_s2 / gain**2, options.angular_speed_rad_s / gain
        )
        self._active = 0
        self._ending = self._held = False
        self._nearest_m = math.inf
        self._failures = 0
        self._iterations = 0
        self.bounds = JointBounds(self.kinematics, options.speed_share, options.acceleration_share)
        self._closing_m_s2 = np.zeros(0)
        if collision is not None:
            self._closing_m_s2 = closing_decelerations(options, self.bounds, collision)
            self._slowest_m_s2 = self._closing_m_s2.min(initial=math.inf)
        self._safety = [] if collision is None else safety_distances(options, collision)

    def move(self, first: int, frames: Sequence[SE3], grown_m: Sequence[float]) -> None:
        """Move bodies as CollisionModel.move does, between two ticks."""
        if self.collision is not None:
            self.collision.move(first, frames, grown_m)

    def place(self, q: FloatArray) -> None:
        """Start from the joint positions `q`, at rest. Only while nothing is commanded."""
        self.q = np.array(q, dtype=float)
        self.v = np.zeros(self.joints)
        self._moves = None
        self.kinematics.update(self.q)
        self.path_speed = 1.0
        self._error_m = self._error_rad = 0.0
        self._held = False
        self._active = 0
        if self.collision is not None:
            self.collision.update()

    @property
    def placement(self) -> SE3:
        """Commanded TCP in the base."""
        return self.kinematics.forward(self.q)

    @property
    def pose(self) -> Pose:
        """Commanded TCP in the base."""
        return to_pose(self.placement)

    def pose_at(self, q: Sequence[float]) -> Pose:
        """Return the TCP in the base for the joint positions `q`."""
        return to_pose(self.kinematics.forward(np.array(q)))

    def keep_past(self, lag_s: float) -> None:
        """Set `lag_s`, the robot's normal delay behind its commands; earlier commands are
        forgotten."""
        self._lag = ResponseLag(lag_s, self.kinematics.continuous)

    def moved(self, pose: Pose, dt_s: float) -> Pose:
        """Return `pose` after `dt_s` at `twist`."""
        linear, angular = self.twist.tolist()
        return moved(pose, Vector3(*linear), Vector3(*angular), dt_s)

    def targets(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the commanded joints and their velocities."""
        return tuple(self.q.tolist()), tuple(self.v.tolist())

    def record_command(self, stamp_s: float) -> None:
        """Take the present commanded joints for those of the time `stamp_s`."""
        self._lag.record_command(self.q, stamp_s)

    def measure(self, joints: Sequence[float]) -> tuple[Pose, float, int]:
        """Return the TCP of a robot measured at `joints`, base frame, the distance of the joint
        farthest from its command, rad or m, and its index; all of them for the robot once it has
        caught up."""
        commanded = self.q.tolist()
        joints = self._lag.expected(joints, commanded)
        return self.pose_at(joints), *farthest(commanded, joints, self._continuous)

    def expected(self, joints: Sequence[float]) -> FloatArray:
        """Return the joint positions, once it has caught up, of a robot measured at `joints`."""
        return np.array(self._lag.expected(joints, self.q.tolist()))

    @property
    def motion(self) -> FloatArray:
        """Linear and angular velocity of the TCP at `v`, 2×3, base axes, by the Jacobian of the
        last tick or placement."""
        kinematics = self.kinematics
        lines = (kinematics.jacobian @ self.v).reshape(2, 3)
        found: FloatArray = lines @ kinematics.placement.rotation.T
        return found

    @property
    def moving(self) -> bool:
        """True until all joints are at rest."""
        if self._moves is None:
            self._moves = max(map(abs, self.v.tolist())) > AT_REST
        return self._moves

    def move_at(self, v: FloatArray) -> None:
        """Continue at the joint velocities `v` (n) from the next tick on."""
        self.v[:] = v
        self._moves = None

    def tick(
        self,
        goal: Pose,
        twist: TwistParts,
        dt_s: float,
        joint_rate: FloatArray | None = None,
        slide: bool = False,
    ) -> float:
        """Move for `dt_s` towards the TCP `goal` (in the base), which itself moves at `twist`.

        `twist` is linear, angular; base axes, at the TCP. `joint_rate` (n) is the operator's
        request for single joints beside it; it adds to the twist (Baklouti et al. 2021, equation
        7). With `slide` an obstacle or the end of a joint's range takes away only the part of the
        twist that points into it: of the translation the blocked part, and translation and rotation
        each by its own path speed. Under Policy.PATH nothing else is added to the request. Without
        `slide`, the line is held and the motion ends there. Return the path speed s: the caller
        moves the goal by `self.twist` · dt_s, which is s times the request, less directions that
        the arm lacks.
        """
        kinematics, options, n = self.kinematics, self.options, self.joints
        kinematics.update(self.q)
        jacobian, placement = kinematics.jacobian, kinematics.placement
        difference = placement.actInv(to_se3(goal))
        feedback, wanted, rotation = self._feedback, self._wanted, placement.rotation
        feedback[:3] = difference.translation
        feedback[3:] = pin.log3(difference.rotation)
        np.dot(twist, rotation, out=self._own_axes)
        if joint_rate is not None:
            wanted += jacobian.dot(joint_rate)
        self._unreachable = (0.0, 0.0)
        if self.projects:
            self._project(jacobian)
            self.reachable = to_pose(
                placement * pin.SE3(pin.exp3(feedback[3:].copy()), feedback[:3].copy())
            )
        self._limit_feedback(dt_s)

        task, normal, linear = self._task, self._normal, self._linear
        np.multiply(jacobian, self._column_weights, out=self._task_of_joints)
        # The path's unknown is its speed itself and not the share s, so that the program is as
        # well conditioned at 1 µm/s as at 1 m/s.
        weighed = wanted * self._weights
        pace = math.sqrt(weighed.dot(weighed))
        np.multiply(weighed, -1.0 / pace if pace > AT_REST else 0.0, out=self._task_of_path)
        np.dot(task.T, task, out=normal)
        if self._equal_weights:
            self._singular.compute(self._joint_block)
        else:
            scaled = jacobian * self._scales[:, None]
            self._singular.compute(scaled.T.dot(scaled))
        sigma2 = float(self._singular.eigenvalues()[self._smallest])
        if self._held:
            sigma2 = self._smallest_of_free(
                self._joint_block if self._equal_weights else scaled.T.dot(scaled)
            )
        np.dot(self._weights * feedback, task, out=linear)
        np.negative(linear, out=linear)
        self._sigma = sigma = math.sqrt(max(0.0, sigma2))
        damping = options.damping_floor
        if sigma < options.singular_below:
            share = sigma / options.singular_below
            damping += options.damping**2 * (1.0 - share * share)
        self._lambda = damping
        self._diagonal += damping
        if self._smallest and (self.posture is not None or joint_rate is not None):
            self._add_posture(joint_rate, pace)
        stiffness = self._stiffness()
        self._price_slowing(pace, stiffness)
        v = self._solve(dt_s)
        rows = self._active
        s = min(1.0, float(v[n]) / pace) if pace > AT_REST else 1.0
        tight = self._tight(v[:n], rows) if slide else ()
        if self.policy is Policy.REACH and tight:
            # The goal must not run away from the arm.
            left = jacobian.dot(v[:n]) - feedback
            asked = float(wanted.dot(wanted))
            s = min(1.0, max(0.0, float(left.dot(wanted)) / asked)) if asked else 1.0
            wanted[:] = left
        elif slide and ((self._ending and s < SLOWED) or tight):
            parts = self._parts(tight)
            if len(parts) > 1:
                v, s = self._slide(parts, stiffness, rows)
            else:
                wanted *= s
        else:
            wanted *= s
        self._held = self._ending and s < SLOWED
        self.path_speed = s
        np.dot(self._own_axes, rotation.T, out=self.twist)
        self._step(v[:n], dt_s)
        return s

    def tick_joints(self, goal: FloatArray, rate: FloatArray, dt_s: float) -> float:
        """Move for `dt_s` towards the joint positions `goal`, which move at `rate` (n each).

        Return the path speed s: the caller moves the goal by s·rate·dt_s.
        """
        n, options = self.joints, self.options
        self.kinematics.update(self.q)
        error = goal - self.q
        feedback = np.zeros(n)
        for i, (e, a) in enumerate(zip(error.tolist(), self.bounds.acceleration, strict=True)):
            speed = min(options.joint_gain_1_s * abs(e), stopping_speed(abs(e), a, dt_s))
            feedback[i] = math.copysign(speed, e)
        normal, linear = self._normal, self._linear
        normal[:] = 0.0
        self._diagonal[:] = 1.0
        pace = math.sqrt(rate.dot(rate))
        linear[:n], linear[n] = -feedback, 0.0
        if pace > AT_REST:
            normal[:n, n] = normal[n, :n] = rate / -pace
            linear[n] = float(rate.dot(feedback)) / pace
        self._price_slowing(pace, options.path_stiffness)
        v = self._solve(dt_s)
        self.path_speed = s = min(1.0, float(v[n]) / pace) if pace > AT_REST else 1.0
        self._held = self._ending and s < SLOWED
        self._error_m = self._error_rad = 0.0
        self._step(v[:n], dt_s)
        return s

    def brake(self, dt_s: float) -> None:
        """Slow every joint down as fast as it can, obstacles in the braking path included."""
        n = self.joints
        self.kinematics.update(self.q)
        self._normal[:] = 0.0
        self._diagonal[:] = 1.0
        self._linear[:] = 0.0
        self._highest[n], self._lowest[n] = 0.0, 0.0
        v = self._solve(dt_s)
        self.path_speed = 0.0
        self._held = False
        self.twist[:] = 0.0
        self._step(v[:n], dt_s)

    def status(self) -> ServoStatus:
        """Numbers of the last tick."""
        n, collision = self.joints, self.collision
        closest = Closest(math.inf, ("", "")) if collision is None else collision.closest()
        limiting = self.bounds.limiting(self._lowest[:n], self._highest[:n], self.v)
        return ServoStatus(
            self.path_speed,
            self._sigma,
            math.sqrt(self._lambda),
            tuple(self.kinematics.names[i] for i in limiting) if self.moving or self._held else (),
            closest.distance_m,
            closest.names,
            self._active,
            self._error_m,
            self._error_rad,
            *self._unreachable,
            self._failures,
            self._iterations,
            nearer_m=closest.grown_m,
        )

    def _smallest_of_free(self, matrix: FloatArray) -> float:
        """Return the smallest eigenvalue of the task's `matrix` without joints at an end of their
        range: an arm that these make singular must not swing about its line."""
        bounds, matrix = self.kinematics, matrix.copy()
        ended = np.flatnonzero(np.minimum(bounds.upper - self.q, self.q - bounds.lower) < AT_END)
        matrix[ended], matrix[:, ended] = 0.0, 0.0
        smallest = max(self._smallest, len(ended))
        return float(np.linalg.eigvalsh(matrix)[smallest]) if smallest < self.joints else 0.0

    def _stiffness(self) -> float:
        """Return the price of slowing along the path: lower, the nearer the TCP is to leaving its
        line."""
        off = max(self._error_m / OFF_LINE_M, self._error_rad / OFF_LINE_RAD)
        left = max(0.0, 1.0 - off)
        return self.options.path_stiffness * max(left * left, LEAST_STIFFNESS)

    def _price_slowing(self, pace: float, stiffness: float) -> None:
        """Set bounds and price of the speed along the path: a share of the pace, equal at any
        pace."""
        n = self.joints
        if pace <= AT_REST:
            self._normal[n, n] = 1.0
            self._highest[n] = self._lowest[n] = 0.0
            return
        self._normal[n, n] += stiffness
        self._linear[n] -= stiffness * pace
        self._highest[n] = pace
        self._lowest[n] = pace if self.policy is Policy.REACH else 0.0

    def _project(self, jacobian: FloatArray) -> None:
        """Remove directions that an arm with few joints lacks from the request, and keep its
        size."""
        weighed = jacobian * self._column_weights
        normal = weighed.T.dot(weighed)
        normal[np.diag_indices(self.joints)] += FREE_DIRECTION
        self._solver.compute(normal)
        weights = self._weights
        rest = self._wanted.copy()
        for part in (self._wanted, self._feedback):
            part[:] = jacobian.dot(self._solver.solve(weighed.T.dot(weights * part)))
        rest -= self._wanted
        x, y, z, rx, ry, rz = rest.tolist()
        self._unreachable = (
            math.sqrt(x * x + y * y + z * z),
            math.sqrt(rx * rx + ry * ry + rz * rz),
        )

    def _limit_feedback(self, dt_s: float) -> None:
        """Limit `_feedback` to the velocity that removes the pose error and can still stop."""
        options, feedback = self.options, self._feedback
        x, y, z, rx, ry, rz = feedback.tolist()
        error = self._error_m = math.sqrt(x * x + y * y + z * z)
        self._error_rad = math.sqrt(rx * rx + ry * ry + rz * rz)
        if error < self._small_m and self._error_rad < self._small_rad:
            feedback *= options.gain_1_s
            return
        if error > 0.0:
            speed = min(
                options.gain_1_s * error,
                stopping_speed(error, options.linear_deceleration_m_s2, dt_s),
                options.linear_speed_m_s,
            )
            feedback[:3] *= speed / error
        error = self._error_rad
        if error > 0.0:
            speed = min(
                options.gain_1_s * error,
                stopping_speed(error, options.angular_deceleration_rad_s2, dt_s),
                options.angular_speed_rad_s,
            )
            feedback[3:] *= speed / error

    def _add_rows(self, dt_s: float) -> None:
        """Fill in a row for each pair of bodies that could meet within the joints' bounds, which
        are filled in: those that could exceed their limit most."""
        collision = self.collision
        self._active = 0
        if collision is None or not collision.pairs:
            return
        n, distances = self.joints, collision.update()
        self._nearest_m = min(distances)
        deceleration = self._closing_m_s2
        safety, grown = self._safety, collision.grown_m
        if max(grown) > 0.0:
            safety = [clearance_m + more for clearance_m, more in zip(safety, grown, strict=True)]
        # A pair that no speed within the joints' bounds can bring too near needs no row: first by
        # how far its bodies can move at most, then by its gradient.
        fastest = np.maximum(self._highest[:n], -self._lowest[:n])
        speed = collision.fastest_closing(fastest) + TIGHT_M_S
        farthest = max(safety) + speed * (speed / (2.0 * self._slowest_m_s2) + dt_s)
        near = [pair for pair, distance in enumerate(distances) if distance < farthest]
        if not near:
            return
        closing = collision.sweep(fastest) + TIGHT_M_S
        needs = (safety + closing * (closing / (2.0 * deceleration) + dt_s)).tolist()
        near = [pair for pair in near if distances[pair] < needs[pair]]
        if not near:
            return
        rows = self._gradients[: len(near)]
        collision.gradients(near, rows)
        least = np.array(
            [
                -stopping_speed(distances[pair] - safety[pair], deceleration[pair], dt_s)
                for pair in near
            ]
        )
        room = np.maximum(rows, 0.0).dot(self._lowest[:n])
        room += np.minimum(rows, 0.0).dot(self._highest[:n])
        room -= least
        binding = np.flatnonzero(room < TIGHT_M_S)
        if len(binding) > MAX_ROWS:
            binding = binding[np.argsort(room[binding], kind="stable")[:MAX_ROWS]]
        self._active = count = len(binding)
        self._rows_of_joints[:count] = rows[binding]
        self._lowest[n + 1 : n + 1 + count] = least[binding]

    def _add_posture(self, joint_rate: FloatArray | None, speed: float) -> None:
        """Pull towards the posture and the requested joint speeds, where the task leaves freedom.

        Only along the null space: a cost on all of v would slow the task. And only while the TCP is
        requested to move, because an arm whose TCP rests must rest.
        """
        options = self.options
        free = self._singular.eigenvectors()[:, : self._smallest]
        pull, share = np.zeros(self.joints), min(1.0, speed / POSTURE_FULL_AT_M_S)
        if self.posture is not None:
            away = self.posture - self.q
            away *= np.maximum(0.0, 1.0 - (away / self._half_turns) ** 2)
            pull += share * options.posture_gain_1_s * away
        if joint_rate is not None:
            pull += joint_rate
        # A slow task is slowed at little cost, so the posture must cost less.
        weight = options.posture_weight * share * share
        self._joint_block += (weight * free).dot(free.T)
        self._linear[: self.joints] -= weight * free.dot(free.T.dot(pull))

    def _tight(self, v: FloatArray, rows: int) -> list[int]:
        """Return the rows of pairs of bodies that close at their limit."""
        if not rows:
            return []
        closing = self._rows_of_joints[:rows].dot(v)
        closing -= self._lowest[self.joints + 1 : self.joints + 1 + rows]
        found: list[int] = np.flatnonzero(closing < TIGHT_M_S).tolist()
        return found

    def _parts(self, tight: Sequence[int]) -> list[FloatArray]:
        """Split the requested twist into parts that may be given up separately: translation along
        an obstacle, translation into it, rotation; without parts that are zero."""
        weights, along, turning = self._weights, self._wanted.copy(), self._wanted.copy()
        along[3:] = turning[:3] = 0.0
        into = along.copy()
        if tight:
            # How the distance of each pair grows with the translation of the TCP.
            lever = np.linalg.solve(self._joint_block, self._rows_of_joints[tight].T)
            normals = (self._task_of_joints[:3].dot(lever) * self._column_weights[:3]).T
            sizes = (normals * normals).sum(axis=1).tolist()
            for _ in range(SWEEPS):
                for normal, size in zip(normals, sizes, strict=True):
                    closing = float(normal.dot(along[:3]))
                    if closing < 0.0 and size > FREE_DIRECTION:
                        along[:3] -= closing / size * normal
        into -= along
        return [
            part
            for part in (along, into, turning)
            if float(np.linalg.norm(part * weights)) > AT_REST
        ]

    def _slide(
        self, parts: list[FloatArray], stiffness: float, rows: int
    ) -> tuple[FloatArray, float]:
        """Solve with a path speed for each of `parts`, whose possible motion replaces the request;
        return the solution, and the share that is left."""
        n, weights = self.joints, self._weights
        unknowns, end = n + len(parts), n + 1 + rows
        weighed = np.array(parts) * weights
        paces = np.linalg.norm(weighed, axis=1)
        task = np.hstack((self._task_of_joints, (weighed / -paces[:, None]).T))
        normal = task.T.dot(task)
        normal[:n, :n] = self._joint_block
        normal[range(n, unknowns), range(n, unknowns)] += self._lambda + stiffness
        linear = np.concatenate((self._linear[:n], -(weights * self._feedback).dot(task[:, n:])))
        linear[n:] -= stiffness * paces
        none = np.zeros(len(parts))
        x = self._program(
            normal,
            linear,
            np.hstack((self._rows_of_joints[:rows], np.zeros((rows, len(parts))))),
            np.concatenate((self._highest[:n], paces, self._highest[n + 1 : end])),
            np.concatenate((self._lowest[:n], none, self._lowest[n + 1 : end])),
        )
        self._wanted[:] = (x[n:] / paces).dot(parts)
        return x, min(1.0, float(x[n:].dot(paces) / paces.dot(paces)))

    def _solve(self, dt_s: float) -> FloatArray:
        """Return the program's solution, v and s; a braking ramp if there is none."""
        highest, lowest = self._highest, self._lowest
        self._ending = self.bounds.fill(self.q.tolist(), self.v.tolist(), dt_s, lowest, highest)
        self._add_rows(dt_s)
        rows = self._active
        end = self.joints + 1 + rows
        return self._program(
            self._normal,
            self._linear,
            self._rows[:rows],
            highest[:end],
            lowest[:end],
        )

    def _program(
        self,
        normal: FloatArray,
        linear: FloatArray,
        rows: FloatArray,
        highest: FloatArray,
        lowest: FloatArray,
    ) -> FloatArray:
        unknowns = len(linear)
        first = self.joints + MAX_PARTS - unknowns
        sense = self._sense[first : first + len(highest)]
        x: FloatArray
        x, _, flag, info = daqp.solve(normal, linear, rows, highest, lowest, sense)
        self._iterations = max(self._iterations, info["iterations"])
        if flag < 1 or not math.isfinite(x.dot(x)):
            self._failures += 1
            x = np.zeros(unknowns)
        # The solver's tolerance must not push a joint past its limit.
        np.minimum(x, highest[:unknowns], out=x)
        np.maximum(x, lowest[:unknowns], out=x)
        return x

    def _step(self, v: FloatArray, dt_s: float) -> None:
        step = v * dt_s
        collision = self.collision
        if (
            collision is not None
            and collision.fastest_closing(step) > self._nearest_m
            and self._strikes(collision, step)
        ):
            # The soft rows are violated; the only way left is to be slower.
            self._failures += 1
            v = np.minimum(
                np.maximum(0.0, self._lowest[: self.joints]), self._highest[: self.joints]
            )
            step = v * dt_s
        np.copyto(self.v, v)
        self._moves = None
        self.q += step

    def _strikes(self, collision: CollisionModel, step: FloatArray) -> bool:
        """Return whether this step would bring a pair into contact. Pairs that cannot meet within
        the step are excluded by their bodies' largest motion, so no contact between two ticks is
        missed."""
        before = np.array(collision.distances)
        moved = collision.sweep(step)
        if not ((before >= 0.0) & (moved > before)).any():
            return False
        after = np.array(collision.at(self.q + step))
        return bool(((after < 0.0) & (before >= 0.0)).any())
