"""The compiled servo: compared with its oracles, called with invalid values, and loaded."""

import ctypes
import gc
import math
import shutil
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import cardan
from cardan.common.native import NativePartError
from cardan.errors import ConfigurationError
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import CollisionModel, box_obstacle
from cardan.gateway.servo import choice, kernel_layout as layout, native
from cardan.gateway.servo.choice import choose_servo
from cardan.gateway.servo.compiled import CompiledServo
from cardan.gateway.servo.options import Policy, ServoOptions
from cardan.gateway.servo.servo import Servo
from cardan.robots import arm_names, load_arm, parse_urdf
from cardan.spatial import moved, normalized
from cardan.types import IDENTITY, IDENTITY_POSE, ZERO3, Frame, Pose, Quaternion, Vector3
from tests import servo_oracles
from tests.examples import ARMS_LATER

DT_S = 0.004
STILL = np.zeros((2, 3))

MAX_ITERATIONS = 120
"""Limit for one quadratic program, as in program.h."""


def made(name="ur5", **options):
    kinematics = ArmKinematics(load_arm(name))
    return CompiledServo(kinematics, CollisionModel(kinematics), ServoOptions(**options))


# ---------------------------------------------------------------------------------------------
# Oracles. `python -m tests.servo_oracles` does the same a million times.


@pytest.mark.parametrize("name", arm_names())
def test_placement_and_jacobian_are_pinocchios(name):
    worst = servo_oracles.kinematics(name, 200)
    assert worst.placement < 1e-12
    assert worst.jacobian < 1e-12


@pytest.mark.parametrize("name", arm_names())
def test_distances_are_coals(name):
    found = servo_oracles.distances(name, 100)
    assert found.farther < 1e-9
    assert found.nearer < 1e-9
    assert found.gradient < 1e-4


@pytest.mark.parametrize("degenerate", [False, True])
def test_programs_have_daqps_solutions_or_better_ones(degenerate):
    found = servo_oracles.programs(1000, degenerate=degenerate)
    assert found.daqp < 1e-8
    assert found.quadprog < 1e-8
    assert found.residual < 1e-9
    assert found.warm < 1e-6
    assert found.iterations < 100


def test_a_row_of_rounding_constrains_nothing():
    """As for a body that turns about its own axis next to an obstacle that it overlaps."""
    free = servo_oracles.Program(
        np.eye(3), np.array((-1.0, 2.0, 0.0)), np.full(3, -9.0), np.full(3, 9.0),
        np.zeros((1, 3)), np.zeros(1),
    )  # fmt: skip
    noise = free._replace(rows=np.array(((-1e-17, 1e-18, 0.0),)))
    assert noise.by_kernel()[0] == pytest.approx((1.0, -2.0, 0.0))
    assert noise.by_daqp()[0] == pytest.approx((1.0, -2.0, 0.0))


@pytest.mark.matrix(*ARMS_LATER)
@pytest.mark.parametrize("name", arm_names())
def test_ticks_are_those_of_the_servo_in_python(name):
    found = servo_oracles.ticks(name, 200)
    assert found.velocity <= servo_oracles.SAME_TICK
    assert found.worse == 0
    assert found.other < 1e-6


PRISMATIC = """<robot name="gantry">
<link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="d">
<collision><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
<joint name="y" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 0.6 0.8"/>
<origin xyz="0 0 0.2" rpy="0.3 0.2 0.1"/><limit lower="-1" upper="1" velocity="1"/></joint>
<joint name="turn" type="continuous"><parent link="b"/><child link="c"/><axis xyz="0 0 -1"/>
<limit velocity="2"/></joint>
<joint name="tilt" type="revolute"><parent link="c"/><child link="d"/><axis xyz="1 2 3"/>
<origin xyz="0.1 0 0.1"/><limit lower="-2" upper="2" velocity="2"/></joint></robot>"""


def test_sliding_and_endless_joints_are_pinocchios_and_the_servos(monkeypatch):
    arm = parse_urdf(PRISMATIC)
    monkeypatch.setattr(servo_oracles, "load_arm", lambda name: arm)
    worst = servo_oracles.kinematics("gantry", 200)
    assert max(worst) < 1e-12
    distances = servo_oracles.distances("gantry", 100)
    assert max(distances.farther, distances.nearer) < 1e-9
    found = servo_oracles.ticks("gantry", 300)
    assert found.velocity <= servo_oracles.SAME_TICK
    assert found.worse == 0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.016, 0.3]), st.sampled_from([0.01, 1.0]))
