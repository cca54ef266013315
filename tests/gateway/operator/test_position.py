"""Position control in virtual time: the TCP goes where the hand went, and never by a step."""

import math

import pytest

from cardan.gateway.arm.status import Phase
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.spatial import from_euler_zyx, norm, rotate, scale
from cardan.types import IDENTITY, ButtonEvent, DeviceLink, Frame, Pose, Quaternion, Vector3
from tests.gateway.device_pose_rig import DT_S, HAND, START, DevicePoseRig, close, displaced


class Rig(DevicePoseRig):
    """A hand that is put somewhere, and is followed while a button is held."""

    def __init__(self, limits=None, **options):
        super().__init__(limits=limits, deadman=("clutch",), deflections=(0.0,) * 6, **options)

    def hand(self, pose=HAND, clutch=True):
        """Send the hand to `pose`, as fast as hands are; without the clutch it is there at once."""
        buttons = frozenset({"clutch"} if clutch else ())
        self.device_goal = pose
        there = self.device.pose if clutch and "clutch" in self.device.buttons else pose
        self.device = self.device._replace(pose=there, buttons=buttons)
        return self

    def engage(self):
        return self.hand(clutch=False).run().hand().run(0.1)


def test_pressing_the_clutch_moves_nothing():
    rig = Rig().engage()
    assert rig.moved == (0, 0, 0)
    assert rig.core.phase is Phase.HOLDING


def test_the_tcp_moves_as_the_hand_did():
    rig = Rig().engage()
    rig.hand(displaced(0.05, -0.03, 0.02, rz=0.3)).run(2.0)
    assert close(rig.moved, (0.05, -0.03, 0.02))
    assert close(rig.turned, (0.0, 0.0, 0.3))


def test_nothing_is_overshot():
    rig = Rig(ReferenceLimits(linear_speed_m_s=0.25, linear_acceleration_m_s2=0.5)).engage()
    rig.hand(displaced(x=0.1))
    farthest = 0.0
    for _ in range(500):
        rig.run()
        farthest = max(farthest, rig.moved.x)
    assert 0.1 - 1e-6 <= farthest <= 0.1 + 1e-9


def test_scale_and_fixed_axes():
    rig = Rig(
        scale=(0.1, 0.1, 0.1, 1.0, 1.0, 1.0), axes=("x", "-y", "fixed", "fixed", "fixed", "rz")
    ).engage()
    rig.hand(displaced(0.1, 0.1, 0.1, 0.2, 0.2, 0.0)).run(1.0)
    assert close(rig.moved, (0.01, -0.01, 0.0))
    assert close(rig.turned, (0, 0, 0))


def test_axes_of_the_operator_who_stands_elsewhere():
    rig = Rig(yaw_deg=90.0).engage()
    rig.hand(displaced(x=0.04, rx=0.2)).run(2.0)
    assert close(rig.moved, (0.0, 0.04, 0.0))
    assert close(rig.turned, (0.0, 0.2, 0.0))


def test_axes_of_the_tool_and_of_a_turned_device():
    """The 2023 paper's: H_start · R_L · δ · R_Lᵀ with R_L from leapFrameRPY."""
    rig = Rig(frame=Frame.TOOL, device_rpy_deg=(180.0, 0.0, -90.0)).engage()
    rig.hand(displaced(0.03, 0.01, 0.02, rx=0.1)).run(2.0)
    jump = from_euler_zyx(math.pi, 0.0, -math.pi / 2)
    expected = rotate(START.orientation, rotate(jump, Vector3(0.03, 0.01, 0.02)))
    assert close(rig.moved, expected)
    assert close(rig.turned, rotate(START.orientation, rotate(jump, Vector3(0.1, 0, 0))))


def test_a_new_grip_starts_from_where_the_tcp_is():
    rig = Rig().engage()
    rig.hand(displaced(x=0.05)).run(2.0).hand(displaced(x=0.05), clutch=False).run(0.5)
    rig.hand(displaced(x=-0.3), clutch=False).run(0.5)
    assert close(rig.moved, (0.05, 0, 0))
    rig.hand(displaced(x=-0.3)).run(0.5)
    assert close(rig.moved, (0.05, 0, 0))
    rig.hand(displaced(x=-0.28)).run(2.0)
    assert close(rig.moved, (0.07, 0, 0))


def test_letting_go_brakes_at_once():
    rig = Rig().engage()
    rig.hand(displaced(x=0.14)).run(0.3)
    speed = norm(rig.velocity[0])
    rig.hand(displaced(x=0.14), clutch=False).run(speed / 1.0 + 2 * DT_S)
    assert rig.core.at_rest
    x = rig.moved.x
    assert 0.0 < x < 0.13
    rig.run(0.5)
    assert rig.moved.x == x


