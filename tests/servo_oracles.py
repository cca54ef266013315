"""The compiled servo against its oracles: Pinocchio, Coal, daqp, quadprog and the servo in Python.

    python -m tests.servo_oracles [COUNT]     default 1000000 states on all arms together

Prints the table of docs/servo.md. The tests run the same with a few thousand states.
"""

from __future__ import annotations

import ctypes
import math
import sys
import time
import unittest.mock
from typing import NamedTuple

import daqp
import numpy as np
import pinocchio as pin
import quadprog

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import to_pose
from cardan.gateway.kinematics.collision import CollisionModel, HalfSpace, Obstacle
from cardan.gateway.servo import kernel_layout as layout, servo as servo_module
from cardan.gateway.servo.compiled import CompiledServo
from cardan.gateway.servo.native import kernel_library
from cardan.gateway.servo.options import Policy, ServoOptions
from cardan.gateway.servo.servo import Servo
from cardan.robots import Capsule, OrientedBox, arm_names, load_arm
from cardan.spatial import from_rotation_vector
from cardan.types import Pose, Vector3

FINEST = 1e-12
"""Tolerance that Coal's iterations are asked for."""

NEGLIGIBLE = 1e-11
"""Squared size of a row that counts as zero, for daqp and the kernel."""

SAME_COST = 1e-9
"""Difference of costs that counts as rounding, relative to their parts: costs of violated rows are
large."""


def surroundings(generator, count=6):
    """Return a floor, and boxes, capsules and spheres at random places around an arm's base."""
    yield Obstacle("floor", HalfSpace(Vector3(0.0, 0.0, 1.0), -0.3))
    for index in range(count):
        where = Vector3(*generator.uniform(-1.2, 1.2, 3))
        kind = index % 3
        if kind == 0:
            turned = from_rotation_vector(Vector3(*generator.uniform(-3, 3, 3)))
            size = Vector3(*generator.uniform(0.05, 0.5, 3))
            yield Obstacle(f"box {index}", OrientedBox(Pose(where, turned), size))
        elif kind == 1:
            end = Vector3(*(np.array(where) + generator.uniform(-0.5, 0.5, 3)))
            yield Obstacle(f"capsule {index}", Capsule(where, end, generator.uniform(0.01, 0.2)))
        else:
            yield Obstacle(f"sphere {index}", Capsule(where, where, generator.uniform(0.01, 0.2)))


def random_joints(arm, generator):
    """Return random joint positions in range; continuous joints are several turns away."""
    low = np.where(arm.continuous, -20.0, arm.lower)
    high = np.where(arm.continuous, 20.0, arm.upper)
    return generator.uniform(low, high)


def _doubles(values):
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


class Worst(NamedTuple):
    """Largest differences found."""

    placement: float
    jacobian: float


def kinematics(name, count, seed=0):
    """Compare placement and Jacobian of random joints, with a random tool, with Pinocchio's."""
    generator, library = np.random.default_rng(seed), kernel_library()
    turned = from_rotation_vector(Vector3(*generator.uniform(-2, 2, 3)))
    tool = Pose(Vector3(*generator.uniform(-0.3, 0.3, 3)), turned)
    arm = ArmKinematics(load_arm(name), tool)
    servo = CompiledServo(arm)
    rotation, position = np.zeros((3, 3)), np.zeros(3)
    jacobian = np.zeros((6, arm.joints))
    apart, off = 0.0, 0.0
    for _ in range(count):
        q = random_joints(arm, generator)
        arm.update(q)
        library.kernel_kinematics(
            servo._handle, _doubles(q), _doubles(rotation), _doubles(position), _doubles(jacobian)
        )
        apart = max(
            apart,
            np.abs(rotation - arm.placement.rotation).max(),
            np.abs(position - arm.placement.translation).max(),
        )
        off = max(off, np.abs(jacobian - arm.jacobian).max())
    return Worst(apart, off)


def make_finest(model):
    """Let Coal iterate to its finest tolerance."""
    for request in model._data.distanceRequests:
        request.gjk_tolerance = request.epa_tolerance = FINEST
        request.gjk_max_iterations = request.epa_max_iterations = 1000


