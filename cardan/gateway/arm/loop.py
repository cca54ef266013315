"""The loop of one arm: the robot is the clock, and each of its states is answered at once."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from cardan.common.plugins import reason
from cardan.drivers.base import OperatorDevice, RobotDriver
from cardan.drivers.foreign import FAILURES, RobotCalls, device_problem, is_foreign, robot_problem
from cardan.gateway.arm.controller import ArmController
from cardan.types import (
    NEUTRAL,
    NEVER_S,
    ButtonEvent,
    DeviceLink,
    DeviceState,
    RobotCommand,
    RobotState,
)

_log = logging.getLogger(__name__)


class Cycle(NamedTuple):
    """A control instant whose command has been sent."""

    robot: RobotState
    device: DeviceState | None
    """None without an operator device."""
    events: Sequence[ButtonEvent]
    command: RobotCommand
    """The controller's answer."""


class ArmLoop:
    """Joins a robot, its controller and, if there is one, an operator device."""

    def __init__(
        self, robot: RobotDriver, controller: ArmController, device: OperatorDevice | None = None
    ) -> None:
        """The caller opens and closes them."""
        self.robot, self.controller, self.device = robot, controller, device
        self._problem = ""
        """The last failure of the device's driver."""
        self._calls = RobotCalls(robot)

    def cycles(self) -> Iterator[Cycle]:
        """Answer each of the robot's states, then yield it: work in the loop's body delays only the
        next command. Raises DriverError if the robot's driver fails.
        """
        controller, device, calls = self.controller, self.device, self._calls
        tick, send = controller.tick, self.robot.send
        foreign = device is not None and is_foreign(device)
        newest: DeviceState | None = None
        events: Sequence[ButtonEvent] = ()
        for state in self._states():
            if device is not None:
                try:
                    newest, events = device.state(), device.button_events()
                except FAILURES as error:
                    newest, events = self._failed(reason(error), error), ()
                if foreign and (problem := device_problem(newest, events)):
                    newest, events = self._failed(problem), ()
            command = tick(state, newest, events)
            try:
                send(command)
            except FAILURES as error:
                calls.check(error)
                raise
            yield Cycle(state, newest, events, command)

    def _states(self) -> Iterator[RobotState]:
        foreign = is_foreign(self.robot)
        with self._calls:
            for state in self.robot.cycles():
                if foreign and (problem := robot_problem(state)):
                    raise self._calls.failed(problem)
                yield state

    def _failed(self, problem: str, error: BaseException | None = None) -> DeviceState:
        """Return the state of a device whose driver breaks its contract: a lost device; the session
        goes on."""
        if problem != self._problem:
            self._problem = problem
            _log.warning("%s failed: %s", type(self.device).__name__, problem)
            _log.debug("it failed here", exc_info=error)
        words = f"its driver failed: {problem}"
        return DeviceState(NEVER_S, DeviceLink.LOST, NEUTRAL, frozenset(), reason=words)
