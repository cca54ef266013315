"""Shell of every simulated device that moves in real time: loop and options."""

from __future__ import annotations

import selectors
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from cardan.common.options import Options
from cardan.common.sockets import EVERYBODY, OWNER_ONLY
from cardan.sim_peers.backends.base import DeviceBackend, M
from cardan.sim_peers.base import SimulatedPeer
from cardan.sim_peers.command import option
from cardan.sim_peers.scripted import DeviceMotion, HeldDevice, pieces

STALL_S = 0.02
"""Age beyond which reports are dropped when a peer runs late: it sends no burst."""

D = TypeVar("D", bound=HeldDevice)


@dataclass(frozen=True, kw_only=True)
class DevicePeerOptions(Options):
    """Options of every simulated device that moves. Raises OptionError."""

    script: str = "demo"
    """Built-in script or file."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by the names of the device's `FAULTS`; times count from the start of the script."""
    seed: int = 0
    """Seed of the noise and of the faults' choices."""
    start_on_connect: bool = True
    """The script starts when the first program opens the device, not when the peer opens. Without
    effect on backends that cannot tell (uinput, CAN)."""


@dataclass(frozen=True, kw_only=True)
class DeviceNodeOptions(DevicePeerOptions):
    """Options of a device that programs open at a path: a socket, or a serial port."""

    everybody: bool = option(False, "Let every user of this machine open it, not only its owner.")
    """Mode 0666 of the socket or port instead of 0600, whatever the umask."""

    @property
    def mode(self) -> int:
        """Mode of the socket or port."""
        return EVERYBODY if self.everybody else OWNER_ONLY


class DevicePeer(SimulatedPeer, Generic[D, M]):
    """Serves `device`, which `motion` moves, by `backend`.

    Time of device and motion stands still until the script begins. The shell implements the fault
    ``refuse``, the device and the backend the others.
    """

    stall_s = STALL_S

    def __init__(
        self,
        device: D,
        motion: DeviceMotion[D],
        backend: DeviceBackend[M],
        options: DevicePeerOptions,
    ) -> None:
        self.device = device
        self.motion = motion
        self.backend = backend
        self.options = options
        self._selector: selectors.BaseSelector | None = None
        self._opened_s = 0.0
        self._start_s: float | None = None
        """Start of the script, monotonic s; None: not started."""
        self._played_s = 0.0
        """Time up to which device and motion were last played, s from the script's start."""

    # -- the peer ------------------------------------------------------------------------------

    @property
    def endpoint(self) -> str:
        """The address that programs open."""
        return self.backend.endpoint

    def open(self) -> None:
        """Plug the device in. Raises a CardanError that says what to do."""
        if self._selector is not None:
            return
        # select() waits to the microsecond; epoll and poll only to the millisecond.
        self._selector = selectors.SelectSelector()
        self._opened_s = time.monotonic()
        try:
            self._open_parts()
            self._deliver((), self._opened_s)
            self._follow(self._opened_s)
        except BaseException:
            self.close()
            raise

    def _open_parts(self) -> None:
        self.backend.open(self)
        if not (self.options.start_on_connect and self.backend.awaits_program):
            self.begin()

    def step(self, until_s: float) -> None:
        """Serve until the monotonic time `until_s`."""
        assert self._selector is not None, "step() before open()"
        while True:
            now_s = time.monotonic()
            self._play(now_s)
            self._follow(now_s)
            if now_s >= until_s:
                return
            self.backend.wait(max(0.0, min(until_s, self._next_due_s(now_s)) - now_s))

    def close(self) -> None:
        """Unplug the device for good."""
        if self._selector is None:
            return
        self.backend.close()
        self._selector.close()
        self._selector = self._start_s = None

    # -- used by the backend -------------------------------------------------------------------

    @property
    def selector(self) -> selectors.BaseSelector:
        """Selector for the files of all parts; each file's data is called when it is ready."""
        assert self._selector is not None, "not open"
        return self._selector

    @property
    def refused_until_s(self) -> float:
        """Time until which no program can open the device; monotonic s."""
        return self._opened_s + self.options.faults.get("refuse", 0.0)

    def begin(self) -> None:
        """Start the script, unless it has started."""
        if self._start_s is None:
            self._start_s = time.monotonic()

    def device_s(self) -> float:
        """Present time of the device, s from the script's start; 0 before."""
        return 0.0 if self._start_s is None else time.monotonic() - self._start_s

    def catch_up(self) -> None:
        """Advance the device to the present, even if it has nothing to do there."""
        now_s = time.monotonic()
        self._play(now_s)
        self._deliver(self.device.reports(self.device_s()), now_s)

    # -- time ----------------------------------------------------------------------------------

    def _next_due_s(self, now_s: float) -> float:
        """Return the monotonic time of the next due action, s."""
        due_s = self.backend.due_s
        if now_s < self.refused_until_s:
            due_s = min(due_s, self.refused_until_s)
        if self._start_s is not None:
            motion_due_s = min(self.device.next_due_s, self.motion.next_due_s)
            due_s = min(due_s, self._start_s + motion_due_s)
        return due_s

    def _play(self, now_s: float) -> None:
        """Move the device until the monotonic time `now_s`, and pass on its reports. A device that
        was replugged meanwhile has vanished for its programs nevertheless."""
        if self._start_s is None:
            self._deliver((), now_s)
            return
        device_s = now_s - self._start_s
        if device_s - self._played_s > self.stall_s:
            self.device.skip_to(device_s - self.stall_s)
        self._played_s = device_s
        for reports in pieces(self.device, self.motion, device_s):
            self._deliver(reports, now_s)

    def _deliver(self, reports: Sequence[M], now_s: float) -> None:
        """Pass `reports` on, and plug the device in or out to match its state."""
        backend = self.backend
        refused = now_s < self.refused_until_s and not backend.tells_refusal
        wanted = self.device.plugged and not refused
        if wanted and not backend.there:
            backend.appear()
        if reports:
            backend.send(reports)
        if backend.there and not wanted:
            backend.vanish()

    def _follow(self, now_s: float) -> None:
        """React to the device's condition after it was played until `now_s`."""
        self.backend.run_due(now_s)
