"""Position control in virtual time: the TCP goes where the hand went, and never by a step."""

import math

import pytest

from cardan.gateway.engine import Phase, TeleopEngine, Watchdogs
from cardan.gateway.mapping import MappingOptions, Mode, TwistMapping
from cardan.gateway.reference import Reference, ReferenceLimits
from cardan.spatial import (
    add,
    from_euler_zyx,
    from_rotation_vector,
    multiply,
    norm,
    rotate,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import (
    IDENTITY,
    DeviceLink,
    DeviceState,
    Frame,
    Pose,
    RobotLink,
    RobotState,
    Vector3,
)

DT_S = 0.004
START = Pose(Vector3(0.5, 0.0, 0.4), from_euler_zyx(math.pi, 0.0, 0.3))
HAND = Pose(Vector3(0.1, -0.2, 0.3), from_euler_zyx(0.1, 0.2, 0.3))
NEUTRAL = (0.0,) * 6


class Rig:
    """An engine in position mode, a hand that is put somewhere, and an ideal robot."""

    def __init__(self, limits=None, **options):
        options = MappingOptions(mode=Mode.POSITION, deadman=("clutch",), **options)
        self.limits = limits or ReferenceLimits()
        self.engine = TeleopEngine(TwistMapping(options), Reference(self.limits), Watchdogs(), ())
        self.now_s = 100.0
        self.robot = RobotState(self.now_s, RobotLink.LIVE, 1, 0, DT_S, (0.0,) * 6, (), START, "")
        self.device = DeviceState(self.now_s, DeviceLink.LIVE, NEUTRAL, frozenset(), HAND)
        self.fresh = True
        self.fastest = 0.0

    @property
    def tcp(self):
        return self.robot.pose

    def hand(self, pose=HAND, clutch=True, link=DeviceLink.LIVE):
        buttons = frozenset({"clutch"} if clutch else ())
        self.device = self.device._replace(pose=pose, buttons=buttons, link=link)
        return self

    def run(self, seconds=DT_S):
        for _ in range(max(1, round(seconds / DT_S))):
            self.now_s += DT_S
            self.robot = self.robot._replace(stamp_s=self.now_s, sequence=self.robot.sequence + 1)
            if self.fresh:
                self.device = self.device._replace(stamp_s=self.now_s)
            before = self.tcp.position
            linear = self.engine.reference.linear
            command = self.engine.tick(self.robot, self.device)
            self.robot = self.robot._replace(pose=command.pose)
            speed = norm(subtract(self.tcp.position, before)) / DT_S
            assert speed <= self.limits.linear_speed_m_s * (1 + 1e-9)
            change = norm(subtract(self.engine.reference.linear, linear))
            assert change <= self.limits.linear_acceleration_m_s2 * DT_S * (1 + 1e-9)
            self.fastest = max(self.fastest, speed)
        return self

    def engage(self):
        return self.hand(clutch=False).run().hand().run(0.1)

    @property
    def moved(self):
        return subtract(self.tcp.position, START.position)

    @property
    def turned(self):
        return rotation_between(START.orientation, self.tcp.orientation)


def displaced(x=0.0, y=0.0, z=0.0, rx=0.0, ry=0.0, rz=0.0, hand=HAND):
    return Pose(
        add(hand.position, Vector3(x, y, z)),
        multiply(from_rotation_vector(Vector3(rx, ry, rz)), hand.orientation),
    )


def close(a, b, tolerance=1e-6):
    return all(abs(u - v) <= tolerance for u, v in zip(a, b, strict=True))


def test_pressing_the_clutch_moves_nothing():
    rig = Rig().engage()
    assert rig.moved == (0, 0, 0)
    assert rig.engine.phase is Phase.HOLDING


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
    leap = from_euler_zyx(math.pi, 0.0, -math.pi / 2)
    expected = rotate(START.orientation, rotate(leap, Vector3(0.03, 0.01, 0.02)))
    assert close(rig.moved, expected)
    assert close(rig.turned, rotate(START.orientation, rotate(leap, Vector3(0.1, 0, 0))))


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
    speed = rig.fastest
    rig.hand(displaced(x=0.14), clutch=False).run(speed / 1.0 + 2 * DT_S)
    assert rig.engine.at_rest
    x = rig.moved.x
    assert 0.0 < x < 0.13
    rig.run(0.5)
    assert rig.moved.x == x


def test_a_hand_too_far_ahead_slips():
    rig = Rig(slip_m=0.1, slip_rad=0.2).engage()
    rig.hand(displaced(y=0.5, rz=1.0)).run(3.0)
    assert close(rig.moved, (0.0, 0.1, 0.0), 1e-3)
    assert close(rig.turned, (0.0, 0.0, 0.2), 1e-3)
    rig.hand(displaced(y=0.48, rz=1.0)).run(2.0)
    assert close(rig.moved, (0.0, 0.08, 0.0), 1e-3)


@pytest.mark.parametrize(
    "change",
    [
        {"pose": None},
        {"pose": Pose(Vector3(math.nan, 0.0, 0.0), IDENTITY)},
        {"link": DeviceLink.STALE, "reason": "no frames"},
        {"link": DeviceLink.LOST, "reason": "the service is gone"},
    ],
)
def test_a_hand_that_is_lost_takes_itself_off_the_robot(change):
    rig = Rig().engage()
    rig.hand(displaced(x=0.1)).run(0.2)
    good = rig.device
    rig.device = good._replace(**change)
    rig.run(0.4)
    assert rig.engine.at_rest
    assert rig.engine.phase is Phase.DISARMED
    where = rig.moved
    rig.device = good  # The same grip, as if nothing had been: it does not count.
    rig.run(0.5)
    assert rig.moved == where
    rig.hand(clutch=False).run().hand(displaced(x=0.3)).run(0.5)
    assert close(rig.moved, where)  # A new one does, from here.
    assert rig.engine.phase is Phase.HOLDING


def test_a_clutch_held_in_silence_does_not_count():
    rig = Rig().engage()
    rig.hand(displaced(x=0.1)).run(0.1)
    rig.fresh = False
    rig.run(0.5)
    assert rig.engine.at_rest
    assert "silent" in rig.engine.status().message


def test_the_hand_may_tremble_while_it_waits():
    rig = Rig().engage()
    for step in range(200):
        rig.hand(displaced(x=1e-4 * math.sin(step))).run()
    assert norm(rig.moved) < 2e-4
    assert norm(scale(rig.turned, 1.0)) < 1e-9
