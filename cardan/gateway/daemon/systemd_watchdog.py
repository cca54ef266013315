"""State of the daemon for systemd, whose watchdog ends it when a session hangs: sd_notify(3)."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Mapping
from typing import Final

STARTS_WITHIN_S: Final = 60.0
"""Longest time until a session's first snapshot: all sessions of a lab import their arms' models at
once, which takes a small computer some 10 s for each, and would again after a restart."""

HUNG_S: Final = 8.0
"""Longest time between snapshots of a session: a session that hangs beyond it, and that its
supervisor cannot end, ends the daemon by its watchdog."""

WATCHDOG_SHARE: Final = 0.4
"""Share of the watchdog's time after which it is fed: sd_watchdog_enabled(3) recommends half."""


class Notifier:
    """Notifies the service manager that has started this process; without one it does nothing."""

    def __init__(self, environment: Mapping[str, str] = os.environ, pid: int | None = None) -> None:
        """`environment` has NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID, if set."""
        self._path = environment.get("NOTIFY_SOCKET", "")
        watched = environment.get("WATCHDOG_PID", "") in ("", str(pid or os.getpid()))
        usec = environment.get("WATCHDOG_USEC", "")
        self._period_s = WATCHDOG_SHARE * int(usec) * 1e-6 if watched and usec.isdecimal() else 0.0
        self._due_s = 0.0
        self._status = ""

    @property
    def watched(self) -> bool:
        """True if the service manager expects watchdog messages."""
        return bool(self._path) and self._period_s > 0.0

    def ready(self) -> None:
        """Report that it serves; also after a reload."""
        self._send("READY=1")

    def reloading(self) -> None:
        """Report that it reads its files again; `ready` ends it."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """Report that it ends."""
        self._send("STOPPING=1")

    def status(self, words: str) -> None:
        """Set the text that `systemctl status` shows."""
        if words != self._status:
            self._status = words
            self._send("STATUS=" + " ".join(words.split()))

    def alive(self, now_s: float) -> None:
        """Feed the watchdog if it is due."""
        if self.watched and now_s >= self._due_s:
            self._due_s = now_s + self._period_s
            self._send("WATCHDOG=1")

    def _send(self, text: str) -> None:
        if not self._path:
            return
        path = f"\0{self._path[1:]}" if self._path.startswith("@") else self._path
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock,
        ):
            sock.setblocking(False)
            sock.sendto(text.encode(), path)
