"""Sessions that command joints through an arm's model, on the simulated arm, in virtual time."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from cardan.drivers.sim_arm import SimArm, SimArmOptions
from cardan.errors import ConfigurationError
from cardan.gateway.arm.joint_space_arm import JointSpaceArm
from cardan.gateway.arm.status import Phase
from cardan.gateway.servo.compiled import CompiledServo
from cardan.gateway.session.arm_assembly import make_arm
from cardan.gateway.session.assembly import make_controller, make_robot
from cardan.gateway.session.config import parse_config
from cardan.spatial import add, rotate, rotation_between
from cardan.types import (
    CommandKind,
    DeviceLink,
    DeviceState,
    JointCommand,
    JointVelocityCommand,
    PoseCommand,
    RobotCapabilities,
    RobotLink,
    RobotState,
    Vector3,
)

pytestmark = pytest.mark.matrix

REST = (0.0,) * 6


def table(arm="ur5", robot=None, arm_options=None, **more):
    return {
        "device": {"driver": "spacemouse"},
        "robot": {
            "driver": "sim_arm",
            "robot": arm,
            "pacing": "virtual",
            "drive": "ideal",
            **(robot or {}),
        },
        "arm": {"model": arm, **(arm_options or {})},
        "limits": {"linear_speed_m_s": 0.25, "linear_acceleration_m_s2": 2.0},
        "mapping": {"linear_speed_m_s": 0.1, "deadman": "left"},
        **more,
    }


class Run:
    """A session's loop without its process: a scripted device, the controller, the simulated
    arm."""

    def __init__(self, **config):
        self.config = parse_config(table(**config))
        self.robot = make_robot(self.config)
        self.core = make_controller(self.config, self.robot)
        self.arm = self.core.commanded
        self.robot.open()
        self.cycles = self.robot.cycles()
        self.commands = []
        self.state = None

    def go(self, seconds, axes=REST, held=True, link=DeviceLink.LIVE, silent=False):
        """Play a device state for a time; return the motion of the measured TCP, m."""
        first = None
        for _ in range(round(seconds / self.robot.options.period_s)):
            self.state = state = next(self.cycles)
            first = first or state.pose
            stamp_s = state.stamp_s - (1.0 if silent else 0.0)
            hand = DeviceState(stamp_s, link, axes, frozenset(("left",) if held else ()))
            command = self.core.tick(state, hand)
            self.commands.append(command)
            self.robot.send(command)
        return np.array(self.state.pose.position) - np.array(first.position)

    def arm_it(self):
        self.go(0.1, held=False)
        self.go(0.02)
        assert self.core.phase is Phase.HOLDING
        return self

    @property
    def joints(self):
        return np.array([c.positions for c in self.commands if isinstance(c, JointCommand)])

    def on(self, robot):
        """Continue the session on another robot."""
        self.robot.close()
        self.robot = robot
        self.arm = self.core.commanded = make_arm(self.config, robot)
        robot.open()
        self.cycles = robot.cycles()
        return self


FORWARD = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def tcp_at_home():
    """Position of the TCP at the home of the session's arm, m."""
    probe = Run()
    probe.go(0.1)
    return probe.state.pose.position


def wall_ahead(by_m):
    """A wall across x, this far in front of the TCP at home."""
    x = tcp_at_home().x + by_m
    return {"name": "wall", "box": [[x, -0.5, -0.2], [x + 0.005, 0.5, 1.2]]}


@pytest.mark.parametrize("arm", ["ur5", "gofa_crb15000_5", "gp8", "teo_left_arm", "amor"])
def test_a_hand_drives_any_arm_and_its_joints_are_commanded(arm):
    run = Run(arm=arm).arm_it()
    moved = run.go(1.0, (0.0, 0.3, 0.3, 0.0, 0.0, 0.0))
    assert moved == pytest.approx((0.0, 0.03, 0.03), abs=3e-3)
    assert isinstance(run.commands[-1], JointCommand)
    status = run.core.status()
    assert status.phase is Phase.MOVING
    assert status.arm.failures == 0
    run.go(0.3)
    assert run.core.phase is Phase.HOLDING
    assert run.core.at_rest
    speeds = np.diff(run.joints, axis=0) / 0.002
    kinematics = run.arm.servo.kinematics
    assert (np.abs(speeds) <= kinematics.velocity + 1e-6).all()
    bends = np.abs(np.diff(speeds, axis=0)) / 0.002
    assert (bends <= kinematics.acceleration * (1 + 1e-6) + 1e-6).all()


