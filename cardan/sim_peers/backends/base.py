"""Interface between the shell that serves a simulated device and the backend for its reports."""

from __future__ import annotations

import math
import selectors
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

M = TypeVar("M")


class Shell(Protocol):
    """Interface of the peer that a backend is a part of."""

    @property
    def selector(self) -> selectors.BaseSelector:
        """Waits for the files of all parts. A file's data is a function without arguments, which
        is called when the file is ready."""

    @property
    def refused_until_s(self) -> float:
        """Time until which no program can open the device, by the fault ``refuse``; monotonic s."""

    def begin(self) -> None:
        """Start the script, unless it has started: a program has opened the device."""

    def device_s(self) -> float:
        """The device's time now, s from the script's start; 0 before."""

    def catch_up(self) -> None:
        """Bring the device to the present and send its reports up to then."""


class DeviceBackend(ABC, Generic[M]):
    """A way to reach a simulated device, which sends reports of type M.

    The shell calls a backend's methods. Data that programs send reaches the device from functions
    that the backend registers with `Shell.selector`.
    """

    shell: Shell
    """Set by `open`."""
    awaits_program = True
    """False: it cannot tell when a program opens the device, so the script starts at once."""
    tells_refusal = False
    """Whether the device can be found while it refuses to be opened, and reports it itself."""

    @property
    @abstractmethod
    def endpoint(self) -> str:
        """The address that programs open."""

    @property
    @abstractmethod
    def there(self) -> bool:
        """Whether programs can find the device."""

    def open(self, shell: Shell) -> None:
        """Acquire the resources of an open peer. Raises a CardanError."""
        self.shell = shell

    @abstractmethod
    def appear(self) -> None:
        """Plug the device in, or try to: called while it should be there and is not. Raises a
        CardanError that says what to do."""

    @abstractmethod
    def vanish(self) -> None:
        """Unplug the device: called while it is there and is not to be. Never raises."""

    @abstractmethod
    def send(self, messages: Sequence[M]) -> None:
        """Pass the device's messages on to the programs that have it open."""

    def close(self) -> None:
        """Unplug the device for good, release all resources. Never raises; twice is fine."""
        self.vanish()

    @property
    def due_s(self) -> float:
        """When `attend` has something to do next, monotonic s."""
        return math.inf

    def attend(self, now_s: float) -> None:
        """Do the work due at the monotonic time `now_s`; called at every turn."""

    def wait(self, timeout_s: float) -> None:
        """Wait for programs, at most `timeout_s`, and take the data that they send."""
        for key, _ in self.shell.selector.select(timeout_s):
            handle: Callable[[], None] = key.data
            handle()
