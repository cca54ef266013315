"""Pendant of the simulated controller: actions of its user, through the dashboard server."""

from __future__ import annotations

import contextlib
import heapq
import zipfile
from collections.abc import Callable, Iterable, Sequence
from operator import itemgetter
from pathlib import Path, PurePosixPath
from typing import Final

from cardan.protocols.ur.script import LARGEST
from cardan.sim_peers.ur_controller.controller import UrController

SERIAL_NUMBER: Final = "20000000000"
USER_ROLES: Final = ("PROGRAMMER", "OPERATOR", "NONE", "LOCKED", "RESTRICTED")
OPERATIONAL_MODES: Final = ("NONE", "MANUAL", "AUTOMATIC")
REPORTS: Final = ("controller", "software", "system")
UNNAMED: Final = "<unnamed>"
"""Name of the program in its state if none is loaded."""
DEFAULT_INSTALLATION: Final = "default.installation"
LOG_FILE: Final = "log_history.txt"
SUPPORT_FILE: Final = f"ur_{SERIAL_NUMBER}.zip"

_ON_A_ROBOT: Final = (PurePosixPath("/ursim/programs"), PurePosixPath("/programs"))
"""Directories of programs on a controller; the folder replaces these."""


class Pendant:
    """Programs in a folder, and settings of the user."""

    def __init__(
        self,
        controller: UrController,
        note: Callable[[str], None],
        histories: Sequence[Iterable[tuple[float, str]]],
    ) -> None:
        """`note` takes messages for the user; the log merges the `histories`."""
        self._controller, self.note = controller, note
        self._histories = histories
        folder = controller.options.programs
        self._folder = Path(folder).resolve() if folder else None
        self.loaded = ""
        """Name of the program as it was requested."""
        self.user_role = "PROGRAMMER"
        self.operational_mode = "NONE"
        """NONE: not controlled by the dashboard."""
        self._text = ""
        self._reports = 0

    # -- programs ---------------------------------------------------------------------------------

    def load(self, name: str) -> str:
        """Load a program; return the dashboard's reply."""
        if self._file(name) is None:
            return f"File not found: {name}"
        # A .urp is for PolyScope: the program itself is the .script that is saved with it.
        script = self._file(str(PurePosixPath(name).with_suffix(".script")))
        data = b""
        if script is not None and not self._controller.has_program:
            with contextlib.suppress(OSError), script.open("rb") as file:
                data = file.read(LARGEST + 1)
        if not 0 < len(data) <= LARGEST:
            return f"Error while loading program: {name}"
        self.loaded, self._text = name, data.decode("utf-8", "replace")
        self.note(f"loaded {name}")
        return f"Loading program: {name}"

    def play(self) -> bool:
        """Resume the paused program, or start the loaded one."""
        controller = self._controller
        if controller.resume():
            return True
        if controller.has_program or not self._text:
            return False
        controller.upload(self._text, PurePosixPath(self.loaded).name)
        return controller.has_program

    @property
    def program_name(self) -> str:
        """Name of the running program; if none runs, of the loaded one."""
        controller = self._controller
        runs = controller.has_program
        return controller.program_name if runs else PurePosixPath(self.loaded).name

    def load_installation(self, name: str) -> str:
        """Load an installation; return the dashboard's reply."""
        if name != DEFAULT_INSTALLATION and self._file(name) is None:
            return f"File not found: {name}"
        if self._controller.has_program:
            return f"Failed to load installation: {name}"
        self.note(f"loaded {name}")
        return f"Loading installation: {name}"

    def _file(self, name: str) -> Path | None:
        """Return a file in the folder; None if it does not exist."""
        found = self._inside(name)
        try:
            return found if found is not None and found.is_file() else None
        except OSError:  # The name is too long.
            return None

    def _inside(self, name: str) -> Path | None:
        """Return a path in the folder; None if it does not exist or is outside."""
        asked = PurePosixPath(name)
        for place in _ON_A_ROBOT:
            if asked.is_relative_to(place):
                asked = asked.relative_to(place)
                break
        if self._folder is None:
            return None
        try:
            found = (self._folder / asked).resolve()
        except (OSError, RuntimeError, ValueError):  # A cycle of links, or a zero byte.
            return None
        return found if found.is_relative_to(self._folder) else None

    # -- files ------------------------------------------------------------------------------------

    def save_log(self) -> str:
        """Save the log in the folder; return the dashboard's reply."""
        if self._folder is None:
            return "Failed to save log"
        try:
            (self._folder / LOG_FILE).write_text(self._log(), encoding="utf-8")
        except OSError:
            return "Failed to save log"
        return "Log saved to disk"

    def flight_report(self, kind: str) -> str:
        """Write a flight report into the log; return the dashboard's reply."""
        if kind not in ("", *REPORTS):
            return f"Error: there is no flight report {kind!r}"
        self._reports += 1
        self.note(f"flight report {self._reports}: {kind or REPORTS[-1]}")
        return f"Flight Report generated with id: {self._reports}"

    def support_file(self, name: str) -> str:
        """Save a support file in a directory of the folder; return the dashboard's reply."""
        found = self._inside(name)
        try:
            if found is None or not found.is_dir():
                return f"Error: there is no directory {name}"
            with zipfile.ZipFile(found / SUPPORT_FILE, "w", zipfile.ZIP_DEFLATED) as file:
                file.writestr(LOG_FILE, self._log())
        except OSError:
            return f"Error: {name} cannot be written"
        return f"Completed successfully: {SUPPORT_FILE}"

    def _log(self) -> str:
        lines = heapq.merge(*self._histories, key=itemgetter(0))
        return "".join(f"{time_s:.3f} {text}\n" for time_s, text in lines)
