"""What simulated devices share that a hand moves in real time: the loop that serves them."""

from __future__ import annotations

import math
import selectors
import time
from abc import abstractmethod
from collections.abc import Callable

from cardan.sim_peers.base import SimulatedPeer


class HandPeer(SimulatedPeer):
    """A simulated device that a hand moves in real time; subclasses carry what it sends.

    `open` makes the selector, in which each file's data is what handles it, and `close` takes it
    away. Time of device and hand stands still until the script begins.
    """

    def __init__(self) -> None:
        self._selector: selectors.BaseSelector | None = None
        self._start_s: float | None = None
        """When the script began, monotonic s; None: it has not."""
        self._played_s = 0.0
        """How far device and hand were last played, their s."""

    @property
    @abstractmethod
    def _hand_due_s(self) -> float:
        """When the device or its hand has something to do next, s from the script's start."""

    @abstractmethod
    def _play(self, now_s: float) -> None:
        """Move the device until the monotonic time `now_s`, and deliver what it sends."""

    def _follow(self, now_s: float) -> None:
        """Do what follows from how the device is after it was played until `now_s`."""

    def _carrier_due_s(self) -> float:
        """When `_attend` has something to do next, monotonic s."""
        return math.inf

    def _attend(self, now_s: float) -> None:
        """Do what is due at the monotonic time `now_s` whatever the device does."""

    def step(self, until_s: float) -> None:
        """Serve until the monotonic time `until_s`."""
        assert self._selector is not None, "step() before open()"
        while True:
            now_s = time.monotonic()
            self._attend(now_s)
            self._play(now_s)
            self._follow(now_s)
            if now_s >= until_s:
                return
            due_s = min(until_s, self._next_due_s())
            for key, _ in self._selector.select(max(0.0, due_s - now_s)):
                handle: Callable[[], None] = key.data
                handle()

    def _next_due_s(self) -> float:
        """When anything is due next, monotonic s."""
        due_s = self._carrier_due_s()
        if self._start_s is not None:
            due_s = min(due_s, self._start_s + self._hand_due_s)
        return due_s

    def _begin(self) -> None:
        """The script starts, unless it has."""
        if self._start_s is None:
            self._start_s = time.monotonic()

    def _device_s(self, now_s: float | None = None) -> float:
        """The device's time at the monotonic time `now_s`; None: now."""
        if self._start_s is None:
            return 0.0
        return (time.monotonic() if now_s is None else now_s) - self._start_s
