"""The loop of one arm answers each state of its robot, once and at once."""

import pytest

from cardan.errors import CommandError, DriverError
from cardan.gateway.arm.loop import ArmLoop
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
    """A robot, a controller and a device that note in what order they are asked."""

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
        self.log.append("hand")
        return DeviceState(0.0, DeviceLink.LIVE, (0.0,) * 6, frozenset({"left"}))

    def button_events(self):
        self.log.append("events")
        return [ButtonEvent(0.0, "left", True)]


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
    assert all_of_it.log == ["state 0", "hand", "events", "tick 0", "send 0"]
    assert all_of_it.given == (cycle.device, tuple(cycle.events))
    assert cycle.device.buttons == {"left"}
    assert cycle.events[0].pressed


def test_a_robot_that_ends_ends_the_loop():
    all_of_it = Recorded(0)
    assert list(ArmLoop(all_of_it, all_of_it, all_of_it).cycles()) == []
    assert all_of_it.log == []


def test_whoever_stops_looking_leaves_no_state_unanswered():
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
        (lambda: None, "its driver failed: {}() gave None"),
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


@pytest.mark.parametrize(
    ("call", "broken", "words"),
    [
        ("cycles", lambda: 1 / 0, "ZeroDivisionError: division by zero"),
        ("cycles", lambda: iter([None]), "cycles() gave None"),
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
