"""Interface between the shell that serves a simulated device and the transport of its reports."""

from __future__ import annotations

import math
import selectors
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

M = TypeVar("M")


class Shell(Protocol):
    """Interface of the peer that contains a backend."""

    @property
    def selector(self) -> selectors.BaseSelector:
        """Selector for the files of all parts. A file's data is a function without arguments, which
        is called when the file is ready."""

    @property
    def refused_until_s(self) -> float:
        """Monotonic time, s, until which the fault ``refuse`` keeps the device from being
        opened."""

    def begin(self) -> None:
        """Start the script, unless it has started: a program has opened the device."""

    def device_s(self) -> float:
        """Present time of the device, s from the script's start; 0 before."""

    def catch_up(self) -> None:
        """Advance the device to the present and send its reports up to then."""


class DeviceBackend(ABC, Generic[M]):
    """Transport to a simulated device, which sends reports of type M.

    The shell calls a backend's methods. Data that programs send reaches the device from functions
    that the backend registers with `Shell.selector`.
    """

    shell: Shell
    """Set by `open`."""
    awaits_program = True
    """True if it detects when a program opens the device; False: the script starts at once."""
    tells_refusal = False
    """True if the device can be found while it refuses to be opened, and reports that itself."""

    @property
    @abstractmethod
    def endpoint(self) -> str:
        """The address that programs open."""

    @property
    @abstractmethod
    def there(self) -> bool:
        """True if programs can find the device."""

    def open(self, shell: Shell) -> None:
        """Acquire the resources of an open peer. Raises a CardanError."""
        self.shell = shell

    @abstractmethod
    def appear(self) -> None:
        """Plug the device in, or try to; called while it should be present and is not. Raises a
        CardanError that says what to do."""

    @abstractmethod
    def vanish(self) -> None:
        """Unplug the device; called while it is present and should not be. Never raises."""

    @abstractmethod
    def send(self, messages: Sequence[M]) -> None:
        """Pass the device's messages on to the programs that have it open."""

    def close(self) -> None:
        """Unplug the device permanently, release all resources. Never raises; may be called
        twice."""
        self.vanish()

    @property
    def due_s(self) -> float:
        """Monotonic time of the next call of `run_due`, s."""
        return math.inf

    def run_due(self, now_s: float) -> None:
        """Do the work due at the monotonic time `now_s`; called at every turn."""

    def wait(self, timeout_s: float) -> None:
        """Wait for programs, at most `timeout_s`, and accept the data that they send."""
        for key, _ in self.shell.selector.select(timeout_s):
            handle: Callable[[], None] = key.data
            handle()