def test_a_hand_too_far_ahead_slips():
    rig = Rig(slip_m=0.1, slip_rad=0.2).engage()
    rig.hand(displaced(y=0.5, rz=1.0))
    while rig.device.pose.position.y < HAND.position.y + 0.5 - 1e-9:
        rig.run()
    when_the_hand_stopped = rig.moved.y
    assert "slips" in rig.core.status().message
    rig.run(3.0)
    assert rig.core.status().message == ""
    assert rig.moved.y == pytest.approx(when_the_hand_stopped + 0.1, abs=2e-3)
    assert 0.2 <= rig.turned.z < 0.4
    before = rig.moved
    rig.hand(displaced(y=0.48, rz=1.0)).run(2.0)
    assert close(rig.moved, (before.x, before.y - 0.02, before.z), 1e-6)


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
    rig = Rig().engage()
    rig.hand(displaced(x=0.1)).run(0.2)
    good = rig.device
    for _ in range(3):  # Once would do.
        rig.device = good._replace(**change)
        rig.device_goal = rig.device.pose
        rig.run()
    rig.device_goal = good.pose
    rig.device = good
    rig.run(0.4)
    assert rig.core.at_rest
    assert rig.core.phase is Phase.DISARMED
    where = rig.moved  # The same grip, as if nothing had been, does not count.
    rig.run(0.5)
    assert rig.moved == where
    rig.hand(clutch=False).run().hand(displaced(x=0.3)).run(0.5)
    assert close(rig.moved, where)  # A new one does, from here.
    assert rig.core.phase is Phase.HOLDING


def test_a_clutch_held_in_silence_does_not_count():
    rig = Rig().engage()
    rig.hand(displaced(x=0.1)).run(0.1)
    rig.fresh = False
    rig.run(0.5)
    assert rig.core.at_rest
    assert "silent" in rig.core.status().message


@pytest.mark.matrix("Frame.BASE", "Frame.TOOL")
@pytest.mark.parametrize("frame", list(Frame))
def test_a_slip_moves_neither_axes_nor_anything_later(frame):
    """A turn about another axis came before: a slip must not add up, nor turn into a motion."""
    rig = Rig(frame=frame, slip_rad=0.3).engage()
    rig.hand(displaced(x=0.1, rx=1.4)).run(4.0)
    before = rig.moved
    rig.hand(displaced(x=0.1, rx=1.4, hand=displaced(rz=1.2))).run(4.0)
    assert close(rig.moved, before, 1e-6)
    turned = rig.turned
    rig.run(10.0)
    assert rig.core.phase is Phase.HOLDING
    assert close(rig.turned, turned, 1e-6)


@pytest.mark.matrix("rx", "ry")
@pytest.mark.parametrize("axis", ["rx", "ry", "rz"])
def test_long_turns_of_the_hand_are_long_turns_scaled(axis):
    rig = Rig(scale=(1.0, 1.0, 1.0, 0.5, 0.5, 0.5), slip_rad=1.5).engage()
    for step in range(1, 40):
        rig.hand(displaced(**{axis: 0.1 * step})).run(0.2)
    rig.run(1.0)
    assert close(rig.turned, displaced_turn(axis, 1.95), 1e-3)


def displaced_turn(axis, angle):
    return tuple(angle if name == axis else 0.0 for name in ("rx", "ry", "rz"))


def test_a_clutch_tapped_between_two_ticks_is_a_new_grip():
    rig = Rig().engage()
    device = rig.device._replace(pose=displaced(x=0.01), stamp_s=rig.now_s + DT_S)
    rig.device_goal = device.pose
    tap = [ButtonEvent(rig.now_s, "clutch", False), ButtonEvent(rig.now_s, "clutch", True)]
    robot = rig.robot._replace(stamp_s=rig.now_s + DT_S)
    rig.core.tick(robot, device, tap)
    rig.device = device
    rig.run(1.0)
    assert rig.moved == (0, 0, 0)


def test_the_hand_may_tremble_while_it_waits():
    rig = Rig().engage()
    for step in range(200):
        rig.hand(displaced(x=1e-4 * math.sin(step))).run()
    assert norm(rig.moved) < 2e-4
    assert norm(scale(rig.turned, 1.0)) < 1e-9


def test_a_time_to_come_is_not_believed():
    rig = Rig().engage()
    rig.fresh = False
    rig.device = rig.device._replace(stamp_s=rig.now_s + 1000.0, pose=displaced(x=0.2))
    rig.run(0.5)
    assert norm(rig.moved) == 0.0
    assert rig.core.phase is Phase.DISARMED
