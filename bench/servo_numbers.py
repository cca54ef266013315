"""Accuracy of the servo: lines, walls, limits, turns, sag. Virtual time, ideal drives.

    python -m bench servo-numbers [random ticks, default 1000000]

Every row prints the aim and whether it is met; the plain damped-least-squares step runs the same
lines where possible.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from bench.arms import ACCELERATION_RAD_S2, DampedLeastSquares, kinematics
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import to_pose
from cardan.gateway.kinematics.collision import CollisionModel, box_obstacle
from cardan.gateway.motion.speed_limited_reference import Reference, ReferenceLimits
from cardan.gateway.servo.choice import AnyServo, choose_servo
from cardan.gateway.servo.options import Policy, ServoOptions
from cardan.robots import load_arm
from cardan.types import Frame, Twist, Vector3

DT_S = 0.002
RANDOM_TICKS = 1_000_000
LINE_M_S = 0.1

Array = npt.NDArray[np.float64]


class Row(NamedTuple):
    """A line of the table."""

    what: str
    found: str
    aim: str
    met: bool


class Drive:
    """A servo with a goal that advances as in a session."""

    def __init__(self, servo: AnyServo) -> None:
        self.servo = servo
        self.goal = servo.placement

    def tick(self, linear: Sequence[float], angular: Sequence[float], **how: Any) -> float:
        """Move for one period at a twist; return the path speed."""
        twist_asked = np.array((linear, angular), dtype=float)
        share = self.servo.tick(to_pose(self.goal), twist_asked, DT_S, **how)
        twist = self.servo.twist
        self.goal.translation = self.goal.translation + twist[0] * DT_S
        self.goal.rotation = pin.exp3(twist[1] * DT_S) @ self.goal.rotation
        return share


def _servo(arm: ArmKinematics, q_deg: Sequence[float] | None, **options: Any) -> AnyServo:
    collision = options.pop("collision", None)
    made = choose_servo(arm, collision, ServoOptions(**options), arm.arm.task.weights)
    made.place(np.array(arm.arm.home) if q_deg is None else np.radians(q_deg))
    return made


# ---------------------------------------------------------------------------------------------
# Lines through singularities


class Line(NamedTuple):
    """A straight line with a turn, from a given configuration."""

    name: str
    start_deg: tuple[float, ...]
    direction: Array
    turn: Array
    length_m: float


def _lines(arm: ArmKinematics) -> tuple[Line, ...]:
    def towards(start: tuple[float, ...], end: tuple[float, ...]) -> tuple[Array, Array, float]:
        a, b = arm.forward(np.radians(start)), arm.forward(np.radians(end))
        way = b.translation - a.translation
        length = float(np.linalg.norm(way))
        return way / length, pin.log3(b.rotation @ a.rotation.T), length

    def level(q: tuple[float, ...], sign: float) -> Array:
        out: Array = sign * arm.forward(np.radians(q)).translation * (1.0, 1.0, 0.0)
        return out / np.linalg.norm(out)

    flip, flipped = (0.0, -80.0, 100.0, -20.0, 20.0, 0.0), (0.0, -75.0, 95.0, -20.0, -20.0, 0.0)
    wrist, beyond = (0.0, -80.0, 100.0, -20.0, 20.0, 0.0), (4.0, -78.0, 98.0, -20.0, -20.0, 0.0)
    beside = (0.0, -60.0, 60.0, 0.0, 4.0, 0.0)
    elbow = (0.0, -60.0, 60.0, -90.0, -90.0, 0.0)
    shoulder = (0.0, -90.0, 90.0, -90.0, -90.0, 0.0)
    none = np.zeros(3)
    return (
        Line("wrist singularity", wrist, *towards(wrist, beyond)),
        Line("wrist, 40 deg in 22 mm", flip, *towards(flip, flipped)),
        Line("beside the wrist", beside, np.array((0.0, 1.0, 0.0)), none, 0.08),
        Line("elbow, out of reach", elbow, level(elbow, 1.0), none, 0.35),
        Line("shoulder axis", shoulder, level(shoulder, -1.0), none, 0.678),
    )


class Run(NamedTuple):
    """Result of a line."""

    progress: float
    seconds: float
    off_m: float
    off_rad: float
    acceleration: float
    singular_value: float


def _follow(arm: ArmKinematics, line: Line, policy: Policy | None) -> Run:
    """Run the line with Cardan's servo under `policy`, or with the plain step if it is None."""
    duration_s = line.length_m / LINE_M_S
    drive = Drive(_servo(arm, line.start_deg, policy=policy or Policy.PATH))
    plain = DampedLeastSquares(arm)
    plain.q = np.radians(line.start_deg)
    start, v = drive.servo.placement, np.zeros(arm.joints)
    goal = start.copy()
    progress_s, now_s, off_m, off_rad, fastest, smallest = 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
    while progress_s < duration_s and now_s < 3.0 * duration_s + 2.0:
        ramp = min(1.0, (now_s + DT_S) / 0.1)
        if policy is None:
            progress_s += ramp * DT_S
            goal.translation = start.translation + line.direction * LINE_M_S * progress_s
            goal.rotation = pin.exp3(line.turn * progress_s / duration_s) @ start.rotation
            before = plain.q
            plain.step(goal, DT_S)
            q, new = plain.q, (plain.q - before) / DT_S
        else:
            share = drive.tick(ramp * LINE_M_S * line.direction, ramp * line.turn / duration_s)
            progress_s += share * ramp * DT_S
            q, new = drive.servo.q, drive.servo.v.copy()
            smallest = min(smallest, drive.servo.status().smallest_singular_value)
        now_s += DT_S
        fastest, v = max(fastest, float(np.abs(new - v).max()) / DT_S), new
        here = arm.forward(q)
        away = here.translation - start.translation
        away = away - line.direction * (away @ line.direction)
        off_m = max(off_m, float(np.linalg.norm(away)))
        ideal = pin.exp3(line.turn * min(1.0, progress_s / duration_s)) @ start.rotation
        off_rad = max(off_rad, float(np.linalg.norm(pin.log3(ideal.T @ here.rotation))))
    return Run(progress_s / duration_s, now_s, off_m, off_rad, fastest, smallest)