class Distances(NamedTuple):
    """Results of the comparison of distances."""

    checked: int
    farther: float
    """Largest excess of a kernel's distance over Coal's."""
    nearer: float
    """Largest excess of Coal's distance over the kernel's."""
    gradient: float
    """Largest error of a gradient against a difference quotient of the kernel's distances."""


def distances(name, count, seed=0, per_scene=100):
    """Compare the distances of all pairs with Coal's, in random scenes."""
    generator, library = np.random.default_rng(seed), kernel_library()
    arm = ArmKinematics(load_arm(name))
    checked, farther, nearer, steep = 0, 0.0, 0.0, 0.0
    while checked < count:
        model = CollisionModel(arm, tuple(surroundings(generator)))
        make_finest(model)
        servo = CompiledServo(arm, model)
        pairs = len(model.pairs)
        found, moved = np.zeros(pairs), np.zeros(pairs)
        rows, spare = np.zeros((pairs, arm.joints)), np.zeros((pairs, arm.joints))
        for _ in range(min(per_scene, count - checked)):
            q = random_joints(arm, generator)
            expected = np.array(model.at(q))
            library.kernel_distances(servo._handle, _doubles(q), _doubles(found), _doubles(rows))
            farther = max(farther, (found - expected).max())
            nearer = max(nearer, (expected - found).max())
            step = generator.normal(size=arm.joints)
            expected = rows @ step
            off = np.full(pairs, math.inf)
            for side in (1e-7, -1e-7):  # one side of a kink has this slope
                there = q + side * step
                library.kernel_distances(
                    servo._handle, _doubles(there), _doubles(moved), _doubles(spare)
                )
                off = np.minimum(off, np.abs((moved - found) / side - expected))
            steep = max(steep, off.max())
            checked += 1
    return Distances(checked, farther, nearer, steep)


