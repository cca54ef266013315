"""Motion of the simulated UR controller, frame by frame, in virtual time."""

import math
import random

import numpy as np
import pytest

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.protocols.ur.states import RobotMode, RuntimeState, SafetyMode
from cardan.robots import load_arm
from cardan.sim_peers.ur_controller import UrController, UrControllerOptions
from cardan.sim_peers.ur_controller.actions import Sleep
from cardan.sim_peers.ur_controller.dynamics import ROTORS_KG_M2
from cardan.sim_peers.ur_controller.kinematics import frame_of, pose_of
from cardan.sim_peers.ur_controller.motion import UrControlMode
from cardan.sim_peers.ur_controller.motion_functions import motion_functions
from cardan.sim_peers.ur_controller.pose_functions import pose_functions
from cardan.sim_peers.ur_controller.telemetry import Telemetry
from cardan.sim_peers.ur_controller.values import UrPose
from cardan.spatial import (
    compose,
    conjugate,
    cross,
    inverse,
    norm,
    rotate,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import Vector3

HOME = (0.0, -1.5707963267948966, 1.5707963267948966, -1.5707963267948966, -1.5707963267948966, 0.0)
CLOSE = 1e-6


class Arm:
    """Controller whose program is a list of calls."""

    def __init__(self, slider=1.0, **options):
        self.controller = UrController(UrControllerOptions(running=True, **options))
        self.motion = self.controller.motion
        self.dt_s = self.controller.period_s
        self.slider = slider
        self.frames = []
        """(target_q, target_qd, target_qdd, TCP) of each frame."""
        self.why = ""

    def call(self, name, *given, **named):
        function = self.controller.functions[name]
        values = {**function.defaults, **dict(zip(function.parameters, given, strict=False))}
        values.update(named)
        return function.do(*(values[parameter] for parameter in function.parameters))

    def frame(self, action=None):
        self.why = self.motion.step(action, self.dt_s, self.slider)
        motion = self.motion
        tip = motion.target_tcp_pose()
        self.frames.append(
            (list(motion.target_q), list(motion.target_qd), list(motion.target_qdd), tip)
        )
        return self.why

    def do(self, name, *given, most_s=60.0, **named):
        """Run a call until the program would continue; return its duration."""
        action, count = self.call(name, *given, **named), 0
        while action is not None:
            count += 1
            assert count * self.dt_s < most_s
            if self.frame(action):
                break
            action = self.motion.left_of(action, self.dt_s)
        return count * self.dt_s

    def wait(self, seconds):
        for _ in range(round(seconds / self.dt_s)):
            if self.frame(Sleep(seconds)):
                break
        return self

    def pose(self, x=0.0, y=0.0, z=0.0, turn=(0.0, 0.0, 0.0)):
        """Return a pose at this offset from the TCP."""
        here = frame_of(self.motion.target_tcp_pose())
        moved = here._replace(
            position=type(here.position)(
                *(a + b for a, b in zip(here.position, (x, y, z), strict=True))
            )
        )
        return pose_of(compose(moved, frame_of((0.0, 0.0, 0.0, *turn))))

    @property
    def q(self):
        return np.array([frame[0] for frame in self.frames])

    @property
    def qd(self):
        return np.array([frame[1] for frame in self.frames])

    @property
    def tips(self):
        return np.array([frame[3][:3] for frame in self.frames])

    def tool(self):
        """Return the TCP's speeds and accelerations between frames."""
        speeds = np.diff(self.tips, axis=0) / self.dt_s
        return (
            np.linalg.norm(speeds, axis=1),
            np.linalg.norm(np.diff(speeds, axis=0), axis=1) / self.dt_s,
        )

    def check_joints(self, v, a):
        """Assert that speeds and accelerations are the derivatives of the positions, and within the
        limits."""
        q, qd = self.q, self.qd
        assert np.diff(q, axis=0) / self.dt_s == pytest.approx(qd[1:], abs=1e-9)
        assert np.diff(qd, axis=0) / self.dt_s == pytest.approx(
            np.array([frame[2] for frame in self.frames])[1:], abs=1e-6
        )
        assert np.abs(qd).max() <= v + CLOSE
        assert np.abs(np.diff(qd, axis=0)).max() / self.dt_s <= a + CLOSE


@pytest.fixture
def arm():
    return Arm()


def same(pose, other, tolerance=1e-9):
    """Return whether two poses are equal; a rotation by pi has two rotation vectors."""
    a, b = frame_of(pose), frame_of(other)
    apart = norm(subtract(a.position, b.position))
    return (
        apart < tolerance and norm(rotation_between(a.orientation, b.orientation)) < 10 * tolerance
    )


def trapezoid(length, v, a):
    """Return the duration of a move."""
    return length / v + v / a if length * a > v * v else 2.0 * math.sqrt(length / a)


# -- kinematics ------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["ur5", "ur5e"])
def test_the_inverse_finds_the_joints_that_the_forward_came_from(robot):
    arm = Arm(robot=robot)
    made = np.random.default_rng(5)
    tcp = frame_of((0.01, -0.02, 0.15, 0.3, -0.2, 0.5))
    for q in made.uniform(-3.0, 3.0, (300, 6)):
        goal = arm.motion.kinematics.forward(q, tcp)
        found = arm.motion.kinematics.inverse(goal, q + made.uniform(-1e-3, 1e-3, 6), tcp)
        assert found == pytest.approx(q, abs=1e-7)
        far = arm.motion.kinematics.inverse(goal, made.uniform(-6.0, 6.0, 6), tcp)
        there = arm.motion.kinematics.forward(far, tcp)
        assert norm(subtract(there.position, goal.position)) < 1e-9
        assert norm(rotation_between(there.orientation, goal.orientation)) < 1e-7


def test_the_jacobian_is_that_of_the_model():
    arm, model = Arm(), ArmKinematics(load_arm("ur5e"))
    for q in np.random.default_rng(7).uniform(-3.0, 3.0, (5, 6)):
        step, columns = 1e-6, []
        for joint in range(6):
            moved = np.array(q)
            moved[joint] += step
            columns.append((model.forward(moved).translation - model.forward(q).translation) / step)
        rows = np.array(arm.call("get_jacobian", q.tolist()))[:3]
        # The model's base is rotated by pi from the controller's.
        assert rows == pytest.approx(np.diag([-1.0, -1.0, 1.0]) @ np.array(columns).T, abs=1e-5)


def test_functions_of_kinematics(arm):
    here = arm.call("get_forward_kin")
    assert isinstance(here, UrPose)
    assert here == pytest.approx(arm.call("get_actual_tcp_pose"))
    q = arm.call("get_inverse_kin", here, [0.1, -1.5, 1.5, -1.5, -1.5, 0.1])
    assert q == pytest.approx(HOME, abs=1e-9)
    far = UrPose((3.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert not arm.call("get_inverse_kin_has_solution", far)
    assert arm.call("get_inverse_kin_has_solution", here)
    with pytest.raises(ValueError, match=r"no joints have the TCP at p\[3, 0, 0"):
        arm.call("get_inverse_kin", far)
    assert arm.call("is_within_safety_limits", here)
    assert not arm.call("is_within_safety_limits", far)
    assert not arm.call("is_within_safety_limits", [7.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    arm.call("set_tcp", UrPose((0.0, 0.0, 0.1, 0.0, 0.0, 0.0)))
    assert arm.call("get_tcp_offset") == (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
    lower = arm.call("get_actual_tcp_pose")
    assert lower[2] == pytest.approx(here[2] - 0.1)
    assert arm.call("get_actual_tool_flange_pose") == pytest.approx(here)
    assert arm.call("get_forward_kin", list(HOME), tcp=UrPose((0.0,) * 6)) == pytest.approx(here)
    assert arm.call("get_inverse_kin", lower) == pytest.approx(HOME, abs=1e-9)


def test_functions_of_poses(arm):
    a, b = UrPose((0.1, 0.2, 0.3, 0.4, -0.5, 0.6)), UrPose((-0.3, 0.1, 0.2, 0.0, 0.7, -0.2))
    both = arm.call("pose_trans", a, b)
    assert arm.call("pose_trans", arm.call("pose_inv", a), both) == pytest.approx(b)
    assert arm.call("inv", a) == arm.call("pose_inv", a)
    assert arm.call("pose_add", arm.call("pose_sub", a, b), b) == pytest.approx(a)
    assert arm.call("point_dist", a, b) == pytest.approx(math.sqrt(0.16 + 0.01 + 0.01))
    assert arm.call("pose_dist", a, a) == pytest.approx(0.0, abs=1e-12)
    assert arm.call("interpolate_pose", a, b, 0.0) == pytest.approx(a)
    assert arm.call("interpolate_pose", a, b, 1.0) == pytest.approx(b)
    rpy = arm.call("rotvec2rpy", list(a[3:]))
    assert arm.call("rpy2rotvec", rpy) == pytest.approx(a[3:])
    assert arm.call("rpy2rotvec", [0.0, 0.0, 1.0]) == pytest.approx([0.0, 0.0, 1.0])
    lifted = arm.call("wrench_trans", UrPose((0.0, 0.0, 0.1, 0.0, 0.0, 0.0)), [1.0, 0, 0, 0, 0, 0])
    assert lifted == pytest.approx([1.0, 0.0, 0.0, 0.0, -0.1, 0.0])


# -- moves -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("robot", "v", "a"), [("ur5e", 1.05, 1.4), ("ur5", 0.5, 3.0)])
def test_movej_is_a_trapezoid_that_all_joints_end_together(robot, v, a):
    arm = Arm(robot=robot)
    goal = [1.2, -1.2, 1.0, -1.4, -1.9, 0.4]
    took_s = arm.do("movej", goal, a, v)
    assert took_s == pytest.approx(trapezoid(1.2, v, a), abs=arm.dt_s)
    assert arm.motion.target_q == goal
    arm.wait(arm.dt_s)
    assert not arm.motion.moving
    arm.check_joints(v, a)
    shares = (arm.q - HOME) / (np.array(goal) - HOME)
    assert shares == pytest.approx(np.repeat(shares[:, :1], 6, axis=1), abs=1e-9)
    assert arm.qd.max() == pytest.approx(v)


def test_a_time_takes_the_place_of_speed_and_acceleration(arm):
    assert arm.do("movej", [1.0, *HOME[1:]], a=0.1, v=0.1, t=2.0) == pytest.approx(2.0, abs=0.002)
    pose = arm.pose(y=0.2)
    assert arm.do("movel", pose, t=1.5) == pytest.approx(1.5, abs=0.002)
    assert same(arm.motion.target_tcp_pose(), pose)


def test_movej_to_a_pose_and_to_where_the_arm_is(arm):
    pose = arm.pose(z=-0.1)
    arm.do("movej", pose)
    assert same(arm.motion.target_tcp_pose(), pose)
    assert arm.do("movej", list(arm.motion.target_q)) == pytest.approx(arm.dt_s)
    assert arm.do("movel", arm.motion.target_tcp_pose()) == pytest.approx(arm.dt_s)


@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
def test_movel_is_straight(robot):
    arm = Arm(robot=robot)
    start = np.array(arm.motion.target_tcp_pose()[:3])
    goal = arm.pose(0.1, 0.25, -0.15, turn=(0.2, 0.1, 0.4))
    took_s = arm.do("movel", goal, 1.2, 0.25)
    way = np.array(goal[:3]) - start
    length = np.linalg.norm(way)
    assert took_s == pytest.approx(trapezoid(length, 0.25, 1.2), abs=arm.dt_s)
    assert same(arm.motion.target_tcp_pose(), goal)
    aside = np.cross(arm.tips - start, way / length)
    assert np.linalg.norm(aside, axis=1).max() < 1e-4
    speeds, accelerations = arm.tool()
    assert speeds.max() <= 0.25 + CLOSE
    assert accelerations.max() <= 1.2 + CLOSE


def test_movel_to_joints_and_movep(arm):
    goal = [0.3, -1.4, 1.4, -1.5, -1.6, 0.2]
    arm.do("movel", goal)
    assert arm.motion.target_q == pytest.approx(goal, abs=1e-9)
    assert arm.do("movep", arm.pose(z=0.1)) == pytest.approx(trapezoid(0.1, 0.25, 1.2), abs=0.002)


@pytest.mark.parametrize("mode", [0, 1])
def test_movec_stays_on_its_circle(mode, arm):
    start = np.array(arm.motion.target_tcp_pose()[:3])
    center = start + np.array([0.0, 0.1, 0.0])
    begin = frame_of(arm.motion.target_tcp_pose())
    took_s = arm.do("movec", arm.pose(0.1, 0.1), arm.pose(0.0, 0.2), 1.2, 0.25, 0, mode)
    along = 1.2 * math.sqrt(0.5)
    assert took_s == pytest.approx(trapezoid(0.1 * math.pi, 0.25, along), abs=0.002)
    speeds, accelerations = arm.tool()
    assert speeds.max() <= 0.25 + CLOSE
    assert accelerations.max() <= 1.2 + CLOSE
    assert np.linalg.norm(arm.tips - center, axis=1) == pytest.approx(0.1, abs=1e-6)
    assert arm.tips[:, 2] == pytest.approx(start[2], abs=1e-9)
    assert arm.tips[:, 0].max() == pytest.approx(start[0] + 0.1, abs=1e-4)
    end = frame_of(arm.motion.target_tcp_pose())
    turned = norm(rotation_between(begin.orientation, end.orientation))
    assert turned == pytest.approx(math.pi if mode else 0.0, abs=1e-9)
    assert arm.tips[-1] == pytest.approx(start + np.array([0.0, 0.2, 0.0]), abs=1e-9)


def test_a_speed_for_a_time_needs_no_acceleration_and_hardly_a_time(arm):
    motion = arm.motion
    speeds = {
        "speedj": ([0.1, 0, 0, 0, 0, 0], lambda: motion.target_qd),
        "speedl": ([0, 0, 0.02, 0, 0, 0], motion.target_tcp_speed),
    }
    for name, (speed, speed_now) in speeds.items():
        arm.do(name, speed, 1.0)
        for a, t in ((0.0, 0.002), (0, 0.1), (1e-14, 0.002), (1.0, 1e-15)):
            assert arm.do(name, speed, a, t) == pytest.approx(max(t, arm.dt_s))
        assert list(speed_now()) == pytest.approx(speed, abs=1e-3)
        arm.do(name, [0] * 6, 0.0, 0.002)
        assert motion.moving
        for a, t in ((0.0, 0.0), (-1.0, 0.1), (1.0, -1e-15)):
            with pytest.raises(ValueError, match=r"(a|t) is .*(not above|below) 0"):
                arm.call(name, speed, a, t)
        arm.do("stopj", 2.0)


def test_optimal_moves_take_shares_of_what_the_joints_are_able_to(arm):
    speeds = load_arm("ur5e").velocity
    goal = (HOME[0] + 2.0, *HOME[1:5], HOME[5] + 1.0)
    slow_s = arm.do("optimovej", list(goal))
    assert arm.motion.target_q == pytest.approx(goal)
    assert np.abs(arm.qd).max(axis=0)[0] == pytest.approx(0.3 * speeds[0])
    arm.frames.clear()
    assert arm.do("optimovej", list(HOME), 1.0, 1.0) < slow_s
    assert np.abs(arm.qd).max(axis=0)[0] == pytest.approx(speeds[0], rel=0.05)
    there = arm.pose(y=0.2, z=-0.1)
    for share in (0.5, 1.0):
        arm.frames.clear()
        arm.do("optimovel", there, v=share, a=share)
        assert not arm.why
        assert same(arm.motion.target_tcp_pose(), there)
        assert np.all(np.abs(arm.qd).max(axis=0) <= 1.05 * share * np.array(speeds))
        there = arm.pose()
        arm.do("optimovel", list(HOME), r=0.01)
        arm.wait(1.0)
        assert same(arm.motion.target_tcp_pose(), arm.call("get_forward_kin", list(HOME)))
    assert arm.do("optimovel", arm.pose()) == arm.dt_s
    assert arm.do("optimovej", list(HOME)) == arm.dt_s


def test_an_optimal_move_refuses_what_is_no_share(arm):
    for name, value in (("a", 1.1), ("v", 0.0), ("v", -0.1), ("r", -1.0)):
        for function in ("optimovej", "optimovel"):
            with pytest.raises(ValueError, match=f"{name} is"):
                arm.call(function, list(HOME), **{name: value})
    for function in ("optimovej", "optimovel"):
        with pytest.raises(ValueError, match="goal is box"):
            arm.call(function, "box")
    why = "no joints have the TCP"
    with pytest.raises(ValueError, match=why):
        arm.call("optimovej", arm.pose(x=3.0))
    arm.frame(arm.call("optimovel", arm.pose(x=3.0)))
    assert "out of the arm's reach" in arm.why


def test_a_mode_that_was_computed_is_a_whole_number(arm):
    wanted = arm.call("movec", arm.pose(0.1, 0.1), arm.pose(0.0, 0.2), mode=1)
    assert arm.call("movec", arm.pose(0.1, 0.1), arm.pose(0.0, 0.2), mode=3.0 / 3) == wanted
    force = (UrPose((0.0,) * 6), [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0])
    arm.call("force_mode", *force, 6.0 / 3, [0.1] * 6)
    assert arm.motion.force.asked.kind == 2
    for kind in (0.5, 4.0, True, [1]):
        with pytest.raises(ValueError, match=r"type is 4|not a whole number"):
            arm.call("force_mode", *force, kind, [0.1] * 6)


def test_movec_through_points_on_a_line_is_a_line(arm):
    goal = arm.pose(y=0.2)
    arm.do("movec", arm.pose(y=0.1), goal)
    assert same(arm.motion.target_tcp_pose(), goal)


def test_the_waypoint_is_known_while_the_arm_is_on_its_way(arm):
    assert arm.call("get_target_waypoint") == arm.call("get_target_tcp_pose")
    goal = arm.pose(y=0.2)
    action = arm.call("movel", goal)
    arm.frame(action)
    assert arm.call("get_target_waypoint") == pytest.approx(goal)
    while arm.motion.left_of(action, arm.dt_s):
        arm.frame(action)
    assert arm.call("get_target_waypoint") == arm.call("get_target_tcp_pose")


# -- blends ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 45.0, 90.0, 150.0, 180.0])
def test_a_blend_of_lines_goes_on_without_rest(angle):
    arm, a, v, r = Arm(), 1.2, 0.25, 0.05
    first = arm.pose(y=0.2)
    arm.do("movel", first, a, v, r=r)
    corner = np.array(first[:3])
    assert np.linalg.norm(arm.tips[-1] - corner) == pytest.approx(r, abs=1e-3)
    radians = math.radians(angle)
    way = 0.2 * np.array([math.sin(radians), math.cos(radians), 0.0])
    second = UrPose((*(corner + way).tolist(), *first[3:]))
    arm.do("movel", second, a, v)
    assert arm.tips[-1] == pytest.approx(second[:3], abs=1e-9)
    speeds, accelerations = arm.tool()
    assert speeds.max() <= v + CLOSE
    assert accelerations.max() <= a + CLOSE
    if angle < 120.0:
        assert speeds[50:-50].min() > 0.1
    off = np.linalg.norm(arm.tips - corner, axis=1)
    assert off.min() < r


def test_a_blend_of_joint_moves_goes_on_without_rest():
    arm, a, v = Arm(), 1.4, 1.05
    first = [0.6, -1.2, 1.4, -1.6, -1.5, 0.2]
    arm.do("movej", first, a, v, r=0.08)
    assert arm.motion.moving
    arm.do("movej", [1.2, -1.6, 1.5, -1.5, -1.6, 0.0], a, v)
    assert arm.motion.target_q == [1.2, -1.6, 1.5, -1.5, -1.6, 0.0]
    arm.check_joints(v, a)
    assert np.abs(arm.qd[50:-50]).max(axis=1).min() > 0.1


@pytest.mark.parametrize("order", ["jl", "lj", "lcl", "jlj", "lllj"])
def test_moves_of_all_kinds_blend(order, arm):
    sideways = 1
    for number, kind in enumerate(order):
        last = number == len(order) - 1
        r = 0.0 if last else 0.03
        if kind == "l":
            goal = frame_of(arm.call("get_target_waypoint"))
            goal = pose_of(goal)
            goal = UrPose((goal[0], goal[1] + 0.1, goal[2] - 0.08 * sideways, *goal[3:]))
            arm.do("movel", goal, r=r)
        elif kind == "c":
            at = arm.call("get_target_waypoint")
            via = UrPose((at[0] + 0.05, at[1] + 0.05, *at[2:]))
            goal = UrPose((at[0], at[1] + 0.1, *at[2:]))
            arm.do("movec", via, goal, r=r)
        else:
            q = list(arm.motion.target_q)
            q[0] += 0.5
            q[2] -= 0.2 * sideways
            arm.do("movej", q, r=r)
        assert not arm.why
        sideways = -sideways
    arm.wait(0.1)
    assert not arm.motion.moving
    # Speed is continuous: each frame changes it by no more than a blend of joints and lines can
    # need.
    assert np.abs(np.diff(arm.qd, axis=0)).max() < 0.03
    assert np.diff(arm.q, axis=0) / arm.dt_s == pytest.approx(arm.qd[1:], abs=1e-9)


def test_a_move_whose_successor_never_comes_stops_at_its_waypoint():
    for end in (Sleep(1.0), None):
        arm = Arm()
        goal = arm.pose(y=0.2)
        arm.do("movel", goal, r=0.05)
        assert arm.motion.moving
        for _ in range(500):
            arm.frame(end)
        assert same(arm.motion.target_tcp_pose(), goal)
        assert not arm.motion.moving
        _, accelerations = arm.tool()
        assert accelerations.max() <= 1.2 + CLOSE


def test_a_successor_that_comes_late_is_blended_with_what_is_left(arm):
    first = arm.pose(y=0.2)
    second = arm.pose(y=0.2, z=0.1)
    arm.do("movel", first, r=0.05)
    arm.wait(0.15)
    arm.do("movel", second)
    assert same(arm.motion.target_tcp_pose(), second)
    _, accelerations = arm.tool()
    assert accelerations.max() <= 1.2 + CLOSE


def test_blends_that_overlap_skip_the_move(arm):
    start = arm.motion.target_tcp_pose()
    points = [UrPose((start[0], start[1] + y, *start[2:])) for y in (0.2, 0.25, 0.45)]
    arm.do("movel", points[0], r=0.05)
    assert arm.do("movel", points[1], r=0.05) == pytest.approx(arm.dt_s)
    assert any(b"Overlapping Blends" in message for message in arm.controller.messages)
    arm.do("movel", points[2])
    assert same(arm.motion.target_tcp_pose(), points[2])
    _, accelerations = arm.tool()
    assert accelerations.max() <= 1.2 + CLOSE


def test_many_short_blends(arm):
    start, made = arm.motion.target_tcp_pose(), random.Random(4)
    for _ in range(25):
        way = [made.uniform(-0.15, 0.15) for _ in range(3)]
        goal = UrPose((*(a + b for a, b in zip(start[:3], way, strict=True)), *start[3:]))
        arm.do("movel", goal, r=made.choice([0.0, 0.01, 0.03]))
        assert not arm.why
    arm.wait(1.0)
    speeds, accelerations = arm.tool()
    assert speeds.max() <= 0.25 + CLOSE
    assert accelerations.max() <= 1.2 + CLOSE


# -- the slider, pauses, stops ---------------------------------------------------------------------


def test_the_slider_scales_moves():
    fast, slow = Arm(), Arm(slider=0.5)
    goal = [1.0, *HOME[1:]]
    assert slow.do("movej", goal) == pytest.approx(2.0 * fast.do("movej", goal), abs=0.003)
    assert np.abs(slow.qd).max() == pytest.approx(0.525)
    assert slow.motion.target_q == goal


def test_a_slider_that_is_moved_makes_no_leap(arm):
    action = arm.call("movel", arm.pose(y=0.3))
    for slider in (1.0, 0.2, 1.0):
        arm.slider = slider
        for _ in range(150):
            arm.frame(action)
    speeds, accelerations = arm.tool()
    assert speeds[280:298] == pytest.approx(0.05, abs=1e-3)
    assert accelerations.max() <= 1.2 + 0.25 * 4.0 + CLOSE


def test_a_pause_rests_on_the_path_and_goes_on(arm):
    start, goal = arm.motion.target_tcp_pose(), arm.pose(y=0.3)
    action = arm.call("movel", goal)
    for _ in range(300):
        arm.frame(action)
    for _ in range(200):
        arm.frame(None)
    assert not arm.motion.moving
    while action is not None:
        arm.frame(action)
        action = arm.motion.left_of(action, arm.dt_s)
    assert same(arm.motion.target_tcp_pose(), goal)
    assert arm.tips[:, 0] == pytest.approx(start[0], abs=1e-9)
    assert arm.tips[:, 2] == pytest.approx(start[2], abs=1e-9)


def test_a_pause_within_a_blend_rests_there_and_goes_on_to_the_next_move(arm):
    first, second = arm.pose(y=0.2), arm.pose(y=0.2, z=0.2)
    arm.do("movel", first, r=0.08)
    arm.motion.paused = True
    for _ in range(200):
        arm.frame(None)
    assert not arm.motion.moving
    assert not same(arm.motion.target_tcp_pose(), first, 0.01)
    arm.motion.paused = False
    resumed = len(arm.frames)
    arm.do("movel", second)
    assert same(arm.motion.target_tcp_pose(), second)
    speeds = np.diff(arm.tips[resumed - 2 :], axis=0) / arm.dt_s
    # The speed recovers within 0.25 s, in addition to the changes of the blend.
    most = 1.2 + 0.25 * 4.0
    assert np.linalg.norm(np.diff(speeds, axis=0), axis=1).max() <= most * arm.dt_s


def test_what_is_left_of_a_blend_ends_with_a_stop():
    controller = UrController(UrControllerOptions(running=True))
    controller.upload("def test():\n  movel([0.6, -1.5, 1.5, -1.5, -1.5, 0], r=0.05)\nend\n")
    now_s = 0.0
    while not controller.motion.moving or controller.has_program:
        now_s += controller.period_s
        controller.advance(now_s)
        assert now_s < 10.0
    at = list(controller.motion.target_q)
    controller.emergency_stop()
    for _ in range(500):
        now_s += controller.period_s
        controller.advance(now_s)
    assert not controller.motion.moving
    assert controller.motion.target_q[0] < 0.58
    assert controller.motion.target_q == pytest.approx(at, abs=0.02)


def test_telemetry_follows_the_motion():
    controller = UrController(UrControllerOptions(running=True))
    telemetry = Telemetry(controller)
    controller.functions["set_tcp"].do(UrPose((0.0, 0.0, 0.1, 0.0, 0.0, 0.0)), "")
    controller.functions["set_payload"].do(1.25, [0.0, 0.0, 0.05])
    action = controller.functions["movej"].do([1.0, *HOME[1:]], 1.4, 1.05, 0, 0)
    poses = []
    for _ in range(100):
        controller.motion.step(action, 0.002, 1.0)
        poses.append(telemetry.value("target_TCP_pose")[:3])
    assert telemetry.value("target_qdd")[0] == pytest.approx(1.4)
    assert telemetry.value("tcp_offset") == (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
    assert telemetry.value("payload") == 1.25
    assert telemetry.value("payload_cog") == (0.0, 0.0, 0.05)
    moved = (np.array(poses[-1]) - poses[-2]) / 0.002
    assert telemetry.value("target_TCP_speed")[:3] == pytest.approx(moved, abs=2e-3)
    assert telemetry.value("actual_TCP_speed")[5] == pytest.approx(0.28, abs=0.02)


def test_a_move_begins_at_rest_where_none_has_a_blend(arm):
    arm.do("speedj", [0.5, 0, 0, 0, 0, 0], 2.0, 0.5)
    arm.do("movej", list(HOME))
    assert arm.motion.target_q == list(HOME)
    assert np.abs(np.diff(arm.qd, axis=0)).max() <= 15.0 * arm.dt_s + CLOSE


def test_speedl_and_stopl(arm):
    start = np.array(arm.motion.target_tcp_pose()[:3])
    arm.do("speedl", [0.0, 0.1, -0.05, 0.0, 0.0, 0.2], 0.5, 0.6, 0.8)
    assert arm.call("get_target_tcp_speed") == pytest.approx(
        (0.0, 0.1, -0.05, 0.0, 0.0, 0.2), abs=1e-3
    )
    took_s = arm.do("stopl", 0.8)
    assert took_s == pytest.approx(0.2 / 0.8, abs=0.003)
    assert not arm.motion.moving
    speeds, accelerations = arm.tool()
    assert accelerations.max() <= 0.8 + CLOSE
    assert speeds.max() <= math.hypot(0.1, 0.05) + CLOSE
    way = np.array([0.0, 0.1, -0.05]) / math.hypot(0.1, 0.05)
    assert np.linalg.norm(np.cross(arm.tips - start, way), axis=1).max() < 1e-6


def test_speedl_without_a_time_ends_when_the_speed_is_reached(arm):
    assert arm.do("speedl", [0.0, 0.1, 0.0, 0.0, 0.0, 0.0], 0.5) == pytest.approx(0.2, abs=0.003)
    arm.wait(0.5)
    assert not arm.motion.moving


def test_what_is_out_of_reach_and_what_is_singular_stops_the_arm(arm):
    arm.do("movel", arm.pose(x=3.0))
    assert arm.why == "the pose that a move leads to is out of the arm's reach"
    arm = Arm()
    arm.do("movej", [0.0, -1.2, 1.2, -1.5, 0.4, 0.0])
    q = list(arm.motion.target_q)
    q[4] = -0.4
    goal = pose_of(arm.motion.kinematics.forward([0.8, *q[1:]]))
    arm.do("movel", goal, v=1.0, a=5.0)
    assert "as near a singularity: joint" in arm.why
    begin = len(arm.frames)
    for _ in range(300):
        arm.frame(None)
    assert not arm.motion.moving
    assert np.abs(np.diff(arm.qd[begin - 1 :], axis=0)).max() <= 15.0 * arm.dt_s + CLOSE


def test_a_line_that_leaves_the_reach_on_its_way_stops_the_arm(arm):
    arm.do("speedl", [-0.3, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0, 20.0, most_s=30.0)
    assert arm.why
    for _ in range(200):
        arm.frame(None)
    assert not arm.motion.moving


def test_the_end_of_a_range_stops_a_move():
    arm = Arm(start=(6.28, *HOME[1:]))
    arm.do("movej", [6.5, *HOME[1:]])
    assert arm.why == "joint 1 is at the end of its range"


def test_movej_keeps_to_what_the_joints_can(arm):
    arm.do("movej", [2.0, *HOME[1:]], a=50.0, v=100.0)
    assert not arm.why
    assert np.abs(arm.qd).max() == pytest.approx(math.pi)
    # With too short a time it takes longer: at the joint's highest speed for half of its time.
    takes_s = arm.do("movej", [-2.0, *HOME[1:]], t=0.5)
    assert not arm.why
    assert takes_s == pytest.approx(4.0 / (0.75 * math.pi), abs=0.004)
    assert np.abs(arm.qd).max() == pytest.approx(math.pi)
    assert arm.motion.target_q[0] == pytest.approx(-2.0)


def test_steady_and_history(arm):
    arm.wait(0.6)
    assert arm.call("is_steady")
    arm.do("movej", [0.1, *HOME[1:]])
    assert not arm.call("is_steady")
    before = arm.call("get_actual_joint_positions_history", 20)
    assert before[0] < arm.call("get_actual_joint_positions")[0]
    assert arm.call("get_actual_joint_positions_history") == arm.call("get_actual_joint_positions")
    with pytest.raises(ValueError, match="steps is 5000"):
        arm.call("get_actual_joint_positions_history", 5000)
    assert arm.motion.actual_tcp_speed() == pytest.approx(
        arm.motion.kinematics.speed(arm.motion.actual_q, arm.motion.actual_qd, arm.motion.tcp)
    )


# -- force, contact, freedrive ---------------------------------------------------------------------

DOWN = (UrPose((0.0,) * 6), [0, 0, 1, 0, 0, 0])
LIMITS = [0.1, 0.1, 0.05, 0.3, 0.3, 0.3]


def table(below_m=0.02, **options):
    """Return an arm at that height above a plane."""
    height = Arm(**options).motion.target_tcp_pose()[2]
    return Arm(contact_z_m=height - below_m, **options)


@pytest.mark.matrix("ur5e-5.0", "ur5e-60.0")
@pytest.mark.parametrize("asked_n", [5.0, 20.0, 60.0])
@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
def test_force_mode_presses_with_what_is_asked(robot, asked_n):
    arm = table(robot=robot)
    arm.call("zero_ftsensor")
    arm.call("force_mode", *DOWN, [0, 0, -asked_n, 0, 0, 0], 2, LIMITS)
    assert arm.motion.control_mode is UrControlMode.FORCE
    arm.wait(0.25)
    assert arm.call("get_target_tcp_speed")[2] == pytest.approx(-0.05, abs=1e-6)
    arm.wait(1.5)
    assert not arm.why
    assert arm.call("get_tcp_force")[2] == pytest.approx(asked_n, abs=0.05)
    assert arm.call("force") == pytest.approx(asked_n, abs=0.05)
    assert arm.call("get_joint_torques")[1] != 0.0
    arm.call("end_force_mode")
    arm.wait(0.2)
    assert not arm.motion.moving
    assert arm.call("get_tcp_force")[2] == pytest.approx(asked_n, abs=0.1)
    speeds, _ = arm.tool()
    assert speeds.max() <= 0.05 + CLOSE


def test_force_mode_without_contact_moves_on_at_its_limit(arm):
    frame = UrPose((0.0, 0.0, 0.0, 0.0, 0.0, math.pi / 2))
    arm.call("force_mode", frame, [1, 0, 0, 0, 0, 0], [3.0, 0, 0, 0, 0, 0], 2, LIMITS)
    start = arm.motion.target_tcp_pose()
    arm.wait(1.0)
    moved = np.array(arm.motion.target_tcp_pose()[:3]) - start[:3]
    assert moved == pytest.approx([0.0, 0.1, 0.0], abs=2e-3)
    end = arm.motion.target_tcp_pose()
    assert same((0.0, 0.0, 0.0, *end[3:]), (0.0, 0.0, 0.0, *start[3:]))


def test_a_move_in_force_mode_keeps_to_the_axes_that_are_not_compliant():
    arm = table(below_m=0.01)
    arm.call("force_mode", *DOWN, [0, 0, -15.0, 0, 0, 0], 2, LIMITS)
    arm.wait(1.0)
    goal = arm.pose(y=0.1, z=0.1)
    arm.do("movel", goal)
    assert not arm.why
    tip = arm.motion.target_tcp_pose()
    assert tip[:2] == pytest.approx(goal[:2], abs=1e-6)
    arm.wait(0.5)
    assert arm.call("get_tcp_force")[2] == pytest.approx(15.0, abs=0.1)
    arm.call("end_force_mode")
    up = arm.pose(z=0.05)
    arm.do("movel", up)
    assert same(arm.motion.target_tcp_pose(), up)


def test_force_mode_that_is_left_during_a_move_does_not_leap():
    arm = table(below_m=0.01)
    arm.call("force_mode", *DOWN, [0, 0, -15.0, 0, 0, 0], 2, LIMITS)
    arm.wait(0.5)
    goal = arm.pose(y=0.2, z=0.05)
    action = arm.call("movel", goal)
    for number in range(1000):
        if number == 200:
            arm.call("end_force_mode")
        if action is not None:
            arm.frame(action)
            action = arm.motion.left_of(action, arm.dt_s)
        else:
            arm.frame(Sleep(1.0))
    assert action is None
    assert np.abs(np.diff(arm.qd, axis=0)).max() < 0.1
    assert arm.motion.target_tcp_pose()[1] == pytest.approx(goal[1])


def test_damping_makes_an_axis_coast():
    ways = []
    for damping in (0.0, 1.0):
        arm = Arm()
        arm.call("force_mode_set_damping", damping)
        arm.call("force_mode", *DOWN, [0, 0, -5.0, 0, 0, 0], 2, LIMITS)
        arm.wait(0.2)
        arm.call("force_mode", *DOWN, [0, 0, 0, 0, 0, 0], 2, LIMITS)
        at = arm.motion.target_tcp_pose()[2]
        arm.wait(0.5)
        ways.append(at - arm.motion.target_tcp_pose()[2])
    assert ways[0] == pytest.approx(0.025, abs=1e-3)
    assert ways[1] < 0.002


@pytest.mark.parametrize("kind", [1, 2, 3])
def test_all_types_of_force_frames(kind, arm):
    arm.call("force_mode", *DOWN, [0, 0, -5.0, 0, 0, 0], kind, LIMITS)
    arm.do("movel", arm.pose(y=0.1))
    assert not arm.why
    # If the frame is rotated towards the TCP, its z axis still points down, at an angle.
    assert arm.motion.target_tcp_pose()[2] != pytest.approx(arm.frames[0][3][2], abs=1e-3)


def test_tool_contact_knows_when_it_began():
    arm = table()
    count = 0
    while not arm.call("tool_contact", [0, 0, -1, 0, 0, 0]):
        arm.frame(arm.call("speedl", [0, 0, -0.1, 0, 0, 0], 0.5, arm.dt_s))
        count += 1
        assert count < 1000
    assert arm.call("tool_contact")
    assert not arm.call("tool_contact", [0, 0, 1, 0, 0, 0])
    steps = arm.call("tool_contact")
    q = arm.call("get_actual_joint_positions_history", steps)
    plane = arm.controller.options.contact_z_m
    assert plane <= arm.call("get_forward_kin", q)[2] < plane + 3e-4
    arm.do("stopl", 3.0)
    arm.do("movel", q)
    arm.wait(0.1)
    assert not arm.call("tool_contact")
    assert not arm.why


def test_a_hard_contact_is_a_protective_stop_that_can_be_left():
    arm = table()
    arm.do("movel", arm.pose(z=-0.04), v=0.1)
    assert "the arm touches something with" in arm.why
    arm.motion.halt()
    arm.wait(0.2)
    assert not arm.motion.moving
    arm.do("movel", arm.pose(z=0.05), v=0.1)
    assert not arm.why


def sensed(arm, *wrench):
    Telemetry(arm.controller).write({"external_force_torque": wrench})


def test_a_sensor_of_others_takes_the_place_of_the_arms_own():
    arm = table(below_m=-0.002)
    flange = arm.motion.kinematics.forward(arm.motion.actual_q)
    own = arm.call("get_tcp_force")
    assert own[2] > 1.0
    sensed(arm, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
    assert arm.call("get_tcp_force") == own
    arm.call("ft_rtde_input_enable", True, 0.5, [0.0, 0.0, 0.1])
    felt = arm.call("get_tcp_force")
    force = rotate(flange.orientation, Vector3(1.0, 2.0, 3.0))
    torque = rotate(flange.orientation, Vector3(0.1 - 0.2, 0.2 + 0.1, 0.3))
    assert felt == pytest.approx((*force, *torque))
    reported = Telemetry(arm.controller).value
    assert reported("actual_TCP_force") == felt
    assert reported("wrench_calc_from_currents") == own
    assert arm.call("force") == pytest.approx(math.sqrt(14.0))
    sensed(arm, 0.0, 0.0, 0.0, 0.0, math.nan, 0.0)
    assert arm.call("get_tcp_force") == felt
    arm.call("ft_rtde_input_enable", False)
    assert arm.call("get_tcp_force") == own


@pytest.mark.parametrize(
    ("name", "lever"), [("ft_rtde_input_enable", 1.0), ("enable_external_ft_sensor", -1.0)]
)
def test_the_payload_is_taken_out_of_what_it_feels(name, lever, arm):
    arm.call(name, True)
    arm.call("set_payload", 1.0, [0.1, 0.0, 0.0])
    turn = arm.motion.kinematics.forward(arm.motion.actual_q).orientation
    weight = Vector3(0.0, 0.0, 9.82)
    torque = scale(cross(rotate(turn, Vector3(0.1, 0.0, 0.0)), weight), lever)
    assert arm.call("get_tcp_force") == pytest.approx((*weight, *torque))


def test_force_mode_goes_by_the_sensor_of_others(arm):
    turn = arm.motion.kinematics.forward(arm.motion.actual_q).orientation
    arm.call("ft_rtde_input_enable", True)
    arm.call("force_mode", *DOWN, [0, 0, -10, 0, 0, 0], 2, LIMITS)
    height = arm.motion.target_tcp_pose()[2]
    for force, speed in ((0.0, -0.05), (10.0, 0.0), (30.0, 0.02)):
        sensed(arm, *rotate(conjugate(turn), Vector3(0.0, 0.0, force)), 0.0, 0.0, 0.0)
        arm.wait(0.1)
        assert arm.call("get_target_tcp_speed")[2] == pytest.approx(speed, abs=1e-6)
    assert arm.motion.target_tcp_pose()[2] < height


def test_torques_move_the_arm_as_its_dynamics_have_it(arm):
    motion, dynamics = arm.motion, arm.controller.dynamics
    torque = [4.0, -8.0, 5.0, 0.5, -0.5, 0.2]
    q, qd = list(HOME), [0.0] * 6
    for _ in range(150):
        action = arm.call("direct_torque", torque)
        assert arm.frame(action) == ""
        assert motion.left_of(action, arm.dt_s) is None
        masses = np.array(dynamics.mass_matrix(q, motion.load)) + np.diag(ROTORS_KG_M2)
        changes = np.linalg.solve(masses, np.array(torque) - dynamics.coriolis(q, qd, motion.load))
        qd = qd + changes * arm.dt_s
        q = q + qd * arm.dt_s
        assert motion.target_q == pytest.approx(q, abs=1e-9)
    assert motion.control_mode is UrControlMode.TORQUE
    assert np.abs(qd).max() > 0.1
    arm.wait(0.5)
    assert motion.control_mode is UrControlMode.POSITION
    assert not motion.moving


def test_without_torques_the_arm_goes_on_and_keeps_its_energy(arm):
    for _ in range(50):
        arm.frame(arm.call("direct_torque", [10.0, 10.0, 5.0, 1.0, 1.0, 0.1]))

    def energy():
        motion = arm.motion
        masses = np.array(arm.controller.dynamics.mass_matrix(motion.target_q, motion.load))
        speeds = np.array(motion.target_qd)
        return 0.5 * speeds @ (masses + np.diag(ROTORS_KG_M2)) @ speeds

    before = energy()
    for _ in range(200):
        assert arm.frame(arm.call("direct_torque", [0.0] * 6)) == ""
    assert energy() == pytest.approx(before, rel=0.02)


def test_torques_that_push_against_something_come_to_rest_on_its_stiffness():
    arm = table()
    motion = arm.motion
    for _ in range(1500):
        columns = motion.kinematics.jacobian(motion.target_q, motion.tcp)
        push = np.array([column[2] for column in columns])
        held = 30.0 * (np.array(HOME) - motion.target_q) * (1, 0, 0, 1, 1, 1)
        torque = held - 20.0 * np.array(motion.target_qd) - 15.0 * push
        assert arm.frame(arm.call("direct_torque", torque.tolist())) == ""
    assert arm.call("get_tcp_force")[2] == pytest.approx(15.0, abs=3.0)


def test_what_torques_cannot_be(arm):
    with pytest.raises(ValueError, match="which is not 6 joints"):
        arm.call("direct_torque", [0.0] * 5)
    with pytest.raises(ValueError, match="which is not 0 to 1 for each joint"):
        arm.call("direct_torque", [0.0] * 6, viscous_scale=[2.0] * 6)
    while not arm.frame(arm.call("direct_torque", [150.0, 0.0, 0.0, 0.0, 0.0, 0.0])):
        assert len(arm.frames) < 1000
    assert "was asked for" in arm.why
    arm.call("freedrive_mode")
    with pytest.raises(ValueError, match="freedrive"):
        arm.call("direct_torque", [0.0] * 6)


def test_freedrive(arm):
    arm.call("freedrive_mode")
    assert arm.motion.control_mode is UrControlMode.TEACH
    with pytest.raises(ValueError, match="freedrive"):
        arm.call("movej", list(HOME))
    at = list(arm.motion.target_q)
    arm.wait(0.5)
    assert arm.motion.target_q == at
    assert arm.call("get_freedrive_status") == 0
    arm.call("end_freedrive_mode")
    assert arm.motion.control_mode is UrControlMode.POSITION
    arm.do("movej", [0.0, -1.2, 1.2, -1.5, 0.0, 0.0])
    arm.wait(0.2)
    assert arm.call("get_freedrive_status") == 2


def test_payload_and_gravity(arm):
    arm.call("set_tcp", UrPose((0.0, 0.0, 0.2, 0.0, 0.0, 0.0)))
    arm.call("set_payload", 1.5)
    assert arm.call("get_target_payload") == 1.5
    assert arm.call("get_target_payload_cog") == [0.0, 0.0, 0.2]
    arm.call("set_target_payload", 2.0, [0.0, 0.1, 0.0], [0.1, 0.1, 0.1, 0, 0, 0])
    assert arm.call("get_target_payload_inertia") == [0.1, 0.1, 0.1, 0, 0, 0]
    arm.call("set_payload_mass", 1.0)
    assert arm.call("get_target_payload_cog") == [0.0, 0.1, 0.0]
    assert arm.call("get_target_payload_inertia") == [0] * 6
    with pytest.raises(ValueError, match="beyond 133"):
        arm.call("set_target_payload", 1.0, [0, 0, 0], [200, 0, 0, 0, 0, 0])
    arm.call("set_gravity", [0, 9.82, 0])
    assert arm.call("get_gravity") == [0, 9.82, 0]


# -- programs --------------------------------------------------------------------------------------


def program(body, seconds=10.0, **options):
    """Return the controller after a program."""
    controller = UrController(UrControllerOptions(running=True, **options))
    controller.upload(f"def test():\n{body}\nend\n")
    for number in range(round(seconds / controller.period_s)):
        controller.advance(number * controller.period_s)
    return controller


def test_a_program_of_moves():
    controller = program(
        """
  movej([0.5, -1.5, 1.5, -1.5, -1.5, 0], a=3, v=2)
  x = get_forward_kin([0.7, -1.4, 1.4, -1.5, -1.5, 0])
  movel(x, r=0.02)
  movel(get_forward_kin([0.6, -1.3, 1.5, -1.5, -1.5, 0]))
  stopl(2)
  stopj(2)
"""
    )
    assert controller.runtime is RuntimeState.STOPPED
    assert controller.motion.target_q == pytest.approx([0.6, -1.3, 1.5, -1.5, -1.5, 0], abs=1e-8)
    assert not any("exception" in text for _, text in controller.events)


def test_a_program_whose_last_move_has_a_blend_ends_at_its_waypoint():
    controller = program("  movel([0.3, -1.5, 1.5, -1.5, -1.5, 0], r=0.05)")
    assert controller.runtime is RuntimeState.STOPPED
    assert controller.motion.target_q == pytest.approx([0.3, -1.5, 1.5, -1.5, -1.5, 0], abs=1e-8)


def test_a_program_takes_its_modes_with_it():
    controller = program("  freedrive_mode()\n  sleep(0.1)", 1.0)
    assert controller.motion.control_mode is UrControlMode.POSITION
    controller = program("  protective_stop()\n  sleep(1)", 1.0)
    assert controller.safety is SafetyMode.PROTECTIVE_STOP
    controller = program("  powerdown()\n  sleep(1)", 1.0)
    assert controller.mode is RobotMode.POWER_OFF
    controller = program("  movel([0, 0, 0, 0, 0])", 1.0)
    assert "movel(): pose is" in controller.events[-1][1]


ODD = [
    math.nan,
    math.inf,
    -1.0,
    0,
    1e300,
    1e5,
    -3,
    True,
    "base",
    [],
    [0.0] * 5,
    [math.nan] * 6,
    [1e300] * 6,
    [1e6] * 6,
    [0.1] * 6,
    [0.0] * 6,
    [[0.0]] * 6,
    UrPose((0.0,) * 6),
    UrPose((math.nan,) * 6),
    UrPose((0.3, 0.2, 0.4, 0.0, 3.0, 0.0)),
    UrPose((1e6,) * 6),
    UrPose((0.0, 0.0)),
    None,
]


def test_odd_arguments_are_errors_of_the_program():
    made = random.Random(11)
    arm = table()
    functions = {**pose_functions(), **motion_functions(arm.motion)}
    names = sorted(functions)
    for number in range(2000):
        name = made.choice(names)
        function = functions[name]
        given = {
            key: function.defaults[key]
            if key in function.defaults and made.random() < 0.6
            else made.choice(ODD)
            for key in function.parameters
        }
        try:
            found = function.do(*given.values())
        except (ValueError, TypeError, IndexError, OverflowError):
            continue
        if function.takes_time:
            for _ in range(made.choice([1, 3, 20])):
                arm.frame(found)
                assert all(map(math.isfinite, arm.motion.target_q)), (name, given)
                assert np.abs(arm.motion.target_qd).max() < 3.5, (name, given)
                found = arm.motion.left_of(found, arm.dt_s)
                if arm.why:
                    arm.motion.halt()
                if found is None:
                    break
        if number % 100 == 0:
            arm.motion.halt()
    assert inverse(frame_of(arm.motion.target_tcp_pose()))
