"""The two interfaces of a driver: all that the gateway knows about hardware.

A driver module opens one kind of device or controller and speaks its protocol, nothing else. It
never imports the gateway, so that other projects can import drivers alone. Third parties add
theirs through the entry-point group ``cardan.drivers`` (see :mod:`cardan.drivers.registry`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Any, ClassVar, NamedTuple, TypeVar

from cardan.errors import CommandError
from cardan.types import (
    ButtonEvent,
    DeviceCapabilities,
    DeviceFeedback,
    DeviceState,
    RobotCapabilities,
    RobotCommand,
    RobotState,
)

_D = TypeVar("_D", bound="Driver")


class Driver(ABC):
    """What operator devices and robots have in common: options, open, close, diagnosis."""

    Options: ClassVar[type[Any]]
    """A frozen dataclass with a default for every field; the configuration file's table of this
    driver is checked against it. Its ``__post_init__`` raises OptionError for a bad value, as
    :func:`cardan.options.check_options` does by the annotations."""
    summary: ClassVar[str] = ""
    """What it drives, in a few words; lists and tables begin with it."""
    page: ClassVar[str] = ""
    """Its documentation: a page of Cardan's docs/, or a URL."""
    peer: ClassVar[str] = ""
    """The simulated peer that stands in for the hardware: ``cardan sim PEER``."""

    def __init__(self, options: Any = None) -> None:
        self.options = self.Options() if options is None else options

    @abstractmethod
    def open(self) -> None:
        """Acquire the device. Raises a DriverError that says what to do; opening twice is fine."""

    @abstractmethod
    def close(self) -> None:
        """Release the device, leaving it safe. Never raises; closing twice is fine."""

    @abstractmethod
    def diagnosis(self) -> tuple[str, ...]:
        """What stands in the way or deserves attention, in plain words, worst first."""

    def metrics(self) -> dict[str, float]:
        """Live figures by name; times in s, ratios in 0..1, counts as whole numbers."""
        return {}

    def __enter__(self: _D) -> _D:
        self.open()
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


class FoundDevice(NamedTuple):
    """A device that is plugged in, for ``cardan devices``."""

    name: str
    identity: str
    """USB vendor and product ("256f:c635"), a Bluetooth address, or empty."""
    transport: str
    path: str
    """What the driver's options call it."""
    obstacle: str = ""
    """What stands in the way of opening it, in words; empty: nothing known."""


class OperatorDevice(Driver):
    """A hand-held device. It reads itself (usually in a thread of its own)."""

    gives: ClassVar[str] = ""
    """What it measures, in a few words."""
    takes_back: ClassVar[str] = ""
    """What it gives to the hand (light, rumble, force); empty: nothing."""
    suits: ClassVar[str] = ""
    """The `mapping` of a session that suits it: mode and frame."""
    udev_matches: ClassVar[Sequence[str]] = ()
    """What udev rules match its device nodes by: ``cardan udev`` opens those to the user at the
    console. A line that begins with # is a comment."""

    @classmethod
    def find(cls) -> list[FoundDevice]:
        """What of this kind is plugged in. Opens nothing for longer than a look; never raises."""
        return []

    @property
    @abstractmethod
    def capabilities(self) -> DeviceCapabilities:
        """What the device gives and takes; may grow once it is open."""

    @abstractmethod
    def state(self) -> DeviceState:
        """The newest state. Never blocks, never raises, never old without saying so."""

    @abstractmethod
    def button_events(self) -> Sequence[ButtonEvent]:
        """Button edges since the last call, oldest first; none is lost. One consumer."""

    def feedback(self, feedback: DeviceFeedback) -> None:
        """Give `feedback` to the hand. Raises CommandError for a channel the device has not."""
        missing = {
            name
            for name in ("led", "rumble", "wrench")
            if getattr(feedback, name) is not None and name not in self.capabilities.feedback
        }
        if missing:
            raise CommandError(
                f"{type(self).__name__} has no {', '.join(sorted(missing))} feedback; "
                f"it has: {', '.join(sorted(self.capabilities.feedback)) or 'none'}"
            )
        self._feedback(feedback)

    def _feedback(self, feedback: DeviceFeedback) -> None:
        """Send `feedback`, whose channels are known to exist. Drivers with feedback override."""


class RobotDriver(Driver):
    """A robot's controller. The robot is the clock::

    for state in robot.cycles():
        robot.send(command_for(state))
    """

    @property
    @abstractmethod
    def capabilities(self) -> RobotCapabilities:
        """Which commands the robot takes, how often, and its limits where known."""

    @abstractmethod
    def cycles(self) -> Iterator[RobotState]:
        """Yield a state at each control instant; a silent robot yields its silence instead.

        While nothing is heard, a state whose link is WAITING or LOST comes at least every
        0.1 s, so that the loop keeps its own watch. Ends after close().
        """

    @abstractmethod
    def send(self, command: RobotCommand) -> None:
        """Command the robot for the cycle last yielded; without effect while it is silent.

        Raises CommandError for a kind or shape the robot cannot take (and sends nothing new).
        """

    def enable(self) -> None:
        """Make the robot ready for commands: drives on, its program started. Only ever called
        because an operator asks for it.

        Returns at once; `RobotState.hold_reason` says how it goes. Raises CommandError where that
        is done at the robot's own controller.
        """
        raise CommandError(f"{type(self).__name__} is made ready at the robot's own controller")

    def set_outputs(self, digital: bool | None = None, values: Sequence[float] = ()) -> None:
        """Set what travels to the controller's program with every command from now on.

        Raises CommandError where the robot has no such outputs.
        """
        if digital is not None or values:
            raise CommandError(f"{type(self).__name__} has no outputs")

    def output_values(self) -> Sequence[float]:
        """The values that travel to the controller's program now."""
        return ()