class Program(NamedTuple):
    """Optimization problem of a tick: min ½x'Hx + f'x, low <= x <= high, A x >= least softly."""

    hessian: np.ndarray
    linear: np.ndarray
    low: np.ndarray
    high: np.ndarray
    rows: np.ndarray
    least: np.ndarray

    def cost(self, x):
        """Return the cost to be minimized, including the penalty of violated rows."""
        if len(self.rows):
            slack = np.maximum(0.0, self.least - self.rows @ x)
            size2 = np.einsum("ij,ji->i", self.rows, np.linalg.solve(self.hessian, self.rows.T))
            acts = (slack > 0.0) & (size2 > NEGLIGIBLE)
            price = 0.5 * (slack[acts] ** 2 / (1e-6 * size2[acts])).sum()
        else:
            price = 0.0
        return 0.5 * x @ self.hessian @ x + self.linear @ x + price

    def no_worse(self, x, y):
        """Return whether `x` costs no more than `y`, up to rounding.

        `y` is clipped to its bounds first: daqp leaves them by up to 1e-7 if rows are violated,
        which would cost less.
        """
        y = np.clip(y, self.low, self.high)
        cost = self.cost(y)
        size = abs(cost) + y @ self.hessian @ y + abs(self.linear @ y)
        return self.cost(x) <= cost + SAME_COST * size

    def by_kernel(self):
        """Solve it with the kernel; return solution, multipliers, iterations and flag."""
        library, given = kernel_library(), layout.CProgram()
        n, rows = len(self.linear), len(self.rows)
        given.unknowns, given.rows = n, rows
        for i in range(n):
            given.hessian[i][:n] = self.hessian[i].tolist()
        given.linear[:n] = self.linear.tolist()
        given.lowest[:n], given.highest[:n] = self.low.tolist(), self.high.tolist()
        for r in range(rows):
            given.row[r][:n] = self.rows[r].tolist()
            given.row_name[r] = r
        given.least[:rows] = self.least.tolist()
        flag = library.kernel_program(ctypes.byref(given))
        again = layout.CProgram.from_buffer_copy(given)
        warm = library.kernel_program(ctypes.byref(again))
        x = np.array(given.x[:n])
        return x, np.array(given.multiplier[: n + rows]), given.iterations, flag, again, warm

    def by_daqp(self):
        """Solve it with daqp; return solution and flag."""
        n, rows = len(self.linear), len(self.rows)
        sense = np.zeros(n + rows, dtype=np.int32)
        sense[n:] = 8
        x, _, flag, _ = daqp.solve(
            self.hessian,
            self.linear,
            self.rows.reshape(rows, n).copy(),
            np.concatenate((self.high, np.full(rows, 1e30))),
            np.concatenate((self.low, self.least)),
            sense,
            primal_tol=1e-12,
            dual_tol=1e-14,
            iter_limit=10000,
        )
        return x, flag

    def by_quadprog(self):
        """Solve it with quadprog, with the violations of rows as further unknowns; return None if
        it finds no solution."""
        n, rows = len(self.linear), len(self.rows)
        size2 = np.einsum("ij,ji->i", self.rows, np.linalg.solve(self.hessian, self.rows.T))
        whole = np.zeros((n + rows, n + rows))
        whole[:n, :n] = self.hessian
        whole[range(n, n + rows), range(n, n + rows)] = 1.0
        normals = np.zeros((n + rows, 2 * n + rows))
        normals[:n, :n], normals[:n, n : 2 * n] = np.eye(n), -np.eye(n)
        normals[:n, 2 * n :] = self.rows.T
        normals[n:, 2 * n :] = np.diag(np.sqrt(1e-6 * size2))
        bounds = np.concatenate((self.low, -self.high, self.least))
        linear = np.concatenate((-self.linear, np.zeros(rows)))
        try:
            return quadprog.solve_qp(whole, linear, normals, bounds)[0][:n]
        except ValueError:
            return None

    def residual(self, x, multiplier):
        """Return the largest violation of the Karush-Kuhn-Tucker conditions."""
        n = len(x)
        bound, row = multiplier[:n], multiplier[n:]
        slope = self.hessian @ x + self.linear - bound - self.rows.T @ row
        scale = 1.0 + np.abs(self.linear).max() + np.abs(multiplier).max()
        wrong = [np.abs(slope).max() / scale]
        wrong += [np.maximum(self.low - x, x - self.high).max()]
        wrong += np.minimum(bound, 0.0)[x < self.high].tolist() and [
            -np.minimum(bound, 0.0)[x < self.high].min() / scale
        ]
        wrong += np.maximum(bound, 0.0)[x > self.low].tolist() and [
            np.maximum(bound, 0.0)[x > self.low].max() / scale
        ]
        if len(row):
            wrong += [-row.min() / scale]
        return max(wrong)


def random_program(generator, degenerate=False):
    """Return a random problem like a tick's: a task of six directions with damping, and the speed
    along a path."""
    n = int(generator.integers(1, layout.MAX_JOINTS + 1))
    task = np.zeros((6, n + 1))
    task[:, :n] = generator.normal(size=(6, n)) * generator.choice((0.1, 1.0), size=(6, 1))
    task[:, n] = generator.normal(size=6)
    task[:, n] /= -np.linalg.norm(task[:, n])
    hessian = task.T @ task + 10.0 ** generator.uniform(-5, -2) * np.eye(n + 1)
    hessian[n, n] += 0.1
    linear = -(task.T @ generator.normal(size=6)) * generator.choice((0.0, 0.1, 1.0))
    linear[n] -= 0.1 * generator.uniform(0, 1)
    middle = generator.normal(size=n + 1) * generator.choice((0.0, 0.3, 1.0))
    width = 10.0 ** generator.uniform(-3, 0.5, n + 1)
    low, high = middle - width, middle + width
    low[n], high[n] = 0.0, generator.uniform(0, 1)
    if generator.random() < 0.2:
        low[n] = high[n]
    rows = np.zeros((int(generator.integers(0, layout.MAX_ROWS + 1)), n + 1))
    rows[:, :n] = generator.normal(size=(len(rows), n)) * (generator.random((len(rows), n)) < 0.7)
    rows[:, 0] += 1e-3
    least = -generator.exponential(0.3, len(rows)) * (generator.random(len(rows)) < 0.8)
    if degenerate and len(rows) > 3:
        rows[1], least[1] = rows[0], least[0]
        rows[2], least[2] = -rows[0], generator.uniform(0.0, 1.0)
        rows[3] = generator.choice((0.0, 1e-17), n + 1)
    if degenerate:
        low[0] = high[0] = middle[0]
    return Program(hessian, linear, low, high, rows, least)


