"""The loop of one arm answers each robot state exactly once, without delay."""

import math
import sys

import numpy as np
import pytest

from cardan.drivers.foreign import checked_lines, counted
from cardan.errors import CommandError, DriverError, MotionLoopError
from cardan.gateway.arm.loop import ArmLoop
from cardan.gateway.arm.loop_link import LoopLink
from cardan.types import (
    ButtonEvent,
    DeviceLink,
    DeviceState,
    HoldCommand,
    JointVelocityCommand,
    RobotLink,
    RobotState,
)


class Recorded:
    """A robot, a controller and a device that log the order of their calls."""

    def __init__(self, ticks=3):
        self.ticks, self.log = ticks, []

    def cycles(self):
        for number in range(self.ticks):
            self.log.append(f"state {number}")
            yield RobotState(
                float(number), RobotLink.LIVE, 1, number, 0.004, (), (), None, ""
            )  # fmt: skip

    def tick(self, robot, device=None, events=()):
        self.log.append(f"tick {robot.sequence}")
        self.given = device, tuple(events)
        return JointVelocityCommand((float(robot.sequence),))

    def send(self, command):
        self.log.append(f"send {command.velocities[0]:.0f}")

    def state(self):
        self.log.append("device")
        return DeviceState(0.0, DeviceLink.LIVE, (0.0,) * 6, frozenset({"left"}))

    def button_events(self):
        self.log.append("events")
        return [ButtonEvent(0.0, "left", True)]


def test_an_errand_that_was_refused_is_not_run_by_the_next_loop():
    link, done = LoopLink(), []
    with pytest.raises(MotionLoopError, match="not open"):
        link.do(lambda: done.append(1))
    link.begin()
    link.run_due()
    assert not done


def test_each_state_is_answered_before_it_is_shown():
    all_of_it = Recorded()
    loop = ArmLoop(all_of_it, all_of_it)
    for number, cycle in enumerate(loop.cycles()):
        all_of_it.log.append("shown")
        assert cycle.robot.sequence == number
        assert cycle.device is None
        assert cycle.events == ()
    assert all_of_it.log == [
        words
        for number in range(3)
        for words in (f"state {number}", f"tick {number}", f"send {number}", "shown")
    ]


def test_the_device_is_looked_at_in_the_tick_that_it_drives():
    all_of_it = Recorded(1)
    loop = ArmLoop(all_of_it, all_of_it, all_of_it)
    (cycle,) = loop.cycles()
    assert all_of_it.log == ["state 0", "device", "events", "tick 0", "send 0"]
    assert all_of_it.given == (cycle.device, tuple(cycle.events))
    assert cycle.device.buttons == {"left"}
    assert cycle.events[0].pressed


def test_a_robot_that_ends_ends_the_loop():
    all_of_it = Recorded(0)
    assert list(ArmLoop(all_of_it, all_of_it, all_of_it).cycles()) == []
    assert all_of_it.log == []


def test_a_caller_that_stops_looking_leaves_no_state_unanswered():
    class Holding(Recorded):
        def tick(self, robot, device=None, events=()):
            super().tick(robot, device, events)
            return HoldCommand()

        def send(self, command):
            self.log.append(command.kind.value)

    all_of_it = Holding()
    for _ in ArmLoop(all_of_it, all_of_it).cycles():
        break
    assert all_of_it.log == ["state 0", "tick 0", "hold"]


@pytest.mark.parametrize("call", ["state", "button_events"])
@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (lambda: 1 / 0, "its driver failed: ZeroDivisionError: division by zero"),
        (lambda: None, "its driver failed: {}() returned None"),
        (lambda: sys.exit(3), "its driver failed: SystemExit: 3"),
    ],
)
def test_a_device_whose_driver_fails_is_lost_until_it_no_longer_does(call, broken, words, caplog):
    robot, device = Recorded(3), Recorded()
    cycles = ArmLoop(robot, robot, device).cycles()
    assert next(cycles).device.link is DeviceLink.LIVE
    good = getattr(device, call)
    setattr(device, call, broken)
    lost = next(cycles)
    assert (lost.device.link, lost.device.reason) == (DeviceLink.LOST, words.format(call))
    assert (lost.device.buttons, lost.events) == (frozenset(), ())
    assert robot.log[-1] == "send 1"
    setattr(device, call, good)
    assert next(cycles).device.link is DeviceLink.LIVE
    assert len(caplog.records) == 1


LIVE = DeviceState(0.0, DeviceLink.LIVE, (0.0,) * 6, frozenset())
SILENT = RobotState(0.0, RobotLink.WAITING, 1, 0, 0.004, (), (), None, "")


