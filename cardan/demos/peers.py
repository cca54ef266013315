"""Simulated peers of a demo, in separate processes."""

from __future__ import annotations

import secrets
import shutil
import tempfile
from pathlib import Path

from cardan.demos.examples import Demo
from cardan.demos.safety import check_words
from cardan.gateway.session.subprocesses import CardanSubprocess


class Peers:
    """Programs that a demo launches and their folder, for the length of a ``with`` block.

    The peers are started by the command line, as by any other program. If this process is suspended
    for ever, they still end by themselves.
    """

    def __init__(self, demo: Demo, seconds: float) -> None:
        """`seconds`: longest run. Raises ConfigurationError for a program that a demo may not
        launch."""
        self.folder = Path(tempfile.gettempdir(), f"cardan-demo-{secrets.token_hex(4)}")
        self.tables, launches = demo.prepare(self.folder)
        """Configuration, with the demo's own paths and ports."""
        self.until = ("--seconds", str(seconds))
        self.commands = [check_words(demo, "launch", words) for words in launches]
        self._needs_folder = bool(launches or demo.files)
        self._running: dict[int, CardanSubprocess] = {}

    def __enter__(self) -> Peers:
        # As late as possible: until a peer runs, the folder stays if this process is killed.
        if self._needs_folder:
            self.folder.mkdir(0o700)
        return self

    def __exit__(self, *_exception: object) -> None:
        for index in sorted(self._running, reverse=True):
            self.end(index)
        shutil.rmtree(self.folder, ignore_errors=True)

    def start_all(self) -> None:
        """Start all peers in their order. Raises DriverError if one does not serve."""
        for index in range(len(self.commands)):
            self.start(index)

    def start(self, index: int) -> None:
        """Start the peer of this index."""
        words = (*self.commands[index], *self.until)
        self._running[index] = CardanSubprocess(*words, folder=self.folder)

    def end(self, index: int) -> None:
        """End the peer of this index."""
        self._running.pop(index).end()