def test_a_lagging_robot_is_expected_where_the_servo_in_python_expects_it(seed, lag_s, step):
    """On a grid, so that several past positions are equally near."""
    kinematics, rng = ArmKinematics(parse_urdf(PRISMATIC)), np.random.default_rng(seed)
    servos = Servo(kinematics), CompiledServo(kinematics)
    for servo in servos:
        servo.keep_past(lag_s)
    now_s, way = 1.0, [np.zeros(4)]
    for k in range(150):
        now_s += rng.choice([0.004, 0.02, 0.05, 5.0], p=[0.4, 0.4, 0.19, 0.01])
        way.append(way[-1] + step * rng.integers(-1, 2, 4))
        for servo in servos:
            servo.place(way[-1])
            servo.record_command(now_s)
            if k == 100:
                servo.keep_past(lag_s)
        measured = way[-rng.integers(1, min(len(way), 20) + 1)] + step * rng.integers(-2, 3, 4) / 2
        measured[2] += 2.0 * math.pi * rng.integers(-1, 2)
        joints = measured.tolist()
        (pose, *error), (other, *too) = (servo.measure(joints) for servo in servos)
        assert too == error
        assert np.abs(np.subtract(other.position, pose.position)).max() < 1e-12 * (1.0 + 150 * step)
        expected, too = (servo.expected(joints).tolist() for servo in servos)
        assert too == expected


@pytest.mark.parametrize("n", range(1, layout.MAX_JOINTS + 1))
def test_the_smallest_eigenvalue_is_numpys(n):
    generator, library = np.random.default_rng(n), native.kernel_library()
    for case in range(400):
        factor, digits = generator.normal(size=(n, n)) * 10.0 ** generator.uniform(-6, 0, n), 1e-13
        if case % 4 == 1:  # few distinct eigenvalues, many of them equal
            factor, digits = np.linalg.qr(factor)[0] * generator.integers(1, 3, n), 1e-12
        elif case % 4 == 2:  # nearly or exactly singular
            factor[:, -1] = factor[:, 0] * (1.0 + generator.choice([0.0, 1e-9, 1e-5]))
        elif case % 4 == 3:
            factor = np.diag(10.0 ** generator.integers(-8, 3, n))
        matrix = np.ascontiguousarray(factor.T @ factor)
        expected = np.linalg.eigvalsh(matrix)[0]
        found = library.kernel_smallest_eigenvalue(native.numbers(matrix.ravel()), n)
        assert found == pytest.approx(expected, abs=digits * np.abs(matrix).max())


# ---------------------------------------------------------------------------------------------
# Invalid values


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_tick_of_what_is_no_number_brakes_and_says_so(wrong):
    servo = made()
    home = servo.q.copy()
    servo.move_at(np.full(6, 0.1))
    goal = servo.pose
    twist = STILL.copy()
    twist[1, 2] = wrong
    rate = np.full(6, wrong)
    for ask in (
        lambda: servo.tick(Pose(Vector3(0.0, wrong, 0.0), goal.orientation), STILL, DT_S),
        lambda: servo.tick(Pose(goal.position, Quaternion(wrong, 0.0, 0.0, 0.0)), STILL, DT_S),
        lambda: servo.tick(Pose(goal.position, Quaternion(0.0, 0.0, 0.0, 0.0)), STILL, DT_S),
        lambda: servo.tick(goal, twist, DT_S),
        lambda: servo.tick(goal, STILL, DT_S, rate),
        lambda: servo.tick_joints(rate, np.zeros(6), DT_S),
        lambda: servo.tick_joints(servo.q, rate, DT_S),
    ):
        servo.place(home)
        servo.move_at(np.full(6, 0.1))
        failures = servo.status().failures
        assert ask() == 0.0
        assert 0.0 <= np.abs(servo.v).max() < 0.1
        assert np.isfinite(servo.q).all()
        status = servo.status()
        assert status.failures == failures + 1
        assert status.in_words()[0] == "a goal, twist, rate or posture that is not a number: braked"
    servo.tick(goal, STILL, DT_S)
    assert servo.status().refused == ""


