"""Subscriber to all topics of sessions, in a separate process."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator, Sequence


@contextlib.contextmanager
def listener(endpoints: Sequence[str]) -> Iterator[None]:
    """Run a process that subscribes to everything on the buses at `endpoints` and reads nothing."""
    words = [sys.executable, "-m", "bench.network.listener", json.dumps(list(endpoints))]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        if process.stdout.readline() != b"READY\n":
            raise RuntimeError("the listener did not start")
        yield
    finally:
        process.communicate()
