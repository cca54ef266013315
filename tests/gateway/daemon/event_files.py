"""Reads the files of the event log."""

import contextlib
import json

from cardan.gateway.daemon.events import MAX_FILES


def read_events(path):
    """Events of a log and its older files, oldest first, without damaged lines."""
    files = [path.with_name(f"{path.name}.{number}") for number in range(MAX_FILES, 0, -1)]
    for file in filter(type(path).exists, (*files, path)):
        for line in file.read_text("utf-8", "replace").splitlines():
            with contextlib.suppress(ValueError, RecursionError):
                event = json.loads(line)
                if isinstance(event, dict):
                    yield event
