"""Whole commands in separate processes."""

import contextlib
import re
import subprocess
import sys
import threading

from tests.test_cli import ENVIRONMENT
from tests.waiting import WITHIN_S, until


class Program:
    """``cardan WORDS`` in a separate process, which is killed at the end of the block. `at`: prefix
    of the command line that executes it."""

    def __init__(self, *words, at=(), **options):
        self.process = subprocess.Popen(
            [*at, sys.executable, "-m", "cardan", *map(str, words)],
            **{
                "env": ENVIRONMENT,
                "stdout": subprocess.PIPE,
                "stderr": subprocess.PIPE,
                **options,
            },
        )
        self.said = dict.fromkeys(("stdout", "stderr"), b"")
        self._readers = []
        for name in self.said:
            if (stream := getattr(self.process, name)) is not None:
                reader = threading.Thread(target=self._read, args=(name, stream))
                reader.start()
                self._readers.append(reader)

    def _read(self, name, stream):
        with stream:
            while data := stream.read1(1 << 16):
                self.said[name] += data

    def __enter__(self):
        return self

    def __exit__(self, *_exception):
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()
        self.process.wait()
        for reader in self._readers:
            reader.join(WITHIN_S)

    def wait_for(self, words, name="stdout", within_s=WITHIN_S):
        return until(lambda: re.search(words.encode(), self.said[name]), words, within_s)

    def end(self, *numbers, within_s=WITHIN_S):
        """Send these signals; return the exit code."""
        for number in numbers:
            self.process.send_signal(number)
        code = self.process.wait(within_s)
        for reader in self._readers:
            reader.join(WITHIN_S)
        return code

    @property
    def out(self):
        return self.said["stdout"].decode()

    @property
    def err(self):
        return self.said["stderr"].decode()