class Programs(NamedTuple):
    """Results of the comparison of optimization problems."""

    solved: int
    daqp: float
    """Largest difference of an unknown from daqp's."""
    better: int
    """Number of problems whose solution differs by more but costs no more than daqp's."""
    quadprog: float
    """Largest difference of an unknown from quadprog's."""
    refused: int
    """Number of problems that quadprog calls inconsistent, wrongly."""
    better_than: int
    residual: float
    warm: float
    """Largest difference of an unknown after a start from its own active constraints."""
    iterations: int


def programs(count, seed=0, degenerate=False):
    """Compare random problems with daqp and quadprog."""
    generator = np.random.default_rng(seed)
    off, other, residual, warm_off, most, better = 0.0, 0.0, 0.0, 0.0, 0, 0
    refused, better_than = 0, 0
    for _ in range(count):
        program = random_program(generator, degenerate)
        x, multiplier, iterations, flag, again, warm = program.by_kernel()
        assert flag == warm == 0, program
        y, reported = program.by_daqp()
        most = max(most, iterations)
        warm_off = max(warm_off, np.abs(np.array(again.x[: len(x)]) - x).max())
        residual = max(residual, program.residual(x, multiplier))
        apart = np.abs(x - y).max() if reported > 0 else math.inf
        if apart > 1e-8 and (reported < 1 or program.no_worse(x, y)):
            better += 1
        else:
            off = max(off, apart)
        if not degenerate:
            z = program.by_quadprog()
            if z is None:
                refused += 1
            elif np.abs(x - z).max() > 1e-8 and program.no_worse(x, z):
                better_than += 1
            else:
                other = max(other, np.abs(x - z).max())
    return Programs(count, off, better, other, refused, better_than, residual, warm_off, most)


class Ticks(NamedTuple):
    """Results of the comparison of whole ticks."""

    ticks: int
    velocity: float
    """Largest difference of a joint velocity, in ticks with equal cost."""
    better: int
    """Number of ticks that differ by more than SAME_TICK with a cost no higher."""
    ambiguous: int
    """Number of ticks with a pair that overlaps so deeply that its direction of escape is not
    unique."""
    worse: int
    """Number of ticks with a higher cost."""
    other: float
    """Largest difference of a path speed, a twist of the reference, or a number of the status."""
    iterations: int


SAME_TICK, SAME_NUMBER = 1e-7, 1e-5


class FinestDaqp:
    """daqp as called by the Python servo, but with tolerances of rounding: its default ignores
    violations of 1e-6."""

    last = ()
    """Last solved problem."""

    @classmethod
    def solve(cls, *program):
        cls.last = tuple(part.copy() for part in program)
        return daqp.solve(*program, primal_tol=1e-12, dual_tol=1e-14, iter_limit=10000)


def pair_of_servos(name, generator, obstacles=True, **options):
    """Return the Python servo and the compiled one, with the same arm and scene."""
    arm = ArmKinematics(load_arm(name))
    model = CollisionModel(arm, tuple(surroundings(generator)) if obstacles else ())
    make_finest(model)
    weights = arm.arm.task.weights
    given = ServoOptions(**options)
    return Servo(arm, model, given, weights), CompiledServo(arm, model, given, weights)


def ticks(name, count, seed=0, per_scene=200):
    """Run random states, goals and twists through both servos."""
    with unittest.mock.patch.object(servo_module, "daqp", FinestDaqp):
        return _ticks(name, count, seed, per_scene)


