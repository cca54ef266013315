"""Tests common to all robot drivers: opening, the single loop, safe release of the robot,
checks."""

from __future__ import annotations

import math
import re
import threading
import time
from collections import Counter
from dataclasses import dataclass, field

import pytest

import cardan
from cardan.common.bounds import JOINT_POSITION, JOINT_TORQUE, JOINT_VELOCITY
from cardan.drivers.robot_core import (
    LoopingRobot,
    check_numbers,
    counts,
    implausible,
    joint_values,
    wrong_kind,
)
from cardan.errors import CommandError, NotOpenError
from cardan.types import (
    IDENTITY_POSE,
    CommandKind,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    PoseCommand,
    RobotCapabilities,
    RobotLink,
    RobotState,
    TorqueCommand,
)
from tests.waiting import WITHIN_S

KINDS = frozenset({CommandKind.HOLD, CommandKind.JOINT, CommandKind.TORQUE})


class Session:
    capabilities = RobotCapabilities(KINDS, 0.01, 2, None, 0, 0)

    def diagnosis(self, now_s: float) -> tuple[str, ...]:
        return (f"all is well at {now_s:g} s",)


@dataclass(frozen=True)
class Options:
    pass


class Robot(LoopingRobot[Session]):
    Options = Options
    title = "the test driver"

    def __init__(self, raising: bool = False) -> None:
        super().__init__()
        self._session = Session()
        self.log: list[str] = []
        self.raising = raising

    def _acquire(self) -> None:
        self.log.append("acquire")

    def _release(self) -> None:
        self.log.append("release")

    def _leave(self) -> None:
        self.log.append("leave")
        if self.raising:
            raise RuntimeError("the robot is gone")

    def _leave_within_s(self) -> float:
        return 5.0

    def _now_s(self) -> float:
        return 3.0

    def _states(self, loop):
        if self._loop != loop:
            return
        with self._looping(loop):
            while self._loop == loop:
                yield RobotState(0.0, RobotLink.LIVE, 1, 1, 0.01, (), (), None, "")

    def send(self, command) -> None:
        self._require_open()


def test_what_is_not_open_says_so():
    robot = Robot()
    with pytest.raises(NotOpenError, match=r"the test driver is not open; call open\(\)"):
        robot.cycles()
    with pytest.raises(NotOpenError):
        robot.send(HoldCommand())
    assert robot.diagnosis() == ("the test driver is not open",)
    robot.close()
    assert robot.log == []
    with robot:
        assert robot.diagnosis() == ("all is well at 3 s",)


def test_opening_and_closing_twice_is_fine():
    robot = Robot()
    robot.open()
    robot.open()
    robot.close()
    robot.close()
    assert robot.log == ["acquire", "leave", "release"]


@pytest.mark.parametrize("how", ["break", "exception", "close"])
def test_the_robot_is_left_once_however_the_loop_ends(how):
    robot = Robot()
    robot.open()
    states = robot.cycles()
    next(states)
    if how == "break":
        states.close()
    elif how == "exception":
        with pytest.raises(KeyError):
            states.throw(KeyError("the application"))
    else:
        robot.close()
        assert list(states) == []
    assert robot.log.count("leave") == 1


def test_a_newer_loop_ends_the_one_before_and_takes_over_the_robot():
    robot = Robot()
    with robot:
        first = robot.cycles()
        next(first)
        second = robot.cycles()
        assert list(first) == []
        assert "leave" not in robot.log
        next(second)


def test_a_loop_of_an_earlier_opening_yields_nothing():
    robot = Robot()
    with robot:
        old = robot.cycles()
    assert list(old) == []
    with robot:
        assert list(old) == []


def test_close_never_raises_and_releases_all_the_same():
    robot = Robot(raising=True)
    robot.open()
    robot.close()
    assert robot.log == ["acquire", "leave", "release"]


def test_close_waits_for_a_loop_in_another_thread():
    robot = Robot()
    robot.open()
    inside, go_on = threading.Event(), threading.Event()

    def loop() -> None:
        for _ in robot.cycles():
            inside.set()
            go_on.wait(5.0)
            robot.log.append("turn")

    thread = threading.Thread(target=loop)
    thread.start()
    assert inside.wait(5.0)
    closing = threading.Thread(target=robot.close)
    closing.start()
    deadline_s = time.monotonic() + WITHIN_S
    while robot._loop < 2 and time.monotonic() < deadline_s:
        pass
    assert "release" not in robot.log
    go_on.set()
    thread.join(5.0)
    closing.join(5.0)
    assert robot.log == ["acquire", "turn", "leave", "release"]