def _singularities() -> list[Row]:
    arm = kinematics("ur5")
    rows = []
    print("\nlines at 0.1 m/s on the UR5, 500 Hz, 15 rad/s²\n")
    print(f"{'':24}{'':12}{'progress':>9}{'time s':>8}{'off mm':>8}{'off deg':>9}{'rad/s²':>9}")
    for line in _lines(arm):
        for name, policy in (("path", Policy.PATH), ("reach", Policy.REACH), ("plain DLS", None)):
            run = _follow(arm, line, policy)
            print(
                f"{line.name:24}{name:12}{min(1.0, run.progress) * 100:8.0f}%{run.seconds:8.2f}"
                f"{run.off_m * 1e3:8.2f}{math.degrees(run.off_rad):9.2f}{run.acceleration:9.1f}"
            )
            if line.name == "wrist singularity" and policy is Policy.PATH:
                good = (
                    run.progress >= 1.0
                    and run.off_m <= 3e-3
                    and math.degrees(run.off_rad) <= 1.0
                    and run.acceleration <= ACCELERATION_RAD_S2 * (1 + 1e-6)
                    and run.singular_value < 1e-2
                )
                rows.append(
                    Row(
                        "wrist singularity at 0.1 m/s",
                        f"passed, {run.off_m * 1e3:.2f} mm, {math.degrees(run.off_rad):.2f} deg, "
                        f"{run.acceleration:.1f} rad/s²",
                        "passed, 3 mm, 1 deg, 15 rad/s²",
                        good,
                    )
                )
    return rows


# ---------------------------------------------------------------------------------------------
# A wall of 5 mm


