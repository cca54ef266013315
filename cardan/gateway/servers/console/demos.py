"""Demos of Cardan for pages: simulated peers on the server's machine, one demo at a time. They move
no arm of a session."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from typing import Any, Final

from cardan.common.realtime import SCHEDULING_VARIABLE
from cardan.gateway.servers.console.commands import COMMAND, OrderError, carry_out
from cardan.gateway.servers.console.subprocesses import CARDAN, AsyncSubprocess

SECONDS: Final = 60
"""Duration of a demo, unless it is ended before."""

LINES: Final = 40
"""Last lines of its output that are kept."""


class Demos:
    """All demos of this installation, and the running one."""

    def __init__(self, listing: Sequence[str] = COMMAND, running: Sequence[str] = CARDAN) -> None:
        self._listing, self._command = listing, running
        self._known: list[dict[str, str]] | None = None
        self._name = ""
        self._since_s = 0.0
        self._running: AsyncSubprocess | None = None
        self._said: deque[str] = deque(maxlen=LINES)

    async def table(self) -> dict[str, Any]:
        """Return the table for pages: the demos, the running one, and its output or that of the
        last. Raises OrderError."""
        if self._known is None:
            found = await carry_out(["demo", "--list", "--json"], self._listing)
            self._known = [{"name": each["demo"], "what": each["what_is_joined"]} for each in found]
        running = self._running is not None and self._running.code is None
        return {
            "demos": self._known,
            "name": self._name,
            "running": running,
            "seconds": round(time.monotonic() - self._since_s, 1) if running else None,
            "said": list(self._said),
        }

    async def start(self, name: object) -> None:
        """Start a demo. Raises OrderError."""
        known = (await self.table())["demos"]
        if not any(each["name"] == name for each in known):
            raise OrderError(f"there is no demo {str(name)[:60]!r}")
        if self._running is not None and self._running.code is None:
            raise OrderError(f"the demo {self._name} runs; end it first")
        self._name, self._since_s = str(name), time.monotonic()
        self._said.clear()
        words = ["demo", self._name, "--seconds", str(SECONDS)]
        running = self._running = AsyncSubprocess([*self._command, *words], self._said.append)
        try:
            # Its loops must not delay those that move real arms.
            await running.start({SCHEDULING_VARIABLE: "ordinary"})
        except OSError as error:
            self._running = None
            raise OrderError(f"the demo cannot be started: {error}") from None

    async def stop(self) -> None:
        """End the running demo. Raises OrderError."""
        if self._running is None or self._running.code is not None:
            raise OrderError("no demo runs")
        await self._running.end()

    async def close(self) -> None:
        """End the running demo."""
        if self._running is not None:
            await self._running.end()
