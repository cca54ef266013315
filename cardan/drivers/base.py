"""The two interfaces of a driver: all that the gateway knows about hardware.

A driver module opens one kind of device or controller and handles its protocol, nothing else. It
never imports the gateway, so that other projects can import drivers alone. Third parties add
theirs through the entry-point group ``cardan.drivers`` (see :mod:`cardan.drivers.registry`).
"""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import cached_property
from typing import Any, ClassVar, Literal, NamedTuple

from cardan.common.context import enter, leave
from cardan.common.forks import IN_CHILD
from cardan.common.options import require, suggestion
from cardan.errors import CommandError, ConfigurationError, NotOpenError
from cardan.types import (
    ButtonEvent,
    DeviceCapabilities,
    DeviceFeedback,
    DeviceLink,
    DeviceState,
    RobotCapabilities,
    RobotCommand,
    RobotState,
)

RECHECK_S = 0.1
"""Period at which a waiting reader checks for a new state without being notified: silence that
makes a state stale notifies no reader, and the device's thread may hang."""


RawPacketCallback = Callable[[bytes, bool, str], None]
"""Is given raw bytes as they are exchanged: what was received or, where the second argument is
True, sent; and by which of several connections, empty where there is one. Called in the thread that
exchanges them: it must not block and not raise."""


class Endpoint(NamedTuple):
    """An address that a driver uses while it is open."""

    transport: Literal["tcp", "udp"]
    host: str
    port: int
    listens: bool = False
    """Whether the driver waits here for the other side, which sends first; else it connects to
    it."""
    peer: str | None = None
    """The only computer that it listens to; None: any."""
    request: bytes = b""
    """Request to a server that speaks only when asked."""
    speaks: Callable[[bytes], bool | None] | None = None
    """Whether a datagram, or a server's first words, are of the protocol; it says None where more
    is needed. Without it they are not waited for, and not judged."""


class Driver(ABC):
    """Base of operator devices and robots: options, open, close, diagnosis."""

    Options: ClassVar[type[Any]]
    """A frozen dataclass with a default for every field; the configuration file's table of this
    driver is checked against it. It raises OptionError for a bad value, as
    :class:`cardan.common.options.Options` does by the annotations."""
    summary: ClassVar[str] = ""
    """Short name of the hardware that it drives; lists and tables begin with it."""
    page: ClassVar[str] = ""
    """Its documentation: a page as seen from Cardan's docs/, or a URL."""
    peer: ClassVar[str] = ""
    """The simulated peer that stands in for the hardware: ``cardan sim PEER``."""
    raw_packet_callback: RawPacketCallback | None = None
    """Recorder of the raw bytes that are exchanged; set and taken off at any time."""

    def __init__(self, options: Any = None, **keywords: Any) -> None:
        """Takes an `Options` object, or its fields as keywords.

        Raises ConfigurationError for both at once, an option that does not exist, or a bad value.
        """
        self.options = self.make_options(options, keywords)

    @classmethod
    def make_options(cls, options: Any, keywords: Mapping[str, Any]) -> Any:
        """`options`, or, where that is None, `Options` made of `keywords`."""
        kind = cls.Options.__name__
        if options is not None:
            if not isinstance(options, cls.Options):
                raise ConfigurationError(
                    "options", f"{cls.__name__} takes {kind} or keywords, not {options!r:.60}"
                )
            if keywords:
                raise ConfigurationError(
                    "options",
                    f"{cls.__name__} was given {kind} and the keywords {', '.join(keywords)}: put "
                    "them into the one or the other",
                )
            return options
        for name in keywords:
            allowed = [field.name for field in fields(cls.Options) if field.init]
            if name not in allowed:
                raise ConfigurationError(
                    name,
                    f"{cls.__name__} has no such option; allowed: {', '.join(allowed)}"
                    + suggestion(name, allowed),
                )
        return cls.Options(**keywords)

    @abstractmethod
    def open(self) -> None:
        """Acquire the device. Raises a DriverError that says what to do; opening twice is fine."""

    @abstractmethod
    def close(self) -> None:
        """Release the device, leaving it safe. Never raises; closing twice is fine."""

    __enter__ = enter
    __exit__ = leave

    @abstractmethod
    def diagnosis(self) -> tuple[str, ...]:
        """Problems, and what else deserves attention, worst first."""

    def cautions(self) -> tuple[str, ...]:
        """Warnings about risky options; each names the option and says what to do instead. `cardan
        check` and `cardan run` print them. Open or not."""
        return ()

    def endpoints(self) -> tuple[Endpoint, ...]:
        """Addresses on which it listens or to which it connects, by its options; `cardan doctor`
        checks them. Omits those that one more connection, closed again after `request` at most,
        would disturb. Open or not."""
        return ()

    def metrics(self) -> dict[str, float]:
        """Live figures by name; times in s, ratios in 0..1, counts as whole numbers."""
        return {}

    def protocol_errors(self) -> Mapping[str, int]:
        """Messages of the device or robot that could not be used, counted by kind since the driver
        was made: "malformed", "implausible" and the like, few words that never change."""
        return {}


