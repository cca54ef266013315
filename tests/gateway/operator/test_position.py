"""Position control in virtual time: the TCP follows the device's motion, without a step."""

import math

import pytest

from cardan.gateway.arm.status import Phase
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.mapping import AXES, MappingOptions
from cardan.gateway.operator.position import mirrors
from cardan.spatial import from_euler_zyx, norm, rotate, scale
from cardan.types import IDENTITY, ButtonEvent, DeviceLink, Frame, Pose, Quaternion, Vector3
from tests.gateway.device_pose_bench import DT_S, HAND, START, DevicePoseBench, close, displaced


class Bench(DevicePoseBench):
    """A device at poses that the test sets, followed while a button is held."""

    def __init__(self, limits=None, **options):
        super().__init__(limits=limits, deadman=("clutch",), deflections=(0.0,) * 6, **options)

    def hand(self, pose=HAND, clutch=True):
        """Move the device to `pose` at the speed of a human hand; without the clutch it is there at
        once."""
        buttons = frozenset({"clutch"} if clutch else ())
        self.device_goal = pose
        there = self.device.pose if clutch and "clutch" in self.device.buttons else pose
        self.device = self.device._replace(pose=there, buttons=buttons)
        return self

    def engage(self):
        return self.hand(clutch=False).run().hand().run(0.1)


def test_pressing_the_clutch_moves_nothing():
    bench = Bench().engage()
    assert bench.moved == (0, 0, 0)
    assert bench.core.phase is Phase.HOLDING


def test_the_tcp_moves_as_the_hand_did():
    bench = Bench().engage()
    bench.hand(displaced(0.05, -0.03, 0.02, rz=0.3)).run(2.0)
    assert close(bench.moved, (0.05, -0.03, 0.02))
    assert close(bench.turned, (0.0, 0.0, 0.3))


def test_nothing_is_overshot():
    bench = Bench(ReferenceLimits(linear_speed_m_s=0.25, linear_acceleration_m_s2=0.5)).engage()
    bench.hand(displaced(x=0.1))
    farthest = 0.0
    for _ in range(500):
        bench.run()
        farthest = max(farthest, bench.moved.x)
    assert 0.1 - 1e-6 <= farthest <= 0.1 + 1e-9


def test_scale_and_fixed_axes():
    bench = Bench(
        scale=(0.1, 0.1, 0.1, 1.0, 1.0, 1.0), axes=("x", "-y", "fixed", "fixed", "fixed", "rz")
    ).engage()
    bench.hand(displaced(0.1, 0.1, 0.1, 0.2, 0.2, 0.0)).run(1.0)
    assert close(bench.moved, (0.01, -0.01, 0.0))
    assert close(bench.turned, (0, 0, 0))


def test_axes_of_the_operator_who_stands_elsewhere():
    bench = Bench(yaw_deg=90.0).engage()
    bench.hand(displaced(x=0.04, rx=0.2)).run(2.0)
    assert close(bench.moved, (0.0, 0.04, 0.0))
    assert close(bench.turned, (0.0, 0.2, 0.0))


def test_axes_of_the_tool_and_of_a_turned_device():
    """Formula of the 2023 paper: H_start · R_L · δ · R_Lᵀ with R_L from leapFrameRPY."""
    bench = Bench(frame=Frame.TOOL, device_rpy_deg=(180.0, 0.0, -90.0)).engage()
    bench.hand(displaced(0.03, 0.01, 0.02, rx=0.1)).run(2.0)
    jump = from_euler_zyx(math.pi, 0.0, -math.pi / 2)
    expected = rotate(START.orientation, rotate(jump, Vector3(0.03, 0.01, 0.02)))
    assert close(bench.moved, expected)
    assert close(bench.turned, rotate(START.orientation, rotate(jump, Vector3(0.1, 0, 0))))


