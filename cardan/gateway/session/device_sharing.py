"""An operator device shared with other sessions: its holder opens it.

While another session has the device it is closed here: its link is CLOSED, so the arm brakes, holds
and is disarmed, and has to be re-armed before it moves again.
"""

from __future__ import annotations

import threading
from typing import Final

from cardan.common.plugins import reason
from cardan.drivers.base import OperatorDevice
from cardan.drivers.foreign import close_in_order

TAKE: Final = b"take the device"
GIVE: Final = b"give the device"
"""Packets of the supervisor."""

AGAIN_S: Final = 0.5
"""Pause before the next attempt to open a device: the session that had it may still be closing
it."""


class DeviceLease:
    """Opens and closes a device beside the session's loop, because both take time."""

    def __init__(self, device: OperatorDevice) -> None:
        """`device` is closed."""
        self._device = device
        self._wanted = False
        self.held = False
        """True while it is open."""
        self.problem = ""
        """Reason why it could not be opened."""
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._over = False

    def begin(self) -> None:
        """Open it before the loop begins. Raises the errors of its open()."""
        self._device.open()
        self._wanted = self.held = True

    def want(self, held: bool) -> None:
        """Request that the device be opened or closed. Does not block."""
        with self._changed:
            self._wanted = held
            if self._thread is None:
                self._thread = threading.Thread(
                    target=self._work, name="cardan-device-lease", daemon=True
                )
                self._thread.start()
            self._changed.notify()

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._over and self._wanted is self.held:
                    self._changed.wait()
                if self._over:
                    return
                wanted = self._wanted
            if not wanted:
                close_in_order(self._device)
                self.held, self.problem = False, ""
                continue
            try:
                self._device.open()
                self.held, self.problem = True, ""
            except Exception as error:
                self.problem = reason(error)
                with self._changed:
                    self._changed.wait_for(lambda: self._over or not self._wanted, AGAIN_S)

    def close(self) -> None:
        """End its thread, and close the device. Never raises; idempotent."""
        with self._changed:
            self._over = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()
        close_in_order(self._device)