@pytest.mark.parametrize("dt_s", [0.0, -0.004, math.nan, math.inf])
def test_nothing_moves_for_a_period_that_is_none(dt_s):
    servo = made()
    servo.move_at(np.full(6, 0.1))
    before = servo.q.copy()
    for ask in (
        lambda: servo.tick(servo.pose, STILL, dt_s),
        lambda: servo.tick_joints(servo.q + 1.0, np.zeros(6), dt_s),
        lambda: servo.brake(dt_s),
    ):
        ask()
        assert (servo.q == before).all()
        assert "period" in servo.status().refused


def test_each_tick_has_the_period_that_it_is_given():
    servo, other = made(), made()
    goal = servo.pose._replace(position=servo.pose.position._replace(x=9.0))
    for dt_s in (0.004, 0.008, 0.008, 0.002, 0.0, 0.004):
        before = servo.q.copy()
        for each in (servo, other):
            each.tick(goal, STILL, dt_s)
        np.testing.assert_array_equal(servo.q, before + servo.v * dt_s)
        with pytest.raises(TypeError):
            other.tick(goal, STILL, None)
        np.testing.assert_array_equal(other.q, servo.q)


def test_what_an_arm_of_few_joints_can_reach_is_the_servos():
    kinematics = ArmKinematics(load_arm("asibot"))
    python, compiled = Servo(kinematics), CompiledServo(kinematics)
    assert made().reachable is None
    assert compiled.reachable is None
    goal, far = compiled.pose, compiled.pose._replace(orientation=Quaternion(0.6, 0.0, 0.8, 0.0))
    bad = goal._replace(position=Vector3(math.nan, 0.0, 0.0))
    compiled.tick(bad, STILL, DT_S)
    assert compiled.reachable is None
    for servo in (python, compiled):
        servo.place(kinematics.arm.home + np.full(5, 0.1))
        servo.tick(far, STILL, DT_S)
    first = compiled.reachable
    assert first is not None
    assert python.reachable is not None
    assert first.position == pytest.approx(python.reachable.position, abs=1e-9)
    assert first.orientation == pytest.approx(python.reachable.orientation, abs=1e-9)
    compiled.tick(bad, STILL, DT_S)
    assert compiled.reachable == first


def test_what_has_a_wrong_length_or_is_no_number_is_refused_and_nothing_changes():
    servo = made()
    q = servo.q.copy()
    for ask in (
        lambda: servo.place(np.zeros(5)),
        lambda: servo.place(np.full(6, math.nan)),
        lambda: servo.move_at(np.zeros(7)),
        lambda: servo.move_at(np.full(6, math.inf)),
        lambda: servo.tick_joints(np.zeros(7), np.zeros(6), DT_S),
        lambda: servo.tick_joints(np.zeros(6), np.zeros(5), DT_S),
        lambda: servo.tick_joints([0.0] * 5 + [None], np.zeros(6), DT_S),
        lambda: servo.tick(servo.pose, STILL, DT_S, np.zeros(1)),
        lambda: servo.tick(servo.pose, np.zeros((2, 2)), DT_S),
        lambda: setattr(servo, "posture", np.zeros(3)),
    ):
        with pytest.raises(ValueError, match=r"values for 6 joints|not numbers|2×3"):
            ask()
        assert (servo.q == q).all()
        assert not servo.moving


def test_numbers_at_the_end_of_doubles_do_no_harm():
    servo = made()
    for size in (1e300, 1e154, 1e-320):
        goal = Pose(Vector3(size, -size, size), Quaternion(1.0, 0.0, 0.0, 0.0))
        servo.tick(goal, np.full((2, 3), size), DT_S, np.full(6, size), slide=True)
        servo.tick_joints(np.full(6, size), np.full(6, -size), DT_S)
        assert np.isfinite(servo.q).all()
        assert (np.abs(servo.v) <= servo.kinematics.velocity).all()


def test_memory_of_a_servo_outlives_it():
    servo = made()
    q, v = servo.q, servo.v
    expected = q.copy()
    del servo
    assert (q == expected).all()
    assert (v == 0.0).all()


def altered(change):
    """Make a compiled servo of the UR5, after `change` of its arguments."""
    kinematics = ArmKinematics(load_arm("ur5"))
    collision = CollisionModel(kinematics)
    change(kinematics, collision)
    return CompiledServo(kinematics, collision)


