"""Panel that is redrawn in place on a terminal."""

from __future__ import annotations

import contextlib

from rich.console import Console, RenderableType
from rich.live import Live
from rich.text import Text

from cardan.common import output


class LivePanel:
    """Panel redrawn in place on a terminal, less often on one that reads slowly; without a terminal
    nothing. Only :meth:`update` draws, so no other thread meets a closed terminal. A `transient`
    panel is erased at the end."""

    def __init__(self, console: Console, *, transient: bool = True) -> None:
        self._console, self._transient = console, transient
        self._live: Live | None = None

    @property
    def drawn(self) -> bool:
        """True if it is open, and on a terminal."""
        return self._live is not None

    def __enter__(self) -> LivePanel:
        if self._console.is_terminal:
            self._live = Live(
                Text(), console=self._console, auto_refresh=False, transient=self._transient
            )
            self._live.start(refresh=True)
        return self

    def __exit__(self, *_exception: object) -> None:
        if self._live is not None:
            with contextlib.suppress(OSError):
                self._live.stop()
            self._live = None

    def update(self, picture: RenderableType) -> None:
        """Draw `picture`, unless the terminal has not read the previous one."""
        if self._live is not None and not output.is_behind():
            self._live.update(picture, refresh=True)