def test_a_wall_is_kept_clear_of_and_said():
    run = Run(obstacles=[wall_ahead(0.15)]).arm_it()
    run.go(3.0, FORWARD)
    status = run.core.status()
    assert 0.009 < status.arm.distance_m < 0.0105
    assert "wall" in status.arm.nearest_pair
    assert any(words.endswith(" mm from wall") for words in status.arm.in_words())
    assert status.lead_used < 0.2  # no lead accumulated
    back = run.go(0.5, (-1.0, 0, 0, 0, 0, 0))
    assert back[0] < -0.04


def test_joint_limits_hold_while_the_hand_insists():
    run = Run(arm="teo_right_arm").arm_it()
    kinematics = run.arm.servo.kinematics
    for axes in (FORWARD, (0.0, 0.0, 1.0, 0.0, 0.0, 1.0), (0.0, 1.0, -1.0, 1.0, 0.0, 0.0)):
        run.go(6.0, axes)
    assert (run.joints <= kinematics.upper + 1e-5).all()
    assert (run.joints >= kinematics.lower - 1e-5).all()
    assert run.core.status().arm.failures == 0


def test_an_arm_that_something_holds_is_let_go_and_glided_back_to():
    run = Run(robot={"drive": "dynamic"}).arm_it()
    run.go(0.3, FORWARD)
    plant = run.robot.arm.plant
    held = np.array(plant.positions)
    held[1] += 0.8  # the elbow is pushed far away
    plant.set_state(held, (0.0,) * 6)
    before = len(run.commands)
    run.go(3.0, FORWARD)
    status = run.core.status()
    assert status.trips >= 1
    assert run.core.phase is not Phase.MOVING
    speeds = np.abs(np.diff(run.joints[before - 1 :], axis=0)) / 0.002
    assert (speeds <= run.arm.servo.kinematics.velocity + 1e-6).all()


class OnlyTakes(SimArm):
    """The simulated arm as a robot that accepts other commands."""

    kinds = frozenset({CommandKind.JOINT_VELOCITY, CommandKind.HOLD})

    @property
    def capabilities(self):
        return super().capabilities._replace(commands=self.kinds)


def test_an_arm_that_takes_velocities_does_not_sink():
    """The sag of the paper: velocity commands cannot hold an arm, the virtual reference point
    can."""
    options = SimArmOptions(robot="ur5", pacing="virtual", drive="dynamic")
    run = Run(robot={"drive": "dynamic"}).on(OnlyTakes(options)).arm_it()
    assert isinstance(run.commands[-1], JointVelocityCommand)
    held = run.go(10.0)
    free = OnlyTakes(options)
    free.open()
    first = None
    for state, _ in zip(free.cycles(), range(5000), strict=False):
        first = first or state.pose
        free.send(JointVelocityCommand((0.0,) * 6))
    sunk = first.position.z - state.pose.position.z
    assert sunk > 3e-3
    assert abs(held[2]) < 0.2 * sunk