def set_to(array, index, value):
    array[index] = value


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda k, c: set_to(k.lower, 2, math.nan), "limits"),
        (lambda k, c: set_to(k.upper, 2, k.lower[2]), "limits"),
        (lambda k, c: set_to(k.velocity, 0, 0.0), "limits"),
        (lambda k, c: set_to(k.acceleration, 0, math.inf), "limits"),
        (lambda k, c: set_to(c.sweeps, (0, 0), math.nan), "pair"),
        (lambda k, c: set_to(c.solids, 0, c.solids[0]._replace(body=9)), "shape"),
        (
            lambda k, c: set_to(
                c.solids, 0, c.solids[0]._replace(shape=c.solids[0].shape._replace(radius_m=-1.0))
            ),
            "shape",
        ),
        (lambda k, c: setattr(k, "joints", 10), "1 to 9 joints"),
    ],
)
def test_an_arm_that_it_cannot_take_is_refused_in_words(change, words):
    with pytest.raises(ConfigurationError, match=words):
        altered(change)


def test_what_is_far_away_hides_nothing_near():
    """Only the nearest pair and pairs that could touch are computed completely."""
    generator = np.random.default_rng(5)
    boxes = [
        box_obstacle(f"box {i}", Vector3(*low), Vector3(*(low + generator.uniform(0.02, 0.3, 3))))
        for i, low in enumerate(generator.uniform(-1.2, 1.0, (40, 3)))
    ]
    kinematics = ArmKinematics(load_arm("gp8"))
    collision = CollisionModel(kinematics, boxes)
    both = [kind(kinematics, collision) for kind in (CompiledServo, Servo)]
    twist = np.array(((0.1, 0.0, 0.05), (0.0, 0.2, 0.0)))
    for _ in range(60):
        q = generator.uniform(kinematics.lower, kinematics.upper)
        found = []
        for servo in both:
            servo.place(q)
            servo.v[:] = 0.3
            servo.tick(servo.pose, twist, DT_S)
            status = servo.status()
            found.append((status.nearest_pair, status.active_pairs))
            assert status.distance_m == pytest.approx(both[0].status().distance_m, abs=1e-6)
        assert found[0][1] == min(found[1][1], 16)
        assert found[0][0] == found[1][0]


def chain(shapes):
    """URDF of an arm with a joint between consecutive links, which have these shapes."""
    links = "".join(
        f'<link name="l{i}"><collision><origin xyz="0 0 0.1" rpy="0.3 {0.1 * i} 0.2"/>'
        f"<geometry>{shape}</geometry></collision></link>"
        for i, shape in enumerate(shapes)
    )
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="0 0 0.2"/><axis xyz="{i % 2} {1 - i % 2} 0"/>'
        '<limit lower="-1" upper="1.5" velocity="1" effort="9"/></joint>'
        for i in range(len(shapes) - 1)
    )
    return f'<robot name="chain">{links}{joints}</robot>'


def test_distances_of_boxes_are_coals(tmp_path):
    sizes = np.random.default_rng(0).uniform(0.01, 0.15, (8, 3))
    text = chain([f'<box size="{x} {y} {z}"/>' for x, y, z in sizes])
    (tmp_path / "boxes.urdf").write_text(text)
    found = servo_oracles.distances(str(tmp_path / "boxes.urdf"), 60, per_scene=20)
    assert found.farther < 1e-9
    assert found.nearer < 1e-9
    assert found.gradient < 1e-4


def test_an_arm_of_nine_joints_with_bodies_is_compiled():
    kinematics = ArmKinematics(parse_urdf(chain(['<sphere radius="0.03"/>'] * 10)))
    servo = choose_servo(kinematics, CollisionModel(kinematics))
    assert servo.not_compiled == ""
    before = servo.placement.translation
    for _ in range(50):
        servo.tick(servo.pose, np.array(((0, 0.1, 0), (0, 0, 0))), DT_S)
    assert (servo.placement.translation - before)[1] == pytest.approx(0.1 * 50 * DT_S, rel=0.2)


@pytest.mark.parametrize("weights", [(0.0,) * 6, (math.nan, *(1.0,) * 5), (-1.0, *(1.0,) * 5)])
def test_weights_that_are_none_are_refused(weights):
    with pytest.raises(ConfigurationError, match="weights"):
        CompiledServo(ArmKinematics(load_arm("ur5")), weights=weights)