class FoundDevice(NamedTuple):
    """A device that is plugged in, for ``cardan devices``."""

    name: str
    identity: str
    """USB vendor and product ("256f:c635"), a Bluetooth address, or empty."""
    transport: str
    path: str
    """Value that selects it in the driver's options."""
    obstacle: str = ""
    """Reason why it cannot be opened; empty: none known."""
    driver: str = ""
    """The name of its driver, from :func:`cardan.devices`."""


class OperatorDevice(Driver):
    """A hand-held device. It reads itself (usually in a thread of its own).

    `state()` gives the newest state at once, `read()` waits for a new one, ``for state in device``
    does so until the device is closed, and `on_state()` has a function called. A consumer slower
    than the device gets the newest state and misses some; `button_events()` has every edge.
    """

    # Set on the class: a driver with an __init__ of its own may not call ours.
    _notified = 0
    """Counts calls of _notify()."""
    _close_count = 0
    """Counted by drivers that may be opened again: reads that waited end then."""
    _in_child = False
    """Whether it was open in the process that this one was forked from."""
    _reading: _StateReader | None = None

    @cached_property
    def _changed(self) -> threading.Condition:
        # Threads that ask first at the same time all get the same one.
        changed: threading.Condition = vars(self).setdefault("_changed", threading.Condition())
        return changed

    gives: ClassVar[str] = ""
    """Short description of its measurements."""
    takes_back: ClassVar[str] = ""
    """Its feedback to the operator (light, rumble, force); empty: none."""
    suits: ClassVar[str] = ""
    """The `mapping` of a session that suits it: mode and frame."""
    udev_matches: ClassVar[Sequence[str]] = ()
    """Match keys of its device nodes in udev rules: ``cardan devices udev`` grants the user at the
    console access to these. A line that begins with # is a comment."""

    @classmethod
    def find(cls) -> list[FoundDevice]:
        """Devices of this kind that are plugged in. Keeps none open; never raises."""
        return []

    @property
    @abstractmethod
    def capabilities(self) -> DeviceCapabilities:
        """Measurements and feedback of the device; may grow once it is open."""

    @abstractmethod
    def state(self) -> DeviceState:
        """The newest state. Never blocks, never raises; `link` says when it is stale."""

    def read(self, timeout_s: float | None = None) -> DeviceState | None:
        """Wait for a state that read() has not returned yet, `timeout_s` at most (None: no limit).

        Returns None where none came, or the device was closed meanwhile. The loss of a device is a
        state, too: look at `link`. For one consumer; others iterate or have on_state().

        Raises NotOpenError, and OptionError for an invalid time.
        """
        good = isinstance(timeout_s, (int, float)) and not isinstance(timeout_s, bool)
        require(
            timeout_s is None or (good and 0.0 <= timeout_s <= threading.TIMEOUT_MAX),
            "timeout_s",
            timeout_s,
            "a finite number of seconds, 0 or more, or None",
        )
        if self._reading is None or self._reading.ended:
            self._reading = _StateReader(self)
        return self._reading.next(timeout_s)

    def __iter__(self) -> Iterator[DeviceState]:
        """The state now and each new one, until the device is closed. Raises NotOpenError."""
        reader = _StateReader(self)
        while (state := reader.next()) is not None:
            yield state

    def on_state(self, callback: Callable[[DeviceState], object]) -> Callable[[], None]:
        """Have `callback` called with the state now and each new one, until the device is closed.

        The calls come one after the other from a thread of their own: a slow callback misses
        states, and holds up neither the device nor other callbacks. An exception ends the calls and
        goes to `threading.excepthook`, which prints it; the device goes on. The function that is
        returned ends the calls, too, and waits for one that is under way.

        Raises NotOpenError, and OptionError for what cannot be called.
        """
        require(callable(callback), "callback", callback, "a function that takes a state")
        reader = _StateReader(self)

        def call() -> None:
            while (state := reader.next()) is not None:
                callback(state)

        name = f"cardan-{type(self).__name__.lower()}-callback"
        thread = threading.Thread(target=call, name=name, daemon=True)
        thread.start()

        def stop() -> None:
            reader.stopped = True
            self._notify()
            if threading.current_thread() is not thread:
                thread.join()

        return stop

    def _notify(self) -> None:
        """Wake the consumers that wait for a new state. Drivers call it after a report and after a
        change of the link; without it changes are seen `RECHECK_S` later."""
        with self._changed:
            self._notified += 1
            self._changed.notify_all()

    @abstractmethod
    def button_events(self) -> Sequence[ButtonEvent]:
        """Button edges since the last call, oldest first; none is lost. For a single consumer."""

    def feedback(self, feedback: DeviceFeedback) -> None:
        """Give `feedback` to the operator. Raises CommandError for a channel the device lacks."""
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