def _walls() -> list[Row]:
    start = (0.0, -90.0, 100.0, -100.0, -90.0, 0.0)
    arm = kinematics("ur5")
    x = float(arm.forward(np.radians(start)).translation[0]) + 0.25
    wall = box_obstacle("wall", Vector3(x, -0.5, -0.2), Vector3(x + 0.005, 0.5, 1.2))
    clearance, slide, retreat = math.inf, math.inf, math.inf
    for speed in (0.1, 0.25, 0.5, 1.0):
        for policy in Policy:
            collision = CollisionModel(arm, (wall,))
            servo = _servo(arm, start, policy=policy, collision=collision)
            safety = servo.options.safety_distance_m
            ours = [i for i, pair in enumerate(collision.pairs) if "wall" in pair]
            drive = Drive(servo)
            for i in range(round((0.5 + 0.4 / speed) / DT_S)):
                drive.tick((min(speed, 2.0 * i * DT_S), 0, 0), (0, 0, 0), slide=True)
                distances = collision.at(servo.q)
                clearance = min(clearance, *(distances[i] / safety for i in ours))
            begin = servo.placement.translation.copy()
            for _ in range(500):
                drive.tick((0.1, 0.1, 0), (0, 0, 0), slide=True)
                distances = collision.at(servo.q)
                clearance = min(clearance, *(distances[i] / safety for i in ours))
            slide = min(slide, (servo.placement.translation - begin)[1] / 0.1)
            begin = servo.placement.translation.copy()
            for _ in range(250):
                drive.tick((-0.1, 0, 0), (0, 0, 0), slide=True)
            retreat = min(retreat, (begin - servo.placement.translation)[0] / 0.05)
    return [
        Row(
            "5 mm wall, 0.1 to 1 m/s: clearance",
            f"{clearance * 100:.1f} % of 10 mm",
            ">= 90 %",
            clearance >= 0.9,
        ),
        Row("  retreat", f"{retreat * 100:.1f} % of commanded", ">= 95 %", retreat >= 0.95),
        Row("  sliding", f"{slide * 100:.1f} % of tangential", ">= 95 %", slide >= 0.95),
    ]


# ---------------------------------------------------------------------------------------------
# Joints