def test_a_changed_tool_counts_from_the_next_tick():
    servo = made()
    before = servo.pose
    tool = Pose(Vector3(0.0, 0.0, 0.1), Quaternion(1.0, 0.0, 0.0, 0.0))
    servo.kinematics.set_tool(tool)
    there = servo.placement
    assert np.linalg.norm(servo.pose.position) == pytest.approx(np.linalg.norm(there.translation))
    assert servo.pose.position == pytest.approx(tuple(there.translation), abs=1e-12)
    servo.kinematics.set_tool(IDENTITY_POSE)
    servo.tick(before, STILL, DT_S)
    assert servo.status().error_m == pytest.approx(0.0, abs=1e-12)


# ---------------------------------------------------------------------------------------------
# Loading and selection


def test_the_compiled_one_is_chosen_wherever_there_is_one():
    servo = choose_servo(ArmKinematics(load_arm("gp8")))
    assert isinstance(servo, CompiledServo)
    assert servo.not_compiled == ""
    assert servo.status().compiled


@pytest.fixture
def loaded_anew():
    native.kernel_library.cache_clear()
    yield
    native.kernel_library.cache_clear()


@pytest.mark.usefixtures("loaded_anew")
@pytest.mark.parametrize(
    ("target", "name", "value", "words"),
    [
        (cardan, "__version__", "0.0.0", "is of version .*, cardan of 0.0.0: .*tools/native"),
        (native, "expected_layout", lambda: [1, 2], "other sources"),
    ],
)
def test_a_library_that_does_not_fit_is_not_used(monkeypatch, target, name, value, words):
    monkeypatch.setattr(target, name, value)
    with pytest.raises(NativePartError, match=words):
        native.kernel_library()
    servo = choose_servo(ArmKinematics(load_arm("ur5")))
    assert isinstance(servo, Servo)
    assert "tools/native" in servo.not_compiled
    assert not servo.status().compiled


@pytest.mark.usefixtures("loaded_anew")
def test_without_a_library_the_servo_in_python_moves_the_arm(monkeypatch, tmp_path):
    monkeypatch.setattr(native, "library_path", lambda: tmp_path / "libcardan_servo.so")
    servo = choice.choose_servo(ArmKinematics(load_arm("ur5")))
    assert isinstance(servo, Servo)
    assert "is not there" in servo.not_compiled
    assert servo.tick(servo.pose, STILL, DT_S) == 1.0


def test_both_languages_agree_on_every_field():
    library = native.kernel_library()
    for structure in (layout.CArm, layout.CState, layout.CProgram):
        assert ctypes.sizeof(structure) in layout.expected_layout()
    assert library.kernel_version().decode() == cardan.__version__


# ---------------------------------------------------------------------------------------------
# Resources of a tick

SOURCES = native.library_path().parent / "kernel"

OPTIMIZED = ("-O3", "-fno-tree-vectorize")
"""Compiler flags of tools/native."""

HARMLESS = {"atan2", "cos", "memcpy", "memset", "remainder", "sin", "sqrt"}
"""Functions of the C library that terminate, and use neither the heap nor a lock."""

LARGEST_FRAME_BYTES = 4096


@pytest.mark.matrix
@pytest.mark.skipif(
    None in (shutil.which("cc"), shutil.which("nm")), reason="no C compiler, or no nm beside it"
)
def test_a_tick_takes_no_memory_and_asks_the_system_for_nothing(tmp_path):
    """Checks all calls of other functions, except in `create.c`, which runs before the first
    tick."""
    theirs, ours = set(), set()
    for source in sorted(SOURCES.glob("*.c")):
        made = tmp_path / f"{source.stem}.o"
        flags = ("-std=c11", "-D_GNU_SOURCE", "-Wvla", "-Werror", "-fstack-usage", *OPTIMIZED)
        version = '-DCARDAN_VERSION="0"'
        subprocess.run(["cc", *flags, version, "-c", str(source), "-o", str(made)], check=True)
        found = subprocess.run(["nm", str(made)], check=True, capture_output=True, text=True)
        for kind, name in (line.split()[-2:] for line in found.stdout.splitlines()):
            if kind != "U":
                ours.add(name)
            elif source.name != "create.c":
                theirs.add(name.partition("@")[0])
    assert theirs - ours - {"_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"} <= HARMLESS
    frames = [
        line.split("\t") for each in tmp_path.glob("*.su") for line in each.read_text().splitlines()
    ]
    assert len(frames) > 20
    for where, size, kind in frames:
        assert kind == "static", where
        assert int(size) <= LARGEST_FRAME_BYTES, where


