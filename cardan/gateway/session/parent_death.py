"""Runs a ``cardan`` command that ends when its launcher does, for any reason. Its standard input is
a pipe to the launcher, which writes nothing: the kernel closes the other end with the launcher,
even after a kill, or if the launcher ended before the command began."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
import time
from types import FrameType

from cardan.common.resource_errors import run

LEAVE_WITHIN_S = 5.0
"""Longest time for the command to end after SIGTERM."""


def main() -> None:
    """Run the command in the arguments after the first, which is a folder of the launcher's. The
    folder is removed if the launcher no longer can; empty: there is none."""
    folder = sys.argv.pop(1)
    launcher_is_gone = threading.Event()

    def clean_up() -> None:
        if folder and launcher_is_gone.is_set():
            shutil.rmtree(folder, ignore_errors=True)

    def watch() -> None:
        while os.read(0, 1):
            pass
        launcher_is_gone.set()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(LEAVE_WITHIN_S)
        clean_up()
        os._exit(1)

    def leave(_number: int, _frame: FrameType | None) -> None:
        sys.exit(128 + signal.SIGTERM)

    try:
        signal.signal(signal.SIGTERM, leave)  # Until the command has its own.
        threading.Thread(target=watch, name="cardan-parent-watch", daemon=True).start()
        run("cardan.cli")
    finally:
        clean_up()


if __name__ == "__main__":
    main()
