"""The simulated peers of a demo, in processes of their own."""

from __future__ import annotations

import secrets
import shutil
import tempfile
from pathlib import Path

from cardan.demos.examples import Demo
from cardan.demos.safety import check_words
from cardan.gateway.session.subprocesses import CardanSubprocess


class Peers:
    """Programs that a demo launches, and the folder that it has for a ``with`` block.

    The peers are started as any other program would start them, by the command line. Should this
    process be stopped for ever, they still end by themselves.
    """

    def __init__(self, demo: Demo, seconds: float) -> None:
        """`seconds`: how long they run at most. Raises ConfigurationError for a program that a demo
        may not launch."""
        self.folder = Path(tempfile.gettempdir(), f"cardan-demo-{secrets.token_hex(4)}")
        self.tables, launches = demo.prepare(self.folder)
        """The configuration, with the demo's own paths and ports."""
        self.until = ("--seconds", str(seconds))
        self.commands = [check_words(demo, "launch", words) for words in launches]
        self._needs_folder = bool(launches or demo.files)
        self._running: dict[int, CardanSubprocess] = {}

    def __enter__(self) -> Peers:
        # As late as can be: until a peer runs, it stays if this process is killed.
        if self._needs_folder:
            self.folder.mkdir(0o700)
        return self

    def __exit__(self, *_exception: object) -> None:
        for index in sorted(self._running, reverse=True):
            self.end(index)
        shutil.rmtree(self.folder, ignore_errors=True)

    def start_all(self) -> None:
        """Start them in their order. Raises DriverError where one does not serve."""
        for index in range(len(self.commands)):
            self.start(index)

    def start(self, index: int) -> None:
        """Start the one of this command."""
        words = (*self.commands[index], *self.until)
        self._running[index] = CardanSubprocess(*words, folder=self.folder)

    def end(self, index: int) -> None:
        """End it."""
        self._running.pop(index).end()