def test_a_tick_leaves_nothing_in_python():
    servo = made(safety_distance_m=0.5)
    goal = servo.pose

    def ticks(count):
        for number in range(count):
            turned = goal._replace(
                position=goal.position._replace(x=goal.position.x + 0.05 * math.sin(0.01 * number))
            )
            servo.tick(turned, STILL, DT_S)
        servo.status()

    def left():
        gc.collect()
        before = sys.getallocatedblocks()
        ticks(1000)
        gc.collect()
        return sys.getallocatedblocks() - before

    ticks(200)
    assert any(left() < 50 for _ in range(3))  # other threads may allocate once


def test_the_iterations_of_the_worst_tick_are_counted():
    """Goals that jump between obstacles, unlike any operator's."""
    kinematics = ArmKinematics(load_arm("pr2_right_arm"))
    boxes = [
        box_obstacle(
            f"box {i}",
            Vector3(0.7 * math.cos(i) - 0.1, 0.7 * math.sin(i) - 0.1, 0.2 * i - 0.8),
            Vector3(0.7 * math.cos(i) + 0.1, 0.7 * math.sin(i) + 0.1, 0.2 * i - 0.6),
        )
        for i in range(8)
    ]
    options = ServoOptions(safety_distance_m=0.6, policy=Policy.REACH)
    servo = CompiledServo(kinematics, CollisionModel(kinematics, boxes), options)
    generator = np.random.default_rng(0)
    home = servo.pose
    most = rows = 0
    for _ in range(3000):
        position = Vector3(*(np.array(home.position) + generator.normal(size=3)).tolist())
        turn = generator.normal(size=4)
        goal = Pose(position, Quaternion(*(turn / np.linalg.norm(turn)).tolist()))
        servo.tick(goal, generator.normal(size=(2, 3)), DT_S)
        now = servo._state.iterations
        assert 0 < now <= 2 * MAX_ITERATIONS
        most, rows = max(most, now), max(rows, servo._state.active)
        assert servo.status().iterations >= most
    assert rows > 10
    assert servo.status().failures == 0
    assert servo.status().iterations == most


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([0.0, 1e-12, 1e-6, 0.3, 30.0]))
def test_a_pose_is_moved_as_in_python_to_the_last_bit(seed, speed):
    servo, rng = CompiledServo(ArmKinematics(parse_urdf(PRISMATIC))), np.random.default_rng(seed)
    pose = Pose(
        Vector3(*rng.normal(size=3).tolist()),
        normalized(Quaternion(*rng.normal(size=4).tolist())),
        Frame.BASE,
    )
    servo.twist[:] = speed * rng.normal(size=(2, 3))
    linear, angular = servo.twist.tolist()
    for _ in range(20):
        dt_s = float(rng.choice([0.0005, 0.002, 0.008]))
        by_python = moved(pose, Vector3(*linear), Vector3(*angular), dt_s)
        pose = servo.moved(pose, dt_s)
        assert pose == by_python
        assert [type(part) for part in pose] == [Vector3, Quaternion, Frame]


def test_a_pose_that_is_none_is_not_moved():
    servo = CompiledServo(ArmKinematics(parse_urdf(PRISMATIC)))
    servo.twist[:] = 0.1
    for wrong in (None, (), (ZERO3, ZERO3, Frame.BASE), (("x", 0.0, 0.0), IDENTITY, Frame.BASE)):
        with pytest.raises(TypeError):
            servo.moved(wrong, 0.002)
    with pytest.raises(ValueError, match="direction"):
        servo.moved(Pose(ZERO3, Quaternion(0.0, 0.0, 0.0, 0.0), Frame.BASE), 0.002)


@pytest.mark.parametrize("make", [Servo, CompiledServo])
def test_targets_are_the_commanded_joints_and_their_velocities(make):
    servo = make(ArmKinematics(parse_urdf(PRISMATIC)))
    servo.place(np.array([0.1, 0.2, -0.3, 0.4]))
    servo.move_at(np.array([0.01, -0.02, 0.03, 0.0]))
    assert servo.targets() == ((0.1, 0.2, -0.3, 0.4), (0.01, -0.02, 0.03, 0.0))
