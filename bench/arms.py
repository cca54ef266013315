"""Shared parts of the servo benchmarks: arms, obstacles, and the peers for comparison."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import CollisionModel, HalfSpace, Obstacle
from cardan.robots import Capsule, load_arm
from cardan.types import Vector3

DEBIAN_PACKAGES = "/usr/lib/python3/dist-packages"
"""Folder of Debian's package python3-pykdl, which fits Debian's Python version."""

ACCELERATION_RAD_S2 = 15.0
"""Acceleration limit of every joint; the published prototype's line studies use it, too."""


def kinematics(name: str, acceleration: float | None = ACCELERATION_RAD_S2) -> ArmKinematics:
    """Return the kinematics of one of the packaged arms, with the same acceleration limit at all
    joints."""
    made = ArmKinematics(load_arm(name))
    if acceleration is not None:
        made.acceleration[:] = acceleration
    return made


def _post(name: str, x: float, y: float) -> Obstacle:
    return Obstacle(name, Capsule(Vector3(x, y, 0.0), Vector3(x, y, 1.0), 0.1))


def surroundings() -> tuple[Obstacle, ...]:
    """A floor and four posts around the arm."""
    posts = ((1.5, 0.0), (0.0, 1.5), (0.0, -1.5), (-1.5, 0.0))
    return (
        Obstacle("floor", HalfSpace(Vector3(0.0, 0.0, 1.0), -1.0)),
        *(_post(f"post {i}", x, y) for i, (x, y) in enumerate(posts)),
    )


def shapes_as_tables(posts: int) -> list[dict[str, Any]]:
    """Return the floor and the first posts, as obstacles of a session file."""
    made: list[dict[str, Any]] = []
    for name, shape in surroundings()[: 1 + posts]:
        if isinstance(shape, HalfSpace):
            made.append({"name": name, "plane": [list(shape.normal), shape.offset_m]})
        elif isinstance(shape, Capsule):
            capsule = [list(shape.start), list(shape.end), shape.radius_m]
            made.append({"name": name, "capsule": capsule})
    return made


def shorten(collision: CollisionModel, pairs: int) -> CollisionModel:
    """Keep the first `pairs` pairs only, so that all arms are charged for the same number."""
    geometry = collision._geometry
    while len(geometry.collisionPairs) > pairs:
        geometry.removeCollisionPair(geometry.collisionPairs[len(geometry.collisionPairs) - 1])
    collision.pairs = collision.pairs[:pairs]
    collision.with_obstacle = collision.with_obstacle[:pairs]
    collision.pair_solids = collision.pair_solids[:pairs]
    collision._masks, collision.sweeps = collision._masks[:pairs], collision.sweeps[:pairs]
    collision._data = geometry.createData()
    for request in collision._data.distanceRequests:
        request.enable_signed_distance = True
    collision._results = [collision._data.distanceResults[i] for i in range(len(collision.pairs))]
    return collision


class DampedLeastSquares:
    """Plain step for comparison: pseudo-inverse with constant damping, scaled speeds, clipped
    positions."""

    def __init__(self, arm: ArmKinematics, damping: float = 0.05) -> None:
        self.arm, self.damping = arm, damping
        self.q = np.array(arm.arm.home)

    def step(self, goal: Any, dt_s: float) -> None:
        """Take one step towards `goal`."""
        arm = self.arm
        arm.update(self.q)
        error = pin.log6(arm.placement.actInv(goal)).vector / dt_s
        jacobian = arm.jacobian
        normal = jacobian @ jacobian.T
        normal[np.diag_indices(6)] += self.damping**2
        v = jacobian.T @ np.linalg.solve(normal, error)
        v /= max(1.0, float((np.abs(v) / arm.velocity).max()))
        self.q = np.clip(self.q + v * dt_s, arm.lower, arm.upper)


def pink_step(arm: ArmKinematics, solver: str = "daqp") -> Callable[[Any, float], None]:
    """Step of pink: frame and posture tasks, with its position and speed limits."""
    import pink

    model = arm.model.copy()
    model.lowerPositionLimit, model.upperPositionLimit = arm.lower.copy(), arm.upper.copy()
    model.velocityLimit = arm.velocity.copy()
    data = model.createData()
    state = pink.Configuration(model, data, np.array(arm.arm.home))
    task = pink.tasks.FrameTask("tcp", position_cost=1.0, orientation_cost=0.3)
    posture = pink.tasks.PostureTask(cost=1e-3)
    posture.set_target(np.array(arm.arm.home))

    def step(goal: Any, dt_s: float) -> None:
        task.set_target(goal)
        v = pink.solve_ik(state, [task, posture], dt_s, solver=solver, safety_break=False)
        state.integrate_inplace(v, dt_s)

    return step


def kdl() -> Any | None:
    """Return PyKDL if Debian's package is installed and fits this Python; else None."""
    try:
        import PyKDL
    except ImportError:
        sys.path.append(DEBIAN_PACKAGES)
        try:
            import PyKDL
        except ImportError:
            return None
        finally:
            sys.path.remove(DEBIAN_PACKAGES)
    return PyKDL


def kdl_step(arm: ArmKinematics, library: Any) -> Callable[[Any, float], None]:
    """Step of KDL's weighted damped least squares: a velocity, without limits."""
    chain = library.Chain()
    for joint in arm.arm.joints:
        x, y, z = joint.placement.position
        w, i, j, k = joint.placement.orientation
        frame = library.Frame(library.Rotation.Quaternion(i, j, k, w), library.Vector(x, y, z))
        origin, axis = frame.p, frame.M * library.Vector(*joint.axis)
        moving = library.Joint(joint.name, origin, axis, library.Joint.RotAxis)
        chain.addSegment(library.Segment(joint.name, moving, frame))
    solver = library.ChainIkSolverVel_wdls(chain)
    solver.setLambda(0.05)
    forward = library.ChainFkSolverPos_recursive(chain)
    n = arm.joints
    q, v = library.JntArray(n), library.JntArray(n)
    for index, value in enumerate(arm.arm.home):
        q[index] = value
    here = library.Frame()
    forward.JntToCart(q, here)
    start = library.Frame(here)

    def step(goal: Any, dt_s: float) -> None:
        forward.JntToCart(q, here)
        x, y, z = goal.translation
        wanted = library.Frame(start.M, library.Vector(x, y, z))
        solver.CartToJnt(q, library.diff(here, wanted, dt_s), v)
        for index in range(n):
            q[index] += v[index] * dt_s

    return step