def test_a_robot_that_takes_poses_gets_those_of_joints_inside_their_limits():
    class TakesPoses(OnlyTakes):
        kinds = frozenset({CommandKind.POSE, CommandKind.HOLD})

        def send(self, command):
            self.sent = command

    run = Run().on(TakesPoses(SimArmOptions(robot="ur5", pacing="virtual", drive="ideal")))
    run.go(0.1, held=False)
    run.go(0.2)
    run.go(0.1, FORWARD)
    command = run.commands[-1]
    assert isinstance(command, PoseCommand)
    assert math.dist(command.pose.position, run.core.reference.pose.position) < 1e-4
    assert command.twist.linear.x == pytest.approx(run.core.reference.linear.x, abs=5e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"arm": {"model": "ur6"}}, "arm.model: there is no arm 'ur6'; allowed: amor"),
        ({"arm": {"model": "asibot"}}, "has 5 joints, the robot as configured 6"),
        ({"arm": {"model": "ur5", "policy": "guess"}}, "arm.policy: .*one of path, reach"),
        ({"arm": {"model": "ur5", "speed_share": 1.5}}, "arm.speed_share: .*0.001 to 1"),
        ({"arm": {"model": "ur5", "sped_share": 1}}, "did you mean 'speed_share'"),
        ({"obstacles": [{"name": "w"}]}, "'w' has no shape; give one of box"),
        ({"obstacles": [{"name": "w", "box": [[0.0, 0.0, 0.0], [1.0, -1.0, 1.0]]}]}, "lowest"),
        ({"obstacles": [{"name": "p", "plane": [[0.0, 0.0, 0.0], 0.0]}]}, "has a direction"),
        ({"obstacles": {"name": "p"}}, r"under the heading \[\[obstacles\]\]"),
        (
            {
                "arm": {"model": "ur5", "collisions": False},
                "obstacles": [{"name": "p", "plane": [[0.0, 0.0, 1.0], 0.0]}],
            },
            "only an arm's model keeps away",
        ),
    ],
)
def test_a_wrong_arm_is_refused_by_name(change, words):
    whole = table()
    whole.update(change)
    with pytest.raises(ConfigurationError, match=words):
        make_all(whole)


def make_all(whole):
    config = parse_config(whole)
    return make_arm(config, make_robot(config))


def test_a_robot_that_takes_only_joints_needs_an_arm():
    whole = table()
    del whole["arm"]
    with pytest.raises(ConfigurationError, match=r"without an \[arm\] table"):
        make_robot(parse_config(whole))


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ((math.nan,) * 6, "not numbers"),
        ((0.0,) * 5, "reports 5 joints, the arm's model has 6"),
        ((), "reports 0 joints"),
    ],
)
def test_a_robot_that_reports_nonsense_is_not_commanded(joints, words):
    run = Run().arm_it()
    run.go(0.2, FORWARD)
    hand = DeviceState(run.state.stamp_s, DeviceLink.LIVE, FORWARD, frozenset(("left",)))
    broken = run.state._replace(joints=joints, stamp_s=run.state.stamp_s + 0.002)
    before = np.array(run.commands[-1].velocities)
    command = run.core.tick(broken, hand)
    # The controller is heard, so it may still follow: a ramp, whatever it reports.
    change = np.abs(np.array(command.velocities) - before)
    assert (change <= run.arm.servo.kinematics.acceleration * 0.002 + 1e-9).all()
    for _ in range(100):
        broken = broken._replace(stamp_s=broken.stamp_s + 0.002)
        command = run.core.tick(broken, hand)
    assert command.kind is CommandKind.HOLD
    assert run.core.at_rest
    assert words in run.core.status().message
    assert run.core.status().trips == 1
    run.go(0.3, FORWARD)  # re-arm to go on
    assert run.core.phase is Phase.DISARMED
    assert np.isfinite(run.joints).all()


@pytest.mark.parametrize("arm", ["ur5", "pr2_right_arm"])
def test_joints_that_are_measured_wrongly_are_not_chased_for_ever(arm):
    run = Run(arm=arm).arm_it()
    true = run.joints[-1]
    offset = np.zeros(len(true))
    state, moved = run.state, []
    for _ in range(5000):
        offset[0] = min(1.0, offset[0] + 0.004)  # no faster than a joint can be
        q = true if not moved else moved[-1]
        state = state._replace(
            stamp_s=state.stamp_s + 0.002, period_s=0.002, joints=tuple((q + offset).tolist())
        )
        hand = DeviceState(state.stamp_s, DeviceLink.LIVE, REST, frozenset())
        command = run.core.tick(state, hand)
        held = moved[-1] if moved and command.kind is CommandKind.HOLD else None
        moved.append(np.array(command.positions) if held is None else held)
    assert np.abs(moved[-1] - true).max() < 0.75  # the maximum lead
    assert np.abs(np.diff(moved[-1000:], axis=0)).max() < 1e-7
    assert "not resynchronized with the robot" in run.core.status().message