def _ticks(name, count, seed, per_scene):
    generator = np.random.default_rng(seed)
    done, off, better, ambiguous, worse, other, most = 0, 0.0, 0, 0, 0, 0.0, 0
    while done < count:
        python, compiled = servos = pair_of_servos(name, generator)
        arm = python.kinematics
        for _ in range(min(per_scene, count - done)):
            q = random_joints(arm, generator)
            v = arm.velocity * generator.uniform(-1, 1, arm.joints) * generator.choice((0, 0.1, 1))
            away = generator.normal(size=(2, 3)) * generator.choice((0.0, 1e-4, 0.02))
            goal = arm.forward(q)
            goal.translation = goal.translation + away[0]
            goal.rotation = pin.exp3(away[1]) @ goal.rotation
            goal = to_pose(goal)
            twist = generator.normal(size=(2, 3)) * generator.choice((0.0, 0.1, 1.0))
            rate = None
            if generator.random() < 0.3:
                rate = generator.normal(size=arm.joints) * 0.3
            slide, policy = bool(generator.random() < 0.5), generator.choice(tuple(Policy))
            posture = None
            if generator.random() < 0.5:
                posture = q + generator.normal(size=arm.joints) * 0.5
            dt_s = float(generator.choice((0.001, 0.002, 0.004)))
            kind, failed = generator.random(), python.status().failures
            for servo in servos:
                servo.policy, servo.posture = policy, posture
                servo.place(q)
                servo.move_at(v)
                if kind < 0.8:
                    servo.tick(goal, twist, dt_s, rate, slide)
                elif kind < 0.9:
                    servo.tick_joints(q + away.ravel()[0], v, dt_s)
                else:
                    servo.brake(dt_s)
            done += 1
            apart = float(np.abs(python.v - compiled.v).max())
            if apart > SAME_TICK:
                if tick_is_no_worse(python, compiled):
                    better += 1
                elif not rows_agree(python, compiled, q):
                    ambiguous += 1
                else:
                    worse += 1
                continue
            off = max(off, apart)
            one, two = python.status(), compiled.status()
            if one.failures > failed:
                continue  # both braked: nothing else to compare
            numbers = [(a, b) for a, b in zip(one, two, strict=True) if isinstance(a, float)]
            differs = max(
                abs(python.path_speed - compiled.path_speed),
                np.abs(python.twist - compiled.twist).max() if kind < 0.8 else 0.0,
                *(abs(a - b) for a, b in numbers if a != b),
            )
            if differs > SAME_NUMBER and not rows_agree(python, compiled, q):
                ambiguous += 1
            else:
                other = max(other, differs)
        most = max(most, compiled.status().iterations)
    return Ticks(done, off, better, ambiguous, worse, other, most)


def rows_agree(python, compiled, q):
    """Return whether both have the same rows, apart from the direction out of an overlap."""
    n, pairs = python.joints, len(python.collision.pairs)
    found, rows = np.zeros(pairs), np.zeros((pairs, n))
    kernel_library().kernel_distances(
        compiled._handle, _doubles(q), _doubles(found), _doubles(rows)
    )
    apart = [np.abs(rows - row).max(axis=1).min() for row in python._rows[: python._active, :n]]
    return max(apart, default=0.0) < 1e-6


def tick_is_no_worse(python, compiled):
    """Return whether the compiled servo's velocities cost no more in the other servo's problem."""
    n = python.joints
    normal, linear, rows, highest, lowest, _ = FinestDaqp.last
    unknowns = len(linear)
    low, high = lowest[:unknowns], highest[:unknowns]
    program = Program(normal, linear, low, high, rows, lowest[unknowns:])
    speed = program.by_kernel()[0]
    speed[:n] = compiled.v
    theirs = program.by_daqp()[0]
    theirs[:n] = python.v
    return program.no_worse(speed, theirs)


def main() -> None:
    """Print the table."""
    total = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    names = arm_names()
    each = math.ceil(total / len(names))
    print("| arm | placement, Jacobian | distances | ticks | worse | most iterations |")
    print("|---|---|---|---|---|---|")
    for name in names:
        begin = time.monotonic()
        where = kinematics(name, each)
        apart = distances(name, each)
        moved = ticks(name, each)
        print(
            f"| {name} | {max(where):.1e} | {max(apart.farther, apart.nearer):.1e} m "
            f"| {moved.velocity:.1e}; {moved.better} better, {moved.ambiguous} ambiguous "
            f"| {moved.worse} | {moved.iterations} |",
            flush=True,
        )
        print(
            f"{name}: {time.monotonic() - begin:.0f} s, {where}, {apart}, {moved}", file=sys.stderr
        )
    for degenerate in (False, True):
        print(programs(total, degenerate=degenerate), flush=True)


if __name__ == "__main__":
    main()