@pytest.mark.parametrize(
    ("call", "given", "words"),
    [
        ("state", LIVE._replace(link="live"), "state() returned the link 'live'"),
        (
            "state",
            LIVE._replace(axes=(0.1, 0.1)),
            "state() returned the axes (0.1, 0.1), which are",
        ),
        ("state", LIVE._replace(axes=("0.1",) * 6), "state() returned the axes ('0.1', "),
        ("state", LIVE._replace(axes=None), "state() returned the axes None"),
        ("state", LIVE._replace(buttons=["left"]), "state() returned the buttons ['left']"),
        ("state", LIVE._replace(stamp_s=None), "state() returned the time None"),
        ("state", LIVE._replace(stamp_s=math.nan), "state() returned the time nan"),
        ("state", LIVE._replace(pose=5), "state() returned the pose 5"),
        ("button_events", [1], "button_events() returned 1 for an event"),
        ("button_events", (None,), "button_events() returned None for an event"),
    ],
)
def test_a_part_of_what_a_device_gives_that_is_none_is_named(call, given, words):
    robot, device = Recorded(1), Recorded()
    setattr(device, call, lambda: given)
    (cycle,) = ArmLoop(robot, robot, device).cycles()
    assert cycle.device.link is DeviceLink.LOST
    assert cycle.device.reason.startswith(f"its driver failed: {words}")
    assert cycle.events == ()


@pytest.mark.parametrize("given", ["abc", (5,), ("fine", None), 5])
def test_a_diagnosis_is_lines_of_text(given):
    with pytest.raises(TypeError):
        checked_lines(given)
    assert checked_lines(("fine",)) == ["fine"]


def test_what_a_driver_counts_are_numbers():
    assert counted({"lost": 1, "period_s": 0.1}) == {"lost": 1, "period_s": 0.1}
    with pytest.raises(TypeError, match=r"metrics\(\) returned 'x' for 'lost', not a number"):
        counted({"lost": "x"})


@pytest.mark.parametrize("number", [1, True, np.float32(1.0), np.float64(1.0), np.int64(1)])
def test_any_kind_of_number_is_one(number):
    robot, device = Recorded(1), Recorded()
    device.state = lambda: LIVE._replace(stamp_s=number, axes=(number,) * 6)
    (cycle,) = ArmLoop(robot, robot, device).cycles()
    assert cycle.device.link is DeviceLink.LIVE


@pytest.mark.parametrize(
    ("call", "broken", "words"),
    [
        (
            "cycles",
            lambda: iter([SILENT._replace(link="live")]),
            "cycles() returned the link 'live'",
        ),
        (
            "cycles",
            lambda: iter([SILENT._replace(hold_reason=None)]),
            "cycles() returned the hold_reason None",
        ),
        (
            "cycles",
            lambda: iter([SILENT._replace(joints=(None,))]),
            "cycles() returned the joints (None,), which are not numbers",
        ),
        (
            "cycles",
            lambda: iter([SILENT._replace(velocities=("fast",))]),
            "cycles() returned the velocities ('fast',), which are not numbers",
        ),
        (
            "cycles",
            lambda: iter([SILENT._replace(stamp_s=math.nan)]),
            "cycles() returned the stamp_s nan, which is not a finite number",
        ),
        (
            "cycles",
            lambda: iter([SILENT._replace(period_s=math.inf)]),
            "cycles() returned the period_s inf, which is not a finite number",
        ),
        ("cycles", lambda: sys.exit(3), "SystemExit: 3"),
        ("send", lambda _command: sys.exit(), "SystemExit"),
        ("cycles", lambda: 1 / 0, "ZeroDivisionError: division by zero"),
        ("cycles", lambda: iter([None]), "cycles() returned None"),
        ("send", lambda _command: 1 / 0, "ZeroDivisionError: division by zero"),
    ],
)
@pytest.mark.parametrize("device", [None, Recorded()], ids=["alone", "with a device"])
def test_a_robot_whose_driver_fails_is_named(call, broken, words, device):
    robot = Recorded(3)
    setattr(robot, call, broken)
    with pytest.raises(DriverError) as caught:
        list(ArmLoop(robot, robot, device).cycles())
    assert str(caught.value) == f"the robot's driver Recorded failed: {words}"


@pytest.mark.parametrize("error", [CommandError("no such kind"), MemoryError()])
def test_what_is_said_of_the_command_or_of_the_computer_stays_as_it_is(error):
    def send(_command):
        raise error

    robot = Recorded(3)
    robot.send = send
    with pytest.raises(type(error)) as caught:
        list(ArmLoop(robot, robot).cycles())
    assert caught.value is error


def test_what_the_controller_raises_is_no_fault_of_the_driver():
    robot, controller = Recorded(3), Recorded()
    controller.tick = lambda *_all: 1 / 0
    with pytest.raises(ZeroDivisionError):
        list(ArmLoop(robot, controller).cycles())
