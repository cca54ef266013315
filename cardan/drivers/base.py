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
"""Period of checking for a new state without a notification, s: no reader is notified when silence
makes a state stale, or when the device's thread hangs."""


RawPacketCallback = Callable[[bytes, bool, str], None]
"""Recorder of raw bytes, called with the bytes, True if they were sent (False: received), and the
name of the connection ("" for the only one). It runs in the thread that exchanges them: it must
neither block nor raise."""


class Endpoint(NamedTuple):
    """An address that a driver uses while it is open."""

    transport: Literal["tcp", "udp"]
    host: str
    port: int
    listens: bool = False
    """True: the driver listens, and the other side sends first; False: the driver connects."""
    peer: str | None = None
    """The only address that it accepts; None: any."""
    request: bytes = b""
    """Request to a server that sends only when asked."""
    speaks: Callable[[bytes], bool | None] | None = None
    """Checks whether a datagram, or a server's first bytes, are of the protocol; None: more bytes
    are needed. Without it nothing is awaited or judged."""


class Driver(ABC):
    """Base of operator devices and robots: options, open, close, diagnosis."""

    Options: ClassVar[type[Any]]
    """Frozen dataclass with a default for every field, which validates the driver's table in the
    configuration file. It raises OptionError for a bad value;
    :class:`cardan.common.options.Options` does so by the annotations."""
    summary: ClassVar[str] = ""
    """Short name of its hardware, for lists and tables."""
    page: ClassVar[str] = ""
    """Its documentation: a page relative to Cardan's docs/, or a URL."""
    peer: ClassVar[str] = ""
    """Simulated peer for the hardware: ``cardan sim PEER``."""
    raw_packet_callback: RawPacketCallback | None = None
    """Recorder of the exchanged raw bytes; may be set and removed at any time."""

    def __init__(self, options: Any = None, **keywords: Any) -> None:
        """Takes an `Options` object, or its fields as keywords.

        Raises ConfigurationError for both at once, an option that does not exist, or a bad value.
        """
        self.options = self.make_options(options, keywords)

    @classmethod
    def make_options(cls, options: Any, keywords: Mapping[str, Any]) -> Any:
        """Return `options` or, if None, `Options` made of `keywords`."""
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
        """Return problems and other warnings, worst first."""

    def cautions(self) -> tuple[str, ...]:
        """Return warnings about risky options, open or not; each names the option and its remedy.
        `cardan check` and `cardan run` print them."""
        return ()

    def endpoints(self) -> tuple[Endpoint, ...]:
        """Return addresses on which it listens or to which it connects, by its options, open or
        not. `cardan doctor` checks them with one more connection, closed after `request` at most;
        addresses that this would disturb are omitted."""
        return ()

    def metrics(self) -> dict[str, float]:
        """Return live figures by name; times in s, ratios in 0..1, counts as integers."""
        return {}

    def protocol_errors(self) -> Mapping[str, int]:
        """Return counts of unusable messages since the driver was made, by kind: "malformed",
        "implausible" and the like, a few stable names."""
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
    """A hand-held device, usually read by a thread of its own.

    `state()` returns the newest state at once, `read()` waits for a new one, ``for state in
    device`` does so until the device is closed, and `on_state()` calls a function. A consumer
    slower than the device gets the newest state and misses some; `button_events()` has every edge.
    """

    # Set on the class: a subclass's __init__ may not call ours.
    _notified = 0
    """Counts calls of _notify()."""
    _close_count = 0
    """Count of closings, for drivers that can be reopened: pending reads end then."""
    _in_child = False
    """True if it was open in the parent process at a fork."""
    _reading: _StateReader | None = None
    _direct: tuple[Callable[[], object], ...] = ()
    """Calls within `_notify`."""

    @cached_property
    def _changed(self) -> threading.Condition:
        # Threads that call this first at the same time all get the same one.
        changed: threading.Condition = vars(self).setdefault("_changed", threading.Condition())
        return changed

    gives: ClassVar[str] = ""
    """Short description of its measurements."""
    takes_back: ClassVar[str] = ""
    """Its feedback to the operator (light, rumble, force); empty: none."""
    suits: ClassVar[str] = ""
    """`mapping` of a session that suits it: mode and frame."""
    udev_matches: ClassVar[Sequence[str]] = ()
    """Match keys of its device nodes in udev rules: ``cardan devices udev`` grants the user at the
    console access to them. Lines beginning with # are comments."""

    @classmethod
    def find(cls) -> list[FoundDevice]:
        """Return devices of this kind that are plugged in. Keeps none open; never raises."""
        return []

    @property
    @abstractmethod
    def capabilities(self) -> DeviceCapabilities:
        """Measurements and feedback of the device; may grow once it is open."""

    @abstractmethod
    def state(self) -> DeviceState:
        """Return the newest state. Never blocks, never raises; `link` tells whether it is stale."""

    def read(self, timeout_s: float | None = None) -> DeviceState | None:
        """Wait for a state that read() has not returned yet, at most `timeout_s` (None: no limit).

        Returns None if none came or the device was closed. A lost device is also reported as a
        state: check `link`. For one consumer; others iterate or use on_state(). Raises
        NotOpenError, and OptionError for an invalid time.
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
        """Yield the present state and each new one, until the device is closed. Raises
        NotOpenError."""
        reader = _StateReader(self)
        while (state := reader.next()) is not None:
            yield state

    def on_state(
        self, callback: Callable[[DeviceState], object], *, own_thread: bool = True
    ) -> Callable[[], None]:
        """Call `callback` with the present state and each new one, until the device is closed.

        A thread of its own makes the calls in sequence: a slow callback misses states, and delays
        neither the device nor other callbacks. An exception ends the calls and goes to
        `threading.excepthook`, which prints it; the device continues. The returned function ends
        the calls, too, and waits for a running one. Raises NotOpenError, and OptionError if
        `callback` is not callable.

        Without `own_thread` the driver's thread makes the calls, after each report, one thread
        earlier: `callback` may neither raise nor take more than some tens of µs, and may be called
        once more after the returned function.
        """
        require(callable(callback), "callback", callback, "a function that takes a state")
        reader = _StateReader(self)
        if not own_thread:
            return self._call_directly(callback, reader)

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

    def _call_directly(
        self, callback: Callable[[DeviceState], object], reader: _StateReader
    ) -> Callable[[], None]:
        def call() -> None:
            if not reader.ended:
                callback(self.state())

        def stop() -> None:
            reader.stopped = True
            self._direct = tuple(each for each in self._direct if each is not call)

        self._direct = (*self._direct, call)
        call()
        return stop

    def _notify(self) -> None:
        """Wake the consumers that wait for a new state. Drivers call it after each report and each
        change of the link; otherwise consumers notice after `RECHECK_S`."""
        with self._changed:
            self._notified += 1
            self._changed.notify_all()
        for call in self._direct:
            call()

    @abstractmethod
    def button_events(self) -> Sequence[ButtonEvent]:
        """Return button edges since the last call, oldest first; none is lost. For a single
        consumer."""

    def feedback(self, feedback: DeviceFeedback) -> None:
        """Show `feedback` to the operator. Raises CommandError for a channel the device lacks."""
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
    """Reader that passes each new state of a device once to one consumer. Raises NotOpenError."""

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
        """True if no more states will come."""
        return self.stopped or self._device._close_count != self._close_count

    def next(self, timeout_s: float | None = None) -> DeviceState | None:
        """Return the next new state; None if none comes within `timeout_s`, or none will any
        more."""
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
        """Yield a state at each control instant.

        While the robot is silent, yield a state whose link is WAITING or LOST at least every 0.1 s,
        so that the loop can check its watchdogs. Ends after close().
        """

    @abstractmethod
    def send(self, command: RobotCommand) -> None:
        """Command the robot for the cycle last yielded; without effect while it is silent.

        Raises CommandError for a kind or shape the robot cannot take (and sends nothing new).
        """

    def enable(self) -> None:
        """Make the robot ready for commands: switch drives on, start its program.

        Call it only on an operator's request. Returns at once; `RobotState.hold_reason` reports the
        progress. Raises CommandError if this is done at the robot's own controller.
        """
        raise CommandError(f"{type(self).__name__} is made ready at the robot's own controller")

    def set_outputs(self, digital: bool | None = None, values: Sequence[float] = ()) -> None:
        """Set the values sent to the controller's program with every command from now on.

        Raises CommandError if the robot has no such outputs.
        """
        if digital is not None or values:
            raise CommandError(f"{type(self).__name__} has no outputs")

    def output_values(self) -> Sequence[float]:
        """Values sent to the controller's program now."""
        return ()
