"""Thread that reads an operator device, detects its loss, and reopens it."""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Generic, TypeVar

from cardan.common.forks import IN_CHILD, give_up_in_children
from cardan.common.resource_errors import shortage
from cardan.drivers.base import OperatorDevice
from cardan.drivers.core import DeviceCore
from cardan.drivers.hotplug import HotplugMonitor
from cardan.errors import DeviceAccessError, DriverError, NotOpenError
from cardan.types import ButtonEvent, DeviceState

RETRY_FIRST_S, RETRY_LAST_S = 0.2, 0.8
"""Pause between attempts to open a lost device, doubled each time, if the system does not report
plugging in; even then it is found within a second."""

SETTLE_S = 0.05
"""Pause before an attempt after the system has reported a device: plugging in causes a dozen
events."""

JOIN_TIMEOUT_S = 2.0
"""Longest wait for a reader's end: it checks `stop` at least every 50 ms; one that does not is left
to die as a daemon."""

_log = logging.getLogger(__name__)

C = TypeVar("C", bound=DeviceCore)


class ReaderMixin(ABC, Generic[C]):
    """Reader thread of an operator device, which reopens a lost device.

    A driver lists it before :class:`OperatorDevice`, whose calls it answers from the core. With the
    option `wait_for_device` open() succeeds without a device.
    """

    # Of the device.
    options: Any
    _notify: Callable[[], None]
    _close_count: int
    _in_child: bool

    _kind: ClassVar[str]
    """Name of the device in messages of `_check_open`."""
    _core: C
    """Set by the driver's __init__, from `self.options`."""

    def __init__(self, options: Any = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)  # type: ignore[call-arg]  # the device's
        self._opening = threading.RLock()
        """Held while it is opened or closed: one thread at a time. The reader never takes it."""
        self._lock = threading.Lock()
        """Guards the core, for a few µs at a time."""
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._closes_itself = False
        """True: close() was called by the reader, which then ends as soon as it can."""
        self._ending: threading.Thread | None = None
        """Reader that did not stop in time, and still holds the device."""

    # -- defined by drivers ---------------------------------------------------------------------

    @abstractmethod
    def _connect(self) -> None:
        """Open the device and report it to the core, under the lock. Raises DriverError."""

    @abstractmethod
    def _serve(self, stop: threading.Event) -> None:
        """Read the open device until `stop` is set.

        Raises OSError once the device is gone. Check `stop` at least every 50 ms; call `_notify()`
        after input.
        """

    @abstractmethod
    def _release(self) -> None:
        """Close all that `_connect` has opened. Never raises; closing twice is fine."""

    # -- the interface -------------------------------------------------------------------------

    def open(self) -> None:
        """Open the device and start to read it.

        Raises DeviceNotFoundError or DeviceAccessError, unless `wait_for_device` is set.
        """
        with self._opening:
            self._begin()

    def _begin(self) -> None:
        if self._thread is not None:
            return
        if self._ending is not None:
            self._ending.join(JOIN_TIMEOUT_S)
            if self._ending.is_alive():
                raise DeviceAccessError(
                    "the device is still being closed: it does not take what is written to it"
                )
            self._ending = None
        self._stop = threading.Event()
        self._closes_itself = False
        connected = True
        try:
            self._connect()
        except BaseException as error:
            if not (isinstance(error, Exception) and self.options.wait_for_device):
                with self._lock:
                    self._core.on_closed(time.monotonic())
                self._let_go()
                if isinstance(error, DriverError) or not isinstance(error, Exception):
                    raise
                raise DeviceAccessError(_words(error)) from error
            self._lose(_words(error))
            connected = False
        self._thread = threading.Thread(
            target=self._run,
            args=(self._stop, connected),
            name=f"cardan-{type(self).__name__.lower()}",
            daemon=True,
        )
        self._thread.start()
        self._in_child = False
        give_up_in_children(self)

    def close(self) -> None:
        """Stop reading and release the device, from any thread. Never raises."""
        if threading.current_thread() is self._thread:
            self._stop.set()  # The reader ends by itself: no thread can join itself.
            self._closes_itself = True
            return
        with self._opening:
            thread = self._thread
            if thread is None:
                return
            self._stop.set()
            thread.join(JOIN_TIMEOUT_S)
            if thread.is_alive():
                self._ending = thread
            self._end(thread)

    def _end(self, thread: threading.Thread) -> None:
        """Mark the device closed if `thread` still is its reader, and wake waiters for a state."""
        with self._lock:
            if self._thread is not thread:
                return
            self._thread = None
            self._core.on_closed(time.monotonic())
            self._close_count += 1
        self._notify()

    def after_fork(self) -> None:
        """Close the device in a forked child: it belongs to the parent, and its reader is not
        here."""
        thread = self._thread
        vars(self).pop("_changed", None)  # A thread of the parent may hold it.
        self._opening, self._lock = threading.RLock(), threading.Lock()
        self._ending = None
        if thread is not None:
            self._in_child = True
            self._end(thread)

    def state(self) -> DeviceState:
        with self._lock:
            return self._core.state(time.monotonic())

    def button_events(self) -> Sequence[ButtonEvent]:
        with self._lock:
            return self._core.events()

    def metrics(self) -> dict[str, float]:
        with self._lock:
            return self._core.metrics(time.monotonic())

    def protocol_errors(self) -> dict[str, int]:
        """Reports that could not be decoded, by kind."""
        with self._lock:
            return self._core.protocol_errors()

    def diagnosis(self) -> tuple[str, ...]:
        with self._lock:
            return tuple(self._core.diagnosis(time.monotonic()))

    # -- the reader ----------------------------------------------------------------------------

    @property
    def _opened(self) -> bool:
        """True between open() and close()."""
        return self._thread is not None

    def _check_open(self, call: str) -> None:
        """Raise NotOpenError, naming `call`, unless it is between open() and close()."""
        if not self._opened:
            if self._in_child:
                raise NotOpenError(f"the {self._kind} is not open in this process: {IN_CHILD}")
            raise NotOpenError(f"the {self._kind} is not open: call open() before {call}")

    def _run(self, stop: threading.Event, connected: bool) -> None:
        retry_s = RETRY_FIRST_S
        arrivals: HotplugMonitor | None = None
        try:
            while not stop.is_set():
                # The device is tried again after any exception of a system library: a reader that
                # died would never report it.
                if not connected:
                    try:
                        self._connect()
                        self._notify()
                        connected = True
                    except Exception as error:
                        self._lose(_words(error))
                if connected:
                    if arrivals is not None:
                        arrivals.close()
                        arrivals = None
                    try:
                        self._serve(stop)
                    except Exception as error:
                        if self._core.heard:
                            retry_s = RETRY_FIRST_S
                        self._lose(_words(error))
                        connected = False
                arrivals = arrivals or HotplugMonitor()
                if arrivals.wait(retry_s, stop):
                    retry_s = RETRY_FIRST_S
                    stop.wait(SETTLE_S)
                else:
                    retry_s = min(2.0 * retry_s, RETRY_LAST_S)
        finally:
            if arrivals is not None:
                arrivals.close()
            self._let_go()
            if self._closes_itself:
                self._end(threading.current_thread())

    def _lose(self, reason: str) -> None:
        # Neutral first: releasing a device may take time.
        with self._lock:
            self._core.on_lost(reason, time.monotonic())
        self._notify()
        self._let_go()

    def _let_go(self) -> None:
        try:
            self._release()
        except Exception:  # From a system library: the device is tried again all the same.
            _log.exception("the %s could not be closed properly", self._kind)


class ReadDevice(ReaderMixin[C], OperatorDevice):
    """Operator device read by a thread of its own, and reopened when it is lost."""


def _words(error: Exception) -> str:
    if isinstance(error, DriverError):
        return str(error)
    if lacking := shortage(error):
        return lacking
    if isinstance(error, OSError):
        return f"unplugged, or it cannot be read ({error.strerror or error})"
    return f"the reader failed: {error!r}"