def test_a_whole_turn_of_a_continuous_joint_is_no_error():
    run = Run(arm="pr2_right_arm").arm_it()
    joints = np.array(run.state.joints)
    joints[6] += 2.0 * math.pi
    state = run.state._replace(stamp_s=run.state.stamp_s + 0.002, joints=tuple(joints.tolist()))
    hand = DeviceState(state.stamp_s, DeviceLink.LIVE, REST, frozenset(("left",)))
    before = run.joints[-1]
    after = np.array(run.core.tick(state, hand).positions)
    assert after == pytest.approx(before, abs=1e-9)
    assert run.core.status().trips == 0


def test_a_pushed_robot_of_velocities_comes_back_inside_its_accelerations():
    servo = Run().arm.servo
    follower = JointSpaceArm(servo, frozenset({CommandKind.JOINT_VELOCITY}))
    run = Run()
    run.go(0.1, held=False)
    follower.place(run.state)
    pushed = tuple((np.array(run.state.joints) + 0.4).tolist())
    state, sent = run.state._replace(joints=pushed, period_s=0.002), [np.zeros(6)]
    sent += [np.array(follower.command(state, 0.002).velocities) for _ in range(300)]
    steps = np.abs(np.diff(sent, axis=0))
    assert (steps <= servo.kinematics.acceleration * 0.002 * (1 + 1e-9)).all()
    assert (np.abs(sent[-1]) <= 0.2 * servo.kinematics.velocity + 1e-9).all()


@pytest.mark.parametrize("share", [0.05, 0.1, 0.3])
def test_a_slowly_braking_arm_keeps_its_distance_too(share):
    run = Run(
        obstacles=[wall_ahead(0.2)],
        arm_options={"acceleration_share": share},
        mapping={"linear_speed_m_s": 0.25, "deadman": "left"},
    ).arm_it()
    nearest = math.inf
    for _ in range(300):
        run.go(0.01, FORWARD)
        nearest = min(nearest, run.core.status().arm.distance_m)
    assert nearest > 0.009


def test_many_obstacles_around_do_not_hide_the_one_ahead():
    bolts = [
        {
            "name": f"bolt {i}",
            "capsule": [
                [0.2 * math.cos(0.1 * i), 0.2 * math.sin(0.1 * i), -0.05],
                [0.2 * math.cos(0.1 * i), 0.2 * math.sin(0.1 * i), -0.02],
                0.01,
            ],
        }
        for i in range(60)
    ]
    run = Run(
        obstacles=[*bolts, wall_ahead(0.2)],
        limits={"linear_speed_m_s": 1.0, "linear_acceleration_m_s2": 4.0},
        mapping={"linear_speed_m_s": 1.0, "deadman": "left"},
    ).arm_it()
    collision, nearest = run.arm.servo.collision, math.inf
    for _ in range(100):
        run.go(0.01, FORWARD)
        pairs = zip(collision.pairs, collision.distances, strict=True)
        nearest = min(nearest, *(d for pair, d in pairs if "wall" in pair))
    assert nearest > 0.009