def test_numbers_of_a_command():
    joints = JointCommand((1.0, 2.0), (3.0, 4.0))
    assert joint_values("it", joints, KINDS) == (
        ("positions", (1.0, 2.0), JOINT_POSITION),
        ("velocities", (3.0, 4.0), JOINT_VELOCITY),
    )
    alone = joint_values("it", JointCommand((1.0, 2.0)), KINDS)
    assert alone == (("positions", (1.0, 2.0), JOINT_POSITION),)
    torques = joint_values("it", TorqueCommand((5.0, 6.0)), KINDS)
    assert torques == (("torques", (5.0, 6.0), JOINT_TORQUE),)
    assert joint_values("it", HoldCommand(), KINDS) == ()


def test_commands_that_cannot_be():
    with pytest.raises(CommandError, match="it takes no pose; it takes hold, joint, torque"):
        joint_values("it", PoseCommand(IDENTITY_POSE), KINDS)
    with pytest.raises(CommandError, match="takes no joint velocity"):
        joint_values("it", JointVelocityCommand((0.0, 0.0)), KINDS)
    with pytest.raises(CommandError, match="external_axes: it has none"):
        joint_values("it", JointCommand((0.0, 0.0), None, (0.1,)), KINDS)
    assert "takes no 'nothing'" in str(wrong_kind("it", "nothing", KINDS))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ((0.0,), "positions: 1 values for 2 joints"),
        ((0.0, math.nan), "finite, and -2000 to 2000 rad or m: 250 turns"),
        ((math.inf, 0.0), "finite"),
        ((-2000.1, 0.0), "-2000 to 2000"),
        ((None, 0.0), "finite"),
    ],
)
def test_numbers_that_are_none(values, words):
    with pytest.raises(CommandError, match=words):
        check_numbers("positions", values, JOINT_POSITION, 2)


def test_each_number_may_be_as_large_as_its_range():
    check_numbers("positions", (2000.0, -2000.0), JOINT_POSITION, 2)


NAUGHT = RobotState(
    stamp_s=0.0,
    link=RobotLink.LIVE,
    session=1,
    sequence=1,
    period_s=0.004,
    joints=(0.0, 0.5),
    external_axes=(),
    pose=IDENTITY_POSE,
    hold_reason="",
)


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ({"joints": (0.0, 1e300)}, r"joints: \(0.0, 1e\+300\)"),
        ({"joints": (0.0, math.nan)}, "joints"),
        ({"external_axes": (-2001.0,)}, "external_axes"),
        ({"velocities": (0.0, 1e4)}, "velocities"),
        ({"torques": (0.0, 1e6)}, "torques"),
        ({"pose": IDENTITY_POSE._replace(position=(0.0, 1e6, 0.0))}, "position: .* -100 to 100 m"),
        (
            {"pose": IDENTITY_POSE._replace(orientation=(0.5, 0.0, 0.0, 0.0))},
            r"orientation: .* has length 0.5; a rotation has length 1 \(0.99 to 1.01 is taken\)",
        ),
        ({"pose": IDENTITY_POSE._replace(orientation=(2.0, 0.0, 0.0, 0.0))}, "has length 2"),
    ],
)
def test_what_no_robot_measures(part, words):
    assert implausible(NAUGHT) == ""
    assert re.search(words, implausible(NAUGHT._replace(**part)))


def test_counts_are_the_numbers_of_a_dataclass():
    @dataclass
    class Counters:
        lost: int = 3
        age_s: float = 0.5
        kinds: Counter[str] = field(default_factory=Counter)

    assert counts(Counters()) == {"lost": 3.0, "age_s": 0.5}


MISSHAPEN = [None, "hold", (), JointCommand(None), JointCommand(("a",) * 6), PoseCommand(None)]
MISSHAPEN += [PoseCommand((1.0, 2.0)), JointVelocityCommand(7), JointCommand((10**400, 0.5))]


@pytest.mark.parametrize("command", MISSHAPEN, ids=str)
@pytest.mark.parametrize(
    ("driver", "options"),
    [
        ("sim_arm", {"pacing": "virtual"}),
        ("motoros", {"host": "127.0.0.1"}),
        ("abb_egm", {"listen_host": "127.0.0.1", "listen_port": 0}),
        ("abb_egm", {"listen_host": "127.0.0.1", "listen_port": 0, "mode": "joint"}),
    ],
)
def test_what_is_no_command_is_refused_in_words(driver, options, command):
    with (
        cardan.open_robot(driver, **options) as robot,
        pytest.raises(CommandError, match=r"takes no|cannot take|values for|; every value"),
    ):
        robot.send(command)


def test_threads_that_open_one_robot_open_it_once():
    class Slow(Robot):
        def _acquire(self) -> None:
            super()._acquire()
            never.wait(0.2)  # time for the other thread

    robot, never = Slow(), threading.Event()
    threads = [threading.Thread(target=robot.open) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    robot.close()
    assert robot.log == ["acquire", "leave", "release"]
