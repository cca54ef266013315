"""The loop of one arm: the robot is the clock, and each of its states is answered at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from cardan.drivers.base import OperatorDevice, RobotDriver
from cardan.gateway.arm.controller import ArmController
from cardan.types import ButtonEvent, DeviceState, RobotCommand, RobotState


class Cycle(NamedTuple):
    """One control instant, after its command has left."""

    robot: RobotState
    device: DeviceState | None
    """None without an operator device."""
    events: Sequence[ButtonEvent]
    command: RobotCommand
    """The controller's answer."""


class ArmLoop:
    """Joins a robot, its controller and an operator device, where there is one."""

    def __init__(
        self, robot: RobotDriver, controller: ArmController, device: OperatorDevice | None = None
    ) -> None:
        """The caller opens and closes them."""
        self.robot, self.controller, self.device = robot, controller, device

    def cycles(self) -> Iterator[Cycle]:
        """Answer each of the robot's states, then yield it: work in the loop's body delays only the
        next command."""
        robot, controller, device = self.robot, self.controller, self.device
        tick, send = controller.tick, robot.send
        if device is None:
            for state in robot.cycles():
                command = tick(state)
                send(command)
                yield Cycle(state, None, (), command)
            return
        for state in robot.cycles():
            hand = device.state()
            events = device.button_events()
            command = tick(state, hand, events)
            send(command)
            yield Cycle(state, hand, events, command)