class _StateReader:
    """Reader that gives one consumer each new state of a device once. Raises NotOpenError."""

    def __init__(self, device: OperatorDevice) -> None:
        if device.state().link is DeviceLink.CLOSED:
            name = type(device).__name__
            if device._in_child:
                raise NotOpenError(f"{name} is not open in this process: {IN_CHILD}")
            raise NotOpenError(f"{name} is not open: call open() before reading it, or use `with`")
        self._device = device
        self._close_count = device._close_count
        self._last: DeviceState | None = None
        self.stopped = False

    @property
    def ended(self) -> bool:
        """Whether nothing more will come."""
        return self.stopped or self._device._close_count != self._close_count

    def next(self, timeout_s: float | None = None) -> DeviceState | None:
        """The next new state; None where none comes within `timeout_s`, or none will any more."""
        device = self._device
        deadline_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
        while not self.ended:
            notified = device._notified
            state = device.state()
            if state.link is DeviceLink.CLOSED:
                return None
            if state != self._last:
                self._last = state
                return state
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0:
                return None
            with device._changed:
                if device._notified == notified:
                    device._changed.wait(min(left_s, RECHECK_S))
        return None


class RobotDriver(Driver):
    """A robot's controller. The robot is the clock: it is commanded once for each of its states.

    ::

        for state in robot.cycles():
            robot.send(command_for(state))
    """

    @property
    @abstractmethod
    def capabilities(self) -> RobotCapabilities:
        """Commands that the robot takes, their period, and its limits where known."""

    @abstractmethod
    def cycles(self) -> Iterator[RobotState]:
        """Yield a state at each control instant; for a silent robot, states that say so.

        While nothing is heard, a state whose link is WAITING or LOST comes at least every
        0.1 s, so that the loop can check its own watchdogs. Ends after close().
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
        """Set the values sent to the controller's program with every command from now on.

        Raises CommandError where the robot has no such outputs.
        """
        if digital is not None or values:
            raise CommandError(f"{type(self).__name__} has no outputs")

    def output_values(self) -> Sequence[float]:
        """The values sent to the controller's program now."""
        return ()