def test_an_arm_that_starts_inside_an_obstacle_says_so_rests_and_gets_out():
    # The TCP is 2 cm below the table's top, and up is the way out.
    top = tcp_at_home().z + 0.02
    run = Run(obstacles=[{"name": "table", "plane": [[0.0, 0.0, 1.0], top]}]).arm_it()
    assert run.go(0.5) == pytest.approx((0, 0, 0), abs=1e-6)
    assert any("overlap" in words for words in run.core.status().arm.in_words())
    moved = run.go(2.0, (0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    assert moved[2] > 0.0


def test_some_axes_drive_joints_and_the_others_the_tcp():
    """Equation 7 of Baklouti et al. 2021, as a session's mapping."""
    axes = ["x", "y", "z", "rx", "ry", "fixed"]
    mapping = {"deadman": "left", "axes": axes, "joints": {"-rz": "shoulder_pan_joint"}}
    run = Run(mapping=mapping | {"joint_speed_rad_s": 0.2}).arm_it()
    before = run.joints[-1]
    run.go(1.0, (0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    moved = run.joints[-1] - before
    assert moved[0] == pytest.approx(-0.2, abs=0.01)
    assert moved[1:] == pytest.approx(np.zeros(5), abs=5e-3)
    assert run.core.phase is Phase.MOVING
    z = run.go(1.0, (0.0, 0.0, 0.5, 0.0, 0.0, 1.0))[2]
    assert z == pytest.approx(0.05, abs=5e-3)
    run.go(0.5)
    assert run.core.at_rest
    run.go(0.5, (0.0, 0.0, 0.0, 0.0, 0.0, 1.0), silent=True)
    assert run.core.phase is Phase.DISARMED
    assert run.core.at_rest


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        (
            {"joints": {"rz": "elbow"}},
            "mapping.joints.rz: there is no joint 'elbow'; .*; did you mean 'elbow_joint'",
        ),
        ({"joints": {"yaw": "elbow_joint"}}, "mapping.joints: 'yaw' .*one of x, y, z"),
        ({"joints": {"rz": "elbow_joint"}}, "the axis drives rz as well"),
    ],
)
def test_wrong_joint_axes_are_refused_by_name(mapping, words):
    with pytest.raises(ConfigurationError, match=words):
        make_all(table(mapping=mapping))


def test_a_mixed_twist_goes_along_the_base_and_turns_about_the_tool():
    run = Run(mapping={"deadman": "left", "frame": "mixed"}).arm_it()
    start = run.state.pose
    moved = run.go(1.0, (0.0, 0.5, 0.0, 0.0, 0.0, 0.5))
    assert moved == pytest.approx((0.0, 0.05, 0.0), abs=4e-3)
    axis = rotate(start.orientation, Vector3(0.0, 0.0, 1.0))
    turned = rotation_between(start.orientation, run.state.pose.orientation)
    along = sum(a * b for a, b in zip(axis, turned, strict=True))
    assert along == pytest.approx(0.2, abs=0.02)
    assert math.dist(turned, [along * c for c in axis]) < 0.01


def test_an_arm_keeps_off_itself_whatever_the_hand_does():
    """AMOR folds its hand back along its forearm; its joints brake slowly."""
    run = Run(
        arm="amor",
        limits={"linear_speed_m_s": 0.25, "angular_speed_rad_s": 1.0},
        mapping={"linear_speed_m_s": 0.25, "angular_speed_rad_s": 1.0, "deadman": "left"},
    ).arm_it()
    generator, nearest = np.random.default_rng(15), math.inf
    for _ in range(12):
        axes = tuple(generator.uniform(-1.0, 1.0, 6).tolist())
        for _ in range(20):
            run.go(0.05, axes)
            nearest = min(nearest, run.core.status().arm.distance_m)
    assert nearest > 0.004  # of 5 mm: several pairs and slow joints together use part of the margin
    assert run.core.status().arm.failures == 0


def test_a_session_leans_a_soft_neck_by_its_tendons():
    config = parse_config(
        {
            "device": {"driver": "spacemouse"},
            "robot": {"driver": "sim_arm"},
            "arm": {"model": "teo_soft_neck"},
            "mapping": {"deadman": "left"},
        }
    )
    joint = frozenset({CommandKind.JOINT})
    engine = make_controller(
        config, SimpleNamespace(capabilities=RobotCapabilities(joint, 0.002, 3, None, 0, 0))
    )
    arm = engine.commanded
    neck = arm.servo.kinematics
    q = tuple(neck.tendons(0.1, 0.0).tolist())
    for i in range(1000):
        now_s = 0.002 * i
        state = RobotState(now_s, RobotLink.LIVE, 1, i, 0.002, q, (), None, "")
        axes = (0.0, 0.0, 0.0, 0.0, 0.5, 0.3) if 100 < i < 700 else REST
        held = frozenset(("left",) if i > 50 else ())
        q = engine.tick(state, DeviceState(now_s, DeviceLink.LIVE, axes, held)).positions
    shape = neck.shape(np.array(q))
    assert shape.inclination_rad == pytest.approx(0.1 + 0.2 * 1.2, abs=0.03)
    assert abs(shape.co_contraction_m) < 5e-4
    assert engine.phase is Phase.HOLDING


@pytest.mark.parametrize("arm", ["ur5", "gofa_crb15000_5", "gp8"])
def test_at_the_edge_of_its_reach_the_figures_are_those_of_the_motion_and_it_is_said_why(arm):
    run = Run(arm=arm).arm_it()
    run.go(8.0, FORWARD)
    before = run.state.pose.position
    path_m = 0.0
    for _ in range(100):
        run.go(0.01, FORWARD)
        path_m += 0.01 * math.hypot(*run.core.commanded.twist.linear)
    assert math.dist(before, run.state.pose.position) < 1e-4
    assert path_m < 1e-3
    status = run.core.status()
    assert math.hypot(*status.target.linear) == pytest.approx(0.1)
    assert math.hypot(*status.twist.linear) < 1e-3
    assert "the arm does not follow: " in status.message
    assert "edge of its reach" in status.message


def contradicted(run):
    """A tool that the controller knows and the model does not: the TCP is 80 mm away."""
    true = run.cycles
    away = Vector3(0.0, 0.0, 0.08)
    run.cycles = (
        state._replace(pose=state.pose._replace(position=add(state.pose.position, away)))
        for state in true
    )
    run.go(0.1, held=False)
    run.go(0.2)
    return run


def test_a_tcp_that_contradicts_the_joints_is_said_at_the_start_and_not_armed():
    """Otherwise the walls would be at wrong places."""
    run = contradicted(Run())
    status = run.core.status()
    assert run.core.phase is Phase.NO_ROBOT
    assert "the tool or the model does not fit" in status.message
    assert "80.0 mm" in status.message


def test_how_far_the_tcp_may_contradict_the_joints_is_configured():
    run = contradicted(Run(arm_options={"tcp_tolerance_m": 0.1}))
    assert run.core.phase is Phase.HOLDING


ROUND_ABOUT = [
    {"name": "floor", "plane": [[0.0, 0.0, 1.0], -1.0]},
    *(
        {"name": name, "capsule": [[x, y, 0.0], [x, y, 1.0], 0.1]}
        for name, x, y in (("east", 1.5, 0.0), ("north", 0.0, 1.5), ("south", 0.0, -1.5))
    ),
]


def test_a_robot_at_1_khz_is_driven_as_one_at_250_hz_is():
    """With all pairs of bodies; the period changes only the resolution of the commands."""
    ends = []
    for period_s in (0.001, 0.004):
        run = Run(robot={"period_s": period_s}, obstacles=ROUND_ABOUT).arm_it()
        assert len(run.arm.servo.collision.pairs) >= 35
        assert isinstance(run.arm.servo, CompiledServo)
        run.commands.clear()
        moved = run.go(1.5, (0.2, 0.3, 0.3, 0.0, 0.0, 0.2))
        moved = moved + run.go(0.5)
        status = run.core.status()
        assert status.phase is Phase.HOLDING
        assert status.arm.failures == 0
        assert run.core.at_rest
        assert len(run.commands) == round(2.0 / period_s)
        joints, kinematics = run.joints, run.arm.servo.kinematics
        speeds = np.diff(joints, axis=0) / period_s
        assert (np.abs(speeds) <= kinematics.velocity + 1e-6).all()
        bends = np.abs(np.diff(speeds, axis=0)) / period_s
        assert (bends <= kinematics.acceleration * (1 + 1e-6) + 1e-6).all()
        assert np.linalg.norm(moved) > 0.05
        # After silence the ramp begins after the same time, not the same number of cycles.
        run.go(0.3, FORWARD)
        run.go(0.5, FORWARD, silent=True)
        assert run.core.phase is Phase.DISARMED
        assert run.core.status().trips == 1
        assert run.go(0.5, FORWARD, silent=True) == pytest.approx((0, 0, 0), abs=1e-6)
        ends.append(moved)
    assert ends[0] == pytest.approx(ends[1], abs=1e-3)
