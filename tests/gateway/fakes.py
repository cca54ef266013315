"""Drivers without hardware and without a clock, for the gateway's tests."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

from cardan.common.bounds import Range
from cardan.common.options import Options
from cardan.drivers.base import OperatorDevice, RobotDriver
from cardan.errors import DeviceNotFoundError
from cardan.types import (
    IDENTITY,
    ButtonEvent,
    CommandKind,
    DeviceCapabilities,
    DeviceFeedback,
    DeviceLink,
    DeviceState,
    Pose,
    PoseCommand,
    RobotCapabilities,
    RobotCommand,
    RobotLink,
    RobotState,
    Vector3,
)

PERIOD_S = 0.004


@dataclass(frozen=True, kw_only=True)
class FakeDeviceOptions(Options):
    deflection: Annotated[float, Range(-1.0, 1.0, "", "full deflection")] = 1.0
    present: bool = True


class FakeDevice(OperatorDevice):
    """A device at rest for ten reads, then with dead-man "go" held and x deflected."""

    Options = FakeDeviceOptions
    capabilities = DeviceCapabilities(False, ("go", "grip"), frozenset({"led"}), False)

    def __init__(self, options: FakeDeviceOptions | None = None) -> None:
        super().__init__(options)
        self.looks, self.gripped = 0, False
        self.led: list[bool] = []
        self.is_open = False

    def open(self) -> None:
        if not self.options.present:
            raise DeviceNotFoundError("no fake device is plugged in")
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def diagnosis(self) -> tuple[str, ...]:
        return ("the device is fake",)

    def state(self) -> DeviceState:
        self.looks += 1
        moving = self.looks > 10
        axes = (self.options.deflection if moving else 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        buttons = frozenset({"go"} if moving else ())
        return DeviceState(time.monotonic(), DeviceLink.LIVE, axes, buttons)

    def button_events(self) -> list[ButtonEvent]:
        if self.looks < 50 or self.gripped:
            return []
        self.gripped = True
        return [ButtonEvent(time.monotonic(), "grip", True)]

    def _feedback(self, feedback: DeviceFeedback) -> None:
        assert feedback.led is not None
        self.led.append(feedback.led)


@dataclass(frozen=True, kw_only=True)
class FakeRobotOptions:
    cycles: int = 500
    takes_poses: bool = True


class FakeRobot(RobotDriver):
    """An ideal robot that is at its command, for `cycles` cycles as fast as they are read."""

    Options = FakeRobotOptions

    def __init__(self, options: FakeRobotOptions | None = None) -> None:
        super().__init__(options)
        self.commands: list[RobotCommand] = []
        self.outputs: list[tuple[bool | None, tuple[float, ...]]] = []
        self.enabled = 0
        self.is_open = False

    @property
    def capabilities(self) -> RobotCapabilities:
        kind = CommandKind.POSE if self.options.takes_poses else CommandKind.JOINT
        return RobotCapabilities(frozenset({kind}), PERIOD_S, 6, None, 1, 40)

    def open(self) -> None:
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def diagnosis(self) -> tuple[str, ...]:
        return ()

    def cycles(self) -> Iterator[RobotState]:
        pose = Pose(Vector3(0.5, 0.0, 0.8), IDENTITY)
        for sequence in range(self.options.cycles):
            yield RobotState(
                time.monotonic(), RobotLink.LIVE, 1, sequence, PERIOD_S, (0.0,) * 6, (), pose, "",
            )  # fmt: skip
            command = self.commands[-1]
            if isinstance(command, PoseCommand):
                pose = command.pose

    def send(self, command: RobotCommand) -> None:
        self.commands.append(command)

    def enable(self) -> None:
        self.enabled += 1

    def set_outputs(self, digital: bool | None = None, values: tuple[float, ...] = ()) -> None:
        self.outputs.append((digital, tuple(values)))

    def output_values(self) -> tuple[float, ...]:
        return self.outputs[-1][1] if self.outputs else (7.0,)

    def metrics(self) -> dict[str, float]:
        return {"lost": 0.0}