@pytest.mark.parametrize("frame", list(Frame))
def test_the_map_of_the_device_leads_to_the_tcp_and_ends_at_the_workspace(frame):
    limits = ReferenceLimits(workspace_y_m=(-0.05, 0.05), workspace_z_m=(0.35, 0.45))
    options = {"yaw_deg": 20.0} if frame is Frame.BASE else {}
    options |= {"frame": frame, "device_rpy_deg": (10.0, -20.0, 30.0)}
    bench = Bench(limits, scale=(0.5, 0.7, 0.9, 1.0, 1.0, 1.0), **options).engage()
    a, b, c, d, e, f, g, h, i = bench.core.device_map().linear
    x, y, z = way = (0.02, -0.01, 0.03)
    bench.hand(displaced(*way)).run(2.0)
    mapped = (a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)
    assert close(bench.moved, mapped)
    assert close(bench.mapped_device, bench.tcp.position)
    bench.hand(displaced(-0.1, 0.8, 0.4)).run(2.0)
    at = bench.mapped_device
    assert {abs(at.y), round(abs(at.z - 0.4), 9)} == {0.05}
    assert bench.core.device_map().linear[3:] == (0.0,) * 6


def test_a_new_grip_starts_from_where_the_tcp_is():
    bench = Bench().engage()
    bench.hand(displaced(x=0.05)).run(2.0).hand(displaced(x=0.05), clutch=False).run(0.5)
    bench.hand(displaced(x=-0.3), clutch=False).run(0.5)
    assert close(bench.moved, (0.05, 0, 0))
    bench.hand(displaced(x=-0.3)).run(0.5)
    assert close(bench.moved, (0.05, 0, 0))
    bench.hand(displaced(x=-0.28)).run(2.0)
    assert close(bench.moved, (0.07, 0, 0))


def test_letting_go_brakes_at_once():
    bench = Bench().engage()
    bench.hand(displaced(x=0.14)).run(0.3)
    speed = norm(bench.velocity[0])
    bench.hand(displaced(x=0.14), clutch=False).run(speed / 1.0 + 2 * DT_S)
    assert bench.core.at_rest
    x = bench.moved.x
    assert 0.0 < x < 0.13
    bench.run(0.5)
    assert bench.moved.x == x


def test_a_hand_too_far_ahead_slips():
    bench = Bench(slip_m=0.1, slip_rad=0.2).engage()
    bench.hand(displaced(y=0.5, rz=1.0))
    while bench.device.pose.position.y < HAND.position.y + 0.5 - 1e-9:
        bench.run()
    when_the_hand_stopped = bench.moved.y
    assert "slips" in bench.core.status().message
    bench.run(3.0)
    assert bench.core.status().message == ""
    assert bench.moved.y == pytest.approx(when_the_hand_stopped + 0.1, abs=2e-3)
    assert 0.2 <= bench.turned.z < 0.4
    before = bench.moved
    bench.hand(displaced(y=0.48, rz=1.0)).run(2.0)
    assert close(bench.moved, (before.x, before.y - 0.02, before.z), 1e-6)


@pytest.mark.parametrize(
    "change",
    [
        {"pose": None},
        {"pose": Pose(Vector3(math.nan, 0.0, 0.0), IDENTITY)},
        {"pose": Pose(Vector3(1e9, 0.0, 0.0), IDENTITY)},
        {"pose": Pose(HAND.position, Quaternion(0.0, 0.0, 0.0, 0.0))},
        {"pose": displaced(x=0.3)},
        {"pose": displaced(rx=2.5)},
        {"link": DeviceLink.STALE, "reason": "no frames"},
        {"link": DeviceLink.LOST, "reason": "the service is gone"},
    ],
)
def test_a_hand_that_is_lost_takes_itself_off_the_robot(change):
    bench = Bench().engage()
    bench.hand(displaced(x=0.1)).run(0.2)
    good = bench.device
    for _ in range(3):  # one would be enough
        bench.device = good._replace(**change)
        bench.device_goal = bench.device.pose
        bench.run()
    bench.device_goal = good.pose
    bench.device = good
    bench.run(0.4)
    assert bench.core.at_rest
    assert bench.core.phase is Phase.DISARMED
    where = bench.moved  # continuing the same grip does not count
    bench.run(0.5)
    assert bench.moved == where
    bench.hand(clutch=False).run().hand(displaced(x=0.3)).run(0.5)
    assert close(bench.moved, where)  # a new grip starts from here
    assert bench.core.phase is Phase.HOLDING


