"""The simulated Omni's arm: kinematics, sensors, dynamics, motors, and energy balance."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from ctypes import c_double, c_int, c_long

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given, settings, strategies as st

from cardan_omni.protocol import Error, Info, State
from omni_virtual import LibHD, needs_library, program
from tests.examples import examples

pytestmark = [needs_library, pytest.mark.matrix]

Floats = npt.NDArray[np.float64]

POSITION = int(State.CURRENT_POSITION)
JOINTS = int(State.CURRENT_JOINT_ANGLES)
FORCE = int(State.CURRENT_FORCE)
COUNT_RAD = 2.0 * math.pi / 15000.0
STEP_N = 3.3 / 2047.0


@pytest.fixture
def hd() -> Iterator[LibHD]:
    yield from program()


def forward_mm(joints: Floats) -> Floats:
    """Reference 3.2."""
    t1, t2, t3 = joints
    r = 133.35 * math.cos(t2) + 133.35 * math.sin(t3)
    return np.array(
        [
            -r * math.sin(t1),
            133.35 * math.sin(t2) - 133.35 * math.cos(t3) + 23.35,
            r * math.cos(t1) - 168.35,
        ]
    )


def waypoint(
    time_s: float,
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0),
    grip: int = 1,
    buttons: int = 0,
    docked: int = 0,
    push_n: tuple[float, float, float] = (0.0, 0.0, 0.0),
    stiffness_n_m: tuple[float, float, float] = (200.0, 200.0, 200.0),
) -> str:
    numbers = (time_s, *position_m, *turn_rad, grip, buttons, docked, *push_n, *stiffness_n_m)
    return "waypoint " + " ".join(map(repr, numbers))


def resting(hd: LibHD, *lines: str) -> None:
    """Initialize a device and read its sensors once."""
    hd.init(*lines)
    hd.hdBeginFrame(hd.handle)
    hd.hdEndFrame(hd.handle)


# --- kinematics and sensors ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("position_mm", "joints_rad"),
    [
        ((0.0, -110.0, -35.0), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.7420, 0.5531)),
    ],
)
def test_joints_are_those_of_the_reference(
    hd: LibHD, position_mm: tuple[float, float, float], joints_rad: tuple[float, float, float]
) -> None:
    x, y, z = position_mm
    resting(hd, waypoint(0, (x / 1000, y / 1000, z / 1000)))
    assert hd.get(JOINTS) == pytest.approx(joints_rad, abs=2.5e-4)
    assert hd.get(POSITION) == pytest.approx(position_mm, abs=0.1)


def test_the_inkwell_is_where_the_reference_has_it(hd: LibHD) -> None:
    resting(hd, waypoint(0, docked=1))
    assert hd.truth().docked
    assert hd.get(JOINTS) == pytest.approx([0.0, 0.2689, -0.3708], abs=2.5e-4)
    assert hd.get(POSITION) == pytest.approx([0.0, -65.5107, -88.1142], abs=0.1)


@settings(max_examples=examples(60))
@given(
    x=st.floats(-0.08, 0.08),
    y=st.floats(-0.06, 0.06),
    z=st.floats(-0.035, 0.035),
    turn=st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8), st.floats(-0.8, 0.8)),
)
def test_the_position_is_that_of_whole_encoder_counts(
    x: float, y: float, z: float, turn: tuple[float, float, float]
) -> None:
    for hd in program():
        resting(hd, waypoint(0, (x, y, z), turn_rad=turn), "gimbal_noise 0")
        counts = hd.get(int(State.CURRENT_ENCODER_VALUES), 6, c_long)
        joints = np.array(hd.get(JOINTS))
        assert joints == pytest.approx(np.array(counts[:3]) * COUNT_RAD, abs=1e-12)
        position = np.array(hd.get(POSITION))
        assert position == pytest.approx(forward_mm(joints), abs=1e-9)
        assert np.abs(position - 1000 * np.array([x, y, z])).max() < 0.1
        # The transform has the hand's orientation, but for the gimbal's converters.
        transform = np.array(hd.get(int(State.CURRENT_TRANSFORM), 16)).reshape(4, 4).T
        assert transform[:3, 3] == pytest.approx(position)
        rotation = transform[:3, :3]
        assert np.abs(rotation.T @ rotation - np.eye(3)).max() < 5e-5
        assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-4)
        cx, cy, cz = np.cos(turn)
        sx, sy, sz = np.sin(turn)
        wanted = (
            np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
            @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
            @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        )
        assert np.abs(rotation - wanted).max() < 0.004


def test_one_count_at_the_center_is_as_large_as_the_reference_has_it(hd: LibHD) -> None:
    resting(hd)
    joints = np.array(hd.get(JOINTS))
    quanta = [
        np.abs(forward_mm(joints + np.eye(3)[i] * COUNT_RAD) - forward_mm(joints)) for i in range(3)
    ]
    assert np.max(quanta, axis=0) == pytest.approx([0.071, 0.041, 0.048], abs=0.001)


def test_torques_are_the_forces_by_the_jacobian(hd: LibHD) -> None:
    hd.init()
    largest = []
    for axis in range(3):
        hd.hdBeginFrame(hd.handle)
        hd.set(FORCE, *(3.3 * np.eye(3)[axis]))
        hd.hdEndFrame(hd.handle)
        torque = np.array(hd.get(int(State.LAST_JOINT_TORQUE)))
        joints = np.array(hd.get(JOINTS))
        for joint in range(3):
            step = 1e-6 * np.eye(3)[joint]
            column = (forward_mm(joints + step) - forward_mm(joints - step)) / 2e-6
            assert torque[joint] == pytest.approx(3.3 * column[axis], abs=1e-3)
        largest.append(np.abs(torque))
    assert np.max(largest, axis=0) == pytest.approx([556, 324, 374], abs=1.0)


def test_the_gimbal_has_its_own_scale_and_offset(hd: LibHD) -> None:
    resting(hd, waypoint(0, turn_rad=(0.3, 0.2, 0.1)))
    plain = hd.get(int(State.CURRENT_GIMBAL_ANGLES))
    rotation = hd.get(int(State.CURRENT_TRANSFORM), 16)
    hd.close()
    resting(hd, waypoint(0, turn_rad=(0.3, 0.2, 0.1)), "gimbal -1 -1 -1 3.14 -2.35 -3.14")
    offset = np.array([3.14, -2.35, -3.14])
    assert hd.get(int(State.CURRENT_GIMBAL_ANGLES)) == pytest.approx(offset - np.array(plain))
    assert hd.get(int(State.CURRENT_TRANSFORM), 16) == rotation


def still_gimbal(hd: LibHD, *lines: str) -> tuple[Floats, Floats, Floats]:
    """Return gimbal counts, transforms and angular velocities of a resting stylus."""
    hd.init(waypoint(0, turn_rad=(0.3, 0.2, 0.1)), *lines)
    rows: list[list[float]] = []

    def look() -> None:
        counts = hd.get(int(State.CURRENT_ENCODER_VALUES), 6, c_long)[3:]
        transform = hd.get(int(State.CURRENT_TRANSFORM), 16)
        rows.append([*counts, *transform, *hd.get(int(State.CURRENT_ANGULAR_VELOCITY))])

    hd.servo(look)
    hd.hdStartScheduler()
    hd.simStep(500)
    hd.close()
    table = np.array(rows)
    return table[:, :3], table[:, 3:19], table[:, 19:]


def test_the_gimbal_of_a_firewire_unit_is_noisy_and_its_seed_repeats_it(hd: LibHD) -> None:
    counts, transforms, rates = still_gimbal(hd)
    spread = np.ptp(counts, axis=0)
    assert ((spread >= 4) & (spread <= 6)).all()
    assert np.abs(counts.mean(axis=0) - np.median(counts, axis=0)).max() < 0.6  # no bias
    assert np.ptp(transforms[:, :12], axis=0).max() > 0.005
    assert np.ptp(transforms[:, 12:15], axis=0).max() == 0.0
    assert (rates[100:].std(axis=0) > 0.02).all()
    assert (np.abs(rates[100:]) < 3.0).all()
    again = still_gimbal(hd)
    assert (again[0] == counts).all()
    assert (again[2] == rates).all()
    assert (still_gimbal(hd, "seed 1")[0] != counts).any()


@pytest.mark.parametrize("line", ['model "Touch"', "gimbal_noise 0"])
def test_a_gimbal_without_noise_stands_still(hd: LibHD, line: str) -> None:
    counts, _, rates = still_gimbal(hd, line)
    assert np.ptp(counts, axis=0).max() == 0.0
    assert np.abs(rates).max() == 0.0


def test_the_sensors_are_a_tick_late_and_the_velocity_is_smooth(hd: LibHD) -> None:
    hd.init(waypoint(0), waypoint(1, (0.1, 0, 0)), waypoint(2, (0.1, 0, 0)), "friction 0")
    rows = []
    hd.servo(
        lambda: rows.append(
            (hd.truth().position_m[0], hd.get(POSITION)[0], hd.get(int(State.CURRENT_VELOCITY))[0])
        )
    )
    hd.hdStartScheduler()
    hd.simStep(1000)
    true, read, velocity = (np.array(column) for column in zip(*rows, strict=True))
    assert np.abs(read[501:] - 1000 * true[500:-1]).max() < 0.05
    assert velocity[700:] == pytest.approx(np.full(300, 100.0), abs=12.0)
    raw = np.diff(read[700:]) * 1000
    assert np.std(velocity[700:]) < 0.3 * np.std(raw)


# --- dynamics --------------------------------------------------------------------------------


def test_a_stylus_that_nobody_holds_droops(hd: LibHD) -> None:
    hd.init("grip 0", "droop 0.4")
    hd.hdStartScheduler()
    hd.simStep(200)
    assert hd.truth().position_m[1] < -0.005
    assert list(hd.truth().hand_force_n) == [0.0] * 3


def test_a_held_stylus_stays(hd: LibHD) -> None:
    hd.init("droop 1")
    hd.hdStartScheduler()
    hd.simStep(500)
    assert list(hd.truth().position_m) == pytest.approx([0.0] * 3, abs=1e-9)


def test_a_stylus_that_is_let_go_falls_as_a_real_one(hd: LibHD) -> None:
    hd.init("grip 0")
    hd.hdStartScheduler()
    heights = []
    for _ in range(4):
        hd.simStep(100)
        heights.append(hd.truth().position_m[1])
    assert heights[-1] < -0.03  # 0.04 N on 45 g, more and more
    assert np.diff(heights)[-1] < 1.5 * np.diff(heights)[0] < 0.0


def test_friction_holds_a_small_push_and_lets_a_larger_one_go(hd: LibHD) -> None:
    hd.init("grip 0", "droop 0")
    hd.hdStartScheduler()
    hd.simPush((c_double * 3)(0.1, 0.0, 0.0))
    hd.simStep(200)
    crept = hd.truth().position_m[0]
    assert crept < 0.001
    hd.simPush((c_double * 3)(0.5, 0.0, 0.0))
    hd.simStep(200)
    # (0.5 - 0.26) N on 45 g for 0.2 s, less the viscous part
    assert hd.truth().position_m[0] - crept == pytest.approx(0.5 * 0.24 / 0.045 * 0.04, rel=0.25)


def test_the_hand_is_a_spring_with_a_mass_only_while_it_grips(hd: LibHD) -> None:
    hd.init("friction 0", "viscous 0", "hand 0.2 0 200", "droop 0")
    hd.hdStartScheduler()
    hd.hand((0.02, 0.0, 0.0))
    xs = []
    for _ in range(1000):
        hd.simStep(1)
        xs.append(hd.truth().position_m[0])
    tops = [i for i in range(1, 999) if xs[i - 1] < xs[i] >= xs[i + 1]]
    period_s = 2 * math.pi * math.sqrt((0.045 + 0.2) / 200.0)
    assert np.diff(tops).mean() * 1e-3 == pytest.approx(period_s, rel=0.01)
    assert max(xs) == pytest.approx(0.04, rel=0.01)  # Energy is conserved.
    kinetic_j = hd.truth().kinetic_j
    speed = math.hypot(*hd.truth().velocity_m_s)
    assert kinetic_j == pytest.approx(0.5 * 0.045 * speed * speed)


def test_a_push_beside_the_spring_and_stiffness_by_axis(hd: LibHD) -> None:
    hd.init(
        waypoint(0, push_n=(0.0, 0.0, -1.0), stiffness_n_m=(400.0, 400.0, 50.0)),
        "friction 0",
        "hand 0.2 8 200",
    )
    hd.hdStartScheduler()
    hd.simStep(4000)
    assert hd.truth().position_m[2] == pytest.approx(-0.02, abs=5e-4)
    assert hd.truth().script_done == 1


def test_the_script_is_followed_and_loops(hd: LibHD) -> None:
    hd.init(
        waypoint(0, buttons=1),
        waypoint(0.5, (0.02, 0, 0), buttons=2),
        waypoint(1, (0.0, 0, 0), grip=0),
        "loop 1.5",
    )
    hd.hdStartScheduler()
    seen = {}
    for milliseconds in range(1, 2001):
        hd.simStep(1)
        truth = hd.truth()
        seen[milliseconds] = (truth.hand_target_m[0], truth.buttons, truth.gripped)
    assert seen[250][0] == pytest.approx(0.01, abs=1e-4)
    assert seen[1750][0] == pytest.approx(0.01, abs=1e-4)
    assert [seen[i][1] for i in (250, 750, 1250, 1750)] == [1, 2, 0, 1]
    assert [seen[i][2] for i in (250, 750, 1250, 1750)] == [1, 1, 0, 1]
    assert hd.truth().script_done == 0


def test_the_arm_ends_at_its_stops(hd: LibHD) -> None:
    hd.init("grip 0", "droop 0")
    hd.hdStartScheduler()
    for push in ((3.0, 0.0, 0.0), (0.0, -3.0, 0.0), (0.0, 0.0, 3.0), (-3.0, 3.0, 3.0)):
        hd.simPush((c_double * 3)(*push))
        hd.simStep(1000)
        truth = hd.truth()
        position = np.array(truth.position_m)
        assert np.linalg.norm(position - [0, 0.02335, -0.16835]) <= 0.2621
        assert balance_j(hd) == pytest.approx(0.0, abs=1e-9)
        assert truth.lost_j > 0.0


# --- motors ----------------------------------------------------------------------------------


@settings(max_examples=examples(40))
@given(force=st.tuples(st.floats(-1.8, 1.8), st.floats(-1.8, 1.8), st.floats(-1.8, 1.8)))
def test_the_motors_hold_whole_converter_steps_from_tick_to_tick(
    force: tuple[float, float, float],
) -> None:
    for hd in program():
        hd.init()
        hd.hdDisable(0x4002)
        hd.push_with(*force)
        hd.hdStartScheduler()
        hd.simStep(8)
        delivered = np.array(hd.truth().delivered_n)
        steps = delivered / STEP_N
        assert steps == pytest.approx(np.round(steps), abs=1e-6)
        assert np.abs(delivered - force).max() <= STEP_N / 2 + 1e-9
        assert list(hd.truth().commanded_n) == list(force)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_full_force_warms_the_motors_too_much_in_time(hd: LibHD, axis: int) -> None:
    hd.init("thermal 1.4", "hand 0.2 20 2000")
    force = 3.29 * np.eye(3)[axis]
    hd.hdDisable(0x4002)
    hd.push_with(*force)
    hd.hdStartScheduler()
    hd.simStep(20)
    while hd.truth().amplifier and hd.simNow() < 3.0:
        hd.simStep(1)
    # (3.3 / 0.88)² is 14 times the continuous power
    assert hd.simNow() == pytest.approx(-1.4 * math.log(1 - 1 / 14.06), rel=0.1)
    assert hd.errors() == [Error.WARM_MOTORS]
    assert list(hd.truth().delivered_n) == [0.0] * 3
    warm_s = hd.simNow()
    while not hd.truth().amplifier and hd.simNow() < 3.0:
        hd.simStep(1)
    assert hd.simNow() - warm_s == pytest.approx(1.4 * math.log(1 / 0.8), rel=0.05)


def test_the_continuous_force_can_be_held(hd: LibHD) -> None:
    hd.init("thermal 0.5", "hand 0.2 20 2000")
    hd.push_with(0.0, 0.0, 0.87)
    hd.hdStartScheduler()
    hd.simStep(5000)
    assert hd.errors() == []
    assert 0.9 < max(hd.get(int(Info.MOTOR_TEMPERATURE))) < 1.0


def test_torques_of_the_joints_are_held_as_torques(hd: LibHD) -> None:
    hd.init("friction 0", "hand 0.2 5 0")
    hd.hdDisable(0x4002)
    hd.servo(lambda: hd.set(int(State.CURRENT_JOINT_TORQUE), 50.0, 40.0, 30.0))
    hd.hdStartScheduler()
    hd.simStep(300)
    truth = hd.truth()
    assert np.linalg.norm(truth.position_m) > 0.003
    joints = np.array(hd.get(JOINTS))
    for joint, torque in enumerate((50.0, 40.0, 30.0)):
        step = 1e-6 * np.eye(3)[joint]
        column = (forward_mm(joints + step) - forward_mm(joints - step)) / 2e-6
        assert column @ np.array(truth.delivered_n) == pytest.approx(torque, abs=1.0)
    assert balance_j(hd) == pytest.approx(0.0, abs=1e-9)


# --- energy ----------------------------------------------------------------------------------


def balance_j(hd: LibHD) -> float:
    truth = hd.truth()
    return truth.hand_j + truth.delivered_j - truth.lost_j - truth.kinetic_j


@settings(max_examples=examples(25))
@given(
    seed=st.integers(0, 2**32),
    stiffness=st.floats(0.0, 3000.0),
    friction=st.floats(0.0, 1.0),
    hand=st.tuples(st.floats(0.0, 0.5), st.floats(0.0, 8.0)),
    grip=st.booleans(),
)
@example(seed=0, stiffness=0.0, friction=0.0, hand=(0.25, 0.0), grip=True)  # hits the stops
def test_energy_adds_up_whatever_happens(
    seed: int, stiffness: float, friction: float, hand: tuple[float, float], grip: bool
) -> None:
    rng = np.random.default_rng(seed)
    for hd in program():
        points = [waypoint(0.05 * i, tuple(rng.uniform(-0.05, 0.05, 3).tolist())) for i in range(8)]
        hd.init(
            *(points if grip else ["grip 0"]),
            f"friction {friction!r}",
            f"hand {hand[0]!r} {hand[1]!r} 200",
        )
        sent = []

        def wall(hd: LibHD = hd, sent: list[list[float]] = sent) -> None:
            x, y, z = hd.get(POSITION)
            force = [-stiffness * 1e-3 * c for c in (x, y, z)]
            size = math.hypot(*force)
            if size > 3.0:
                force = [3.0 * c / size for c in force]
            sent.append(force)
            hd.set(FORCE, *force)

        hd.servo(wall)
        hd.hdStartScheduler()
        lost_j = 0.0
        for _ in range(20):
            hd.simStep(20)
            assert balance_j(hd) == pytest.approx(0.0, abs=1e-9)
            assert hd.truth().lost_j >= lost_j - 1e-12
            lost_j = hd.truth().lost_j


def test_the_work_of_the_motors_is_that_of_a_held_force(hd: LibHD) -> None:
    hd.init(waypoint(0), waypoint(0.5, (0.03, 0.01, 0)), "friction 0.1")
    hd.push_with(-1.0, 0.5, 0.2)
    hd.hdStartScheduler()
    work_j, before = 0.0, hd.truth()
    for _ in range(400):
        hd.simStep(1)
        now = hd.truth()
        way = np.array(now.position_m) - np.array(before.position_m)
        work_j += float(np.array(before.delivered_n) @ way)
        before = now
        assert now.delivered_j == pytest.approx(work_j, abs=1e-9)
    assert work_j < -0.005


def test_a_stiff_wall_gives_energy_to_a_hand_that_damps_little(hd: LibHD) -> None:
    """A sampled wall is active beyond 2 b / T, by Colgate and Schenkel."""
    hd.init("friction 0", "viscous 0.1", "grip 0", "droop 0")
    hd.simPush((c_double * 3)(0.5, 0.0, 0.0))
    hd.hdDisable(0x4002)
    hd.servo(lambda: hd.set(FORCE, -1.0 * hd.get(POSITION)[0], 0.0, 0.0))
    hd.hdStartScheduler()
    hd.simStep(20)
    hd.simPush((c_double * 3)())
    hd.simStep(300)
    assert hd.truth().delivered_j > 0.005


# --- repeatable ------------------------------------------------------------------------------


def history(hd: LibHD, seed: int) -> list[tuple[float, ...]]:
    hd.init(
        f"seed {seed}",
        waypoint(0),
        waypoint(0.1, (0.03, 0.02, 0.01), buttons=1),
        waypoint(0.3, (0.0, -0.02, 0.01), buttons=2),
        "fault jitter 200",
        "fault button-bounce 8",
        "fault uncalibrated 1 0.2",
        "fault late-tick 4",
    )
    rows: list[tuple[float, ...]] = []

    def look() -> None:
        hd.set(FORCE, *(-0.05 * c for c in hd.get(POSITION)))
        buttons = hd.get(int(State.CURRENT_BUTTONS), 1, c_int)[0]
        rows.append((hd.simNow(), *hd.get(POSITION), buttons, hd.truth().delivered_j))

    hd.servo(look)
    hd.hdStartScheduler()
    hd.simStep(400)
    hd.close()
    return rows


def test_a_seed_makes_everything_the_same_again(hd: LibHD) -> None:
    first = history(hd, 7)
    assert history(hd, 7) == first
    other = history(hd, 8)
    assert other != first
    assert all(b[0] > a[0] for a, b in itertools.pairwise(first))