def _random_ticks(ticks: int) -> Row:
    overshoot, failures, short, fastest = 0.0, 0, 0.0, 0.0
    names = ("ur5", "gofa_crb15000_5", "pr2_right_arm", "asibot")
    for name in names:
        arm = kinematics(name)
        servo = _servo(arm, None)
        drive, generator = Drive(servo), np.random.default_rng(0)
        linear = angular = rate = np.zeros(3)
        for i in range(ticks // len(names)):
            if i % 250 == 0:
                scale = generator.choice((0.1, 1.0, 5.0))
                linear, angular = generator.normal(size=(2, 3)) * scale
                rate = generator.normal(size=arm.joints) * generator.choice((0.0, 1.0, 5.0))
                servo.policy = generator.choice(tuple(Policy))
            if i % 50 == 0:
                drive.goal = servo.placement
            before = servo.v.copy()
            drive.tick(linear, angular, joint_rate=rate)
            overshoot = max(overshoot, float((servo.q - arm.upper).max()))
            overshoot = max(overshoot, float((arm.lower - servo.q).max()))
            fastest = max(fastest, float(np.abs(servo.v - before).max()) / DT_S)
        failures += servo.status().failures
        bounded = ~arm.continuous
        for end in (arm.upper, arm.lower):
            goal = np.where(bounded, end, servo.q)
            for _ in range(round(2.5 * float((arm.upper - arm.lower)[bounded].max()) / DT_S / 1.0)):
                servo.tick_joints(goal, np.zeros(arm.joints), DT_S)
                overshoot = max(overshoot, float((servo.q - arm.upper)[bounded].max()))
                overshoot = max(overshoot, float((arm.lower - servo.q)[bounded].max()))
                if not servo.moving and np.abs(goal - servo.q)[bounded].max() < 1e-6:
                    break
            short = max(short, float(np.abs(goal - servo.q)[bounded].max()))
    return Row(
        f"joint limits, {ticks:,} random ticks",
        f"overshoot {max(0.0, overshoot):.1e} rad, {short:.0e} rad of the range unused, "
        f"{failures} infeasible, {fastest:.3f} rad/s²",
        "1e-5 rad, all, 0, 15 rad/s²",
        overshoot <= 1e-5
        and short <= 1e-4
        and failures == 0
        and fastest <= ACCELERATION_RAD_S2 * (1 + 1e-6),
    )


def _turns() -> Row:
    refused, done = 0, []
    for sign in (1.0, -1.0):
        arm = kinematics("pr2_right_arm")
        servo = _servo(arm, None)
        drive, turned = Drive(servo), 0.0
        axis = servo.placement.rotation @ (1.0, 0.0, 0.0)
        ramp_s = 0.3
        for i in range(round((10.0 * 2.0 * math.pi / 3.0 + 0.5 * ramp_s) / DT_S)):
            speed = sign * 3.0 * min(1.0, (i + 1) * DT_S / ramp_s)
            before = servo.placement.rotation
            refused += drive.tick((0, 0, 0), speed * axis) < 0.9
            turned += float(pin.log3(servo.placement.rotation @ before.T) @ axis)
        done.append(turned / (2.0 * math.pi))
    return Row(
        "continuous wrist, 10 turns each way",
        f"{done[0]:+.2f} and {done[1]:+.2f} turns, {refused} ticks held",
        "10, 0 refusals",
        refused == 0 and min(abs(turns) for turns in done) > 9.9,
    )


def _sag() -> Row:
    """Sag: the measured arm hangs 1 degree low in every joint; the commanded position must not
    sink."""
    arm = kinematics("ur5")
    servo = _servo(arm, None)
    reference = Reference(ReferenceLimits(max_lead_m=0.2))
    offset = np.full(arm.joints, math.radians(1.0))
    reference.place(to_pose(servo.placement))
    height = servo.placement.translation[2]
    drift = 0.0
    for i in range(round(60.0 / DT_S)):
        reference.observe(to_pose(arm.forward(servo.q - offset)))
        speed = 0.05 * math.sin(2.0 * math.pi * i * DT_S / 6.0)
        reference.shape(Twist(Vector3(speed, 0.0, 0.0), Vector3(0.0, 0.0, 0.0), Frame.BASE), DT_S)
        twist = np.array((reference.linear, reference.angular))
        servo.tick(reference.pose, twist, DT_S)
        reference.move(Vector3(*servo.twist[0]), Vector3(*servo.twist[1]), DT_S)
        drift = max(drift, abs(float(servo.placement.translation[2] - height)))
    return Row(
        "sag: 1 deg offset, 60 s of x motion",
        f"z drift {drift * 1e3:.4f} mm",
        "<= 0.1 mm",
        drift <= 1e-4,
    )


def _clutch() -> Row:
    """Re-engagement at any position, also outside the limits: no step in the command."""
    arm = ArmKinematics(load_arm("ur5"))
    servo, generator, worst = _servo(arm, None), np.random.default_rng(7), 0.0
    span = arm.upper - arm.lower
    for _ in range(1000):
        q = generator.uniform(arm.lower - 0.02 * span, arm.upper + 0.02 * span)
        servo.place(q)
        reference = to_pose(servo.placement)
        servo.tick(reference, np.zeros((2, 3)), DT_S)
        worst = max(worst, float(np.abs(servo.q - q).max()))
    return Row("re-clutch x 1000", f"largest step {worst:.1e} rad", "<= 1e-6 rad", worst <= 1e-6)


def main() -> None:
    """Print the table."""
    arguments = [word for word in sys.argv[1:] if word.isdecimal()]
    ticks = int(arguments[0]) if arguments else RANDOM_TICKS
    rows = [*_singularities(), *_walls(), _random_ticks(ticks), _turns(), _sag(), _clutch()]
    print(
        "\n"
        + "\n".join(
            f"{row.what:36} {row.found}\n{'':36} aim {row.aim}: {'met' if row.met else 'MISSED'}"
            for row in rows
        )
    )


if __name__ == "__main__":
    main()