def test_a_clutch_held_in_silence_does_not_count():
    bench = Bench().engage()
    bench.hand(displaced(x=0.1)).run(0.1)
    bench.fresh = False
    bench.run(0.5)
    assert bench.core.at_rest
    assert "silent" in bench.core.status().message


@pytest.mark.matrix("Frame.BASE", "Frame.TOOL")
@pytest.mark.parametrize("frame", list(Frame))
def test_a_slip_moves_neither_axes_nor_anything_later(frame):
    """After a turn about another axis, a slip must neither accumulate nor become a motion."""
    bench = Bench(frame=frame, slip_rad=0.3).engage()
    bench.hand(displaced(x=0.1, rx=1.4)).run(4.0)
    before = bench.moved
    bench.hand(displaced(x=0.1, rx=1.4, hand=displaced(rz=1.2))).run(4.0)
    assert close(bench.moved, before, 1e-6)
    turned = bench.turned
    bench.run(10.0)
    assert bench.core.phase is Phase.HOLDING
    assert close(bench.turned, turned, 1e-6)


@pytest.mark.matrix("rx", "ry")
@pytest.mark.parametrize("axis", ["rx", "ry", "rz"])
def test_long_turns_of_the_hand_are_long_turns_scaled(axis):
    bench = Bench(scale=(1.0, 1.0, 1.0, 0.5, 0.5, 0.5), slip_rad=1.5).engage()
    for step in range(1, 40):
        bench.hand(displaced(**{axis: 0.1 * step})).run(0.2)
    bench.run(1.0)
    assert close(bench.turned, displaced_turn(axis, 1.95), 1e-3)


def displaced_turn(axis, angle):
    return tuple(angle if name == axis else 0.0 for name in ("rx", "ry", "rz"))


def test_a_clutch_tapped_between_two_ticks_is_a_new_grip():
    bench = Bench().engage()
    device = bench.device._replace(pose=displaced(x=0.01), stamp_s=bench.now_s + DT_S)
    bench.device_goal = device.pose
    tap = [ButtonEvent(bench.now_s, "clutch", False), ButtonEvent(bench.now_s, "clutch", True)]
    robot = bench.robot._replace(stamp_s=bench.now_s + DT_S)
    bench.core.tick(robot, device, tap)
    bench.device = device
    bench.run(1.0)
    assert bench.moved == (0, 0, 0)


def test_the_hand_may_tremble_while_it_waits():
    bench = Bench().engage()
    for step in range(200):
        bench.hand(displaced(x=1e-4 * math.sin(step))).run()
    assert norm(bench.moved) < 2e-4
    assert norm(scale(bench.turned, 1.0)) < 1e-9


def test_a_time_to_come_is_not_believed():
    bench = Bench().engage()
    bench.fresh = False
    bench.device = bench.device._replace(stamp_s=bench.now_s + 1000.0, pose=displaced(x=0.2))
    bench.run(0.5)
    assert norm(bench.moved) == 0.0
    assert bench.core.phase is Phase.DISARMED


@pytest.mark.parametrize(
    ("axes", "gone"),
    [
        (("x", "-y", "z"), True),
        (("y", "x", "z"), True),
        (("x", "x", "z"), True),
        (("-x", "fixed", "z"), False),
        (("y", "x", "fixed"), False),
        (("rx", "y", "z"), False),
        (("y", "x", "-z"), False),
    ],
)
def test_forces_have_no_way_back_through_a_mirror(axes, gone):
    axes = (*axes, *AXES[3:])
    assert mirrors(MappingOptions(axes=axes)) is gone
    assert (Bench(axes=axes).engage().core.device_map() is None) is gone
    flipped = MappingOptions(axes=axes, scale=(-1.0, *[1.0] * 5))
    if not gone and "fixed" not in axes and "rx" not in axes[:3]:
        assert mirrors(flipped)
