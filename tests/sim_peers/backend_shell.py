"""Shell for tests of a backend alone: no device is simulated behind it."""

from __future__ import annotations

import selectors
import time

from cardan.sim_peers.backends.base import DeviceBackend


class BareShell:
    """Part of a peer that its backend uses. `now_s` is the device's time."""

    refused_until_s = 0.0

    def __init__(self) -> None:
        self.selector = selectors.SelectSelector()
        self.now_s = 0.0
        self.begun = 0

    def begin(self) -> None:
        self.begun += 1

    def device_s(self) -> float:
        return self.now_s

    def catch_up(self) -> None:
        """Do nothing: there is no motion to simulate."""

    def serve(self, backend: DeviceBackend, timeout_s: float) -> None:
        """Run the loop once."""
        backend.wait(timeout_s)
        backend.run_due(time.monotonic())
