"""Kinematics of serial arms on Pinocchio: forward, Jacobian, and the inverse without a formula.

A continuous joint is an angle without bounds here, not a point on the circle: it counts its turns,
nothing ever wraps, and `nearest_turns` chooses the short way to a goal.
"""

from __future__ import annotations

import math

from cardan.common.arm_libraries import eigenpy, np, npt, pin
from cardan.gateway.kinematics.base import SE3, TURN, FloatArray, to_se3
from cardan.robots import ArmModel, JointKind, SixWeights
from cardan.robots.arm_bodies import (
    CHARACTERISTIC_LENGTH_M,
    WEIGHTS,
    pinocchio_model,
    smallest_singular_value,
)
from cardan.types import IDENTITY_POSE, Pose

POSITION_TOLERANCE_M = 1e-6
ROTATION_TOLERANCE_RAD = 1e-6
"""Error at which an inverse is found: a hundredth of any arm's repeatability."""

MAX_ITERATIONS = 40
"""Iterations of one descent. Those that converge need 5 to 15; others are in a local minimum."""

MAX_RESTARTS = 100
"""Descents from other configurations before the pose counts as out of reach."""

PATIENCE = 4
"""Most iterations of a descent without halving its error."""


DAMPING = 0.02
"""Damping of a descent, times its squared error. Five times more costs a fifth more time; much less
lets it jump between branches."""


_WEIGHTS = WEIGHTS[:, None]


class ArmKinematics:
    """Kinematics of one serial arm, with a tool fixed to its TCP."""

    def __init__(self, model: ArmModel, tool: Pose = IDENTITY_POSE) -> None:
        self.arm = model
        self.joints = len(model.joints)
        self.names = model.joint_names
        self.lower = np.array(model.lower)
        self.upper = np.array(model.upper)
        self.velocity = np.array(model.velocity)
        self.acceleration = np.array([joint.acceleration for joint in model.joints])
        self.continuous: npt.NDArray[np.bool_] = np.array(
            [joint.kind is JointKind.CONTINUOUS for joint in model.joints]
        )
        self._turns = np.array([joint.kind is not JointKind.PRISMATIC for joint in model.joints])
        # A joint that reaches every angle can be turned past its end on the way to a solution.
        whole = self._turns & (self.upper - self.lower >= TURN - 1e-5)
        self._soft_lower = np.where(whole, -np.inf, self.lower)
        self._soft_upper = np.where(whole, np.inf, self.upper)
        self.model = pinocchio_model(model)
        self._tcp = self.model.getFrameId("tcp")
        self._data = self.model.createData()
        self._spare = self.model.createData()
        self._local = pin.ReferenceFrame.LOCAL
        self._solver = eigenpy.LLT(self.joints)
        self._random = np.random.default_rng(0)
        self.set_tool(tool)
        self.update(np.array(model.home))

    def set_tool(self, tool: Pose) -> None:
        """Fix `tool` (its TCP in the arm's own) to the end; the identity removes it. Takes effect
        with the next `update` or `forward`."""
        self.tool = tool
        self.model.frames[self._tcp].placement = to_se3(self.arm.tcp) * to_se3(tool)

    def update(self, q: FloatArray) -> None:
        """Set `placement` and `jacobian` (TCP axes) for the joint positions `q`."""
        data = self._data
        pin.computeJointJacobians(self.model, data, q)
        self.placement = pin.updateFramePlacement(self.model, data, self._tcp)
        self.jacobian = pin.getFrameJacobian(self.model, data, self._tcp, self._local)

    def forward(self, q: FloatArray) -> SE3:
        """Return the TCP in the base for `q`."""
        pin.forwardKinematics(self.model, self._spare, q)
        return pin.updateFramePlacement(self.model, self._spare, self._tcp).copy()

    def smallest_singular_value(self, q: FloatArray, weights: SixWeights) -> float:
        """Return the smallest singular value of the Jacobian at `q` (1 rad counts as 0.3 m), in the
        directions along TCP axes whose weight is above 0: 0 if the arm is singular."""
        jacobian = pin.computeFrameJacobian(self.model, self._spare, q, self._tcp, self._local)
        return smallest_singular_value(jacobian, weights)

    @property
    def joint_jacobians(self) -> FloatArray:
        """Spatial velocity, 6×n, of the body that each joint moves, from the last `update`: at the
        base's origin, base axes, linear part first."""
        jacobians: FloatArray = self._data.J
        return jacobians

    def nearest_turns(self, q: FloatArray, near: FloatArray) -> FloatArray:
        """Return `q` with whole turns added so that each joint is as near to `near` as its range
        allows. A bounded joint stays inside its limits if possible."""
        turns = np.rint((near - q) / TURN)
        moved = np.where(self._turns, q + turns * TURN, q)
        moved = np.where((moved > self.upper) & self._turns, moved - TURN, moved)
        moved = np.where((moved < self.lower) & self._turns, moved + TURN, moved)
        # A turn there and back may round past an end that `q` is at.
        inside = (q >= self.lower) & (q <= self.upper)
        return np.where(inside & ((moved < self.lower) | (moved > self.upper)), q, moved)

    def within_limits(self, q: FloatArray, slack: float = 1e-9) -> bool:
        """Return whether all joints are inside their ranges."""
        return bool(np.all(q >= self.lower - slack) and np.all(q <= self.upper + slack))

    def inverse(
        self, placement: SE3, near: FloatArray, restarts: int = MAX_RESTARTS
    ) -> FloatArray | None:
        """Return joint positions inside the limits with the TCP at `placement`; None if none was
        found.

        The descent starts from `near`, then from random configurations, so the branch is that of
        `near` wherever it reaches. Levenberg-Marquardt on the error in TCP axes with the damping of
        Sugihara 2011 (doi:10.1109/TRO.2011.2148230); steps end at the joint limits.
        """
        found = self._descend(placement, near)
        if found is not None:
            found = self.nearest_turns(found, near)
            if self.within_limits(found):
                return found
        low = np.where(self.continuous, near - math.pi, self.lower)
        high = np.where(self.continuous, near + math.pi, self.upper)
        for _ in range(restarts):
            found = self._descend(placement, self._random.uniform(low, high))
            if found is not None:
                return self.nearest_turns(found, near)
        return None

    def branches(self, placement: SE3, near: FloatArray, tries: int = 16) -> list[FloatArray]:
        """Return different configurations with the TCP at `placement`, nearest to `near` first.

        Nearness is the time the slowest joint needs. Finds most branches of a six-joint arm in 16
        tries, with no guarantee for all.
        """
        low = np.where(self.continuous, near - math.pi, self.lower)
        high = np.where(self.continuous, near + math.pi, self.upper)
        starts = [near, *(self._random.uniform(low, high) for _ in range(tries))]
        found: list[FloatArray] = []
        for start in starts:
            q = self._descend(placement, start)
            if q is None:
                continue
            q = self.nearest_turns(q, near)
            if all(np.abs(q - other).max() > 1e-3 for other in found):
                found.append(q)
        return sorted(found, key=lambda q: float((np.abs(q - near) / self.velocity).max()))

    def nearest(
        self, placement: SE3, near: FloatArray, weights: FloatArray
    ) -> tuple[FloatArray, SE3]:
        """Return the configuration inside the limits whose TCP comes nearest to `placement`, and
        that TCP.

        `weights` (6) of the error along TCP axes. For arms that cannot take every pose; the search
        is local, downhill from `near`.
        """
        lower, upper, solver, n = self.lower, self.upper, self._solver, self.joints
        q, damping, best = near.copy(), 1e-3, math.inf
        column = weights[:, None]
        settled, tcp = q, self.forward(q)
        for _ in range(4 * MAX_ITERATIONS):
            pin.computeJointJacobians(self.model, self._spare, q)
            here = pin.updateFramePlacement(self.model, self._spare, self._tcp)
            difference = here.actInv(placement)
            error = weights * np.concatenate(
                (difference.translation, pin.log3(difference.rotation))
            )
            square = float(error.dot(error))
            if square < best:
                gained = best - square
                settled, tcp, best = q, here.copy(), square
                damping = max(0.3 * damping, 1e-9)
                jacobian = column * pin.getFrameJacobian(
                    self.model, self._spare, self._tcp, self._local
                )
                normal, slope = jacobian.T.dot(jacobian), jacobian.T.dot(error)
                if gained < 1e-16:
                    break
            else:
                damping *= 10.0
                if damping > 1e3:
                    break
            solver.compute(normal + damping * np.eye(n))
            q = np.minimum(np.maximum(settled + solver.solve(slope), lower), upper)
        return settled, tcp

    def _descend(self, placement: SE3, start: FloatArray) -> FloatArray | None:
        model, data, tcp, local = self.model, self._spare, self._tcp, self._local
        lower, upper = self._soft_lower, self._soft_upper
        solver, n = self._solver, self.joints
        length2 = CHARACTERISTIC_LENGTH_M**2
        q: FloatArray = start.copy()
        best, patience = math.inf, PATIENCE
        normal = np.empty((n, n))
        diagonal = np.einsum("ii->i", normal)
        weighted = np.empty((6, n))
        for _ in range(MAX_ITERATIONS):
            pin.computeJointJacobians(model, data, q)
            difference = pin.updateFramePlacement(model, data, tcp).actInv(placement)
            error = pin.log6(difference).vector
            x, y, z, rx, ry, rz = error.tolist()
            position, rotation = x * x + y * y + z * z, rx * rx + ry * ry + rz * rz
            if position < POSITION_TOLERANCE_M**2 and rotation < ROTATION_TOLERANCE_RAD**2:
                return q
            square = position + length2 * rotation
            if square < 0.25 * best:
                best, patience = square, PATIENCE
            else:
                patience -= 1
                if patience == 0:
                    return None
            np.multiply(pin.getFrameJacobian(model, data, tcp, local), _WEIGHTS, out=weighted)
            np.dot(weighted.T, weighted, out=normal)
            diagonal += DAMPING * square + 1e-9
            solver.compute(normal)
            q += solver.solve(weighted.T.dot(WEIGHTS * error))
            np.minimum(q, upper, out=q)
            np.maximum(q, lower, out=q)
        return None
