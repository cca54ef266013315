"""One-line reports of exhausted resources: memory, open files, threads. ``python -m
cardan.common.resource_errors MODULE ARGUMENT...`` runs a module's ``main()`` with them."""

from __future__ import annotations

import errno
import os
import signal
import sys
from importlib import import_module

_MEMORY = "there is too little memory; `ulimit -v` shows the limit, `free` what is left"
_FILES = "too many files are open; `ulimit -n` shows the limit"
_THREADS = "no more threads can be started; `ulimit -u` shows the limit, `ulimit -v` that of memory"
_SYSTEM = {errno.ENOMEM: _MEMORY, errno.EMFILE: _FILES, errno.ENFILE: _FILES}
_UNMAPPED = ("failed to map segment", "cannot allocate memory")
"""Messages of the dynamic linker without memory for a library."""
_MOST_CAUSES = 10


def shortage(error: BaseException | None) -> str:
    """Return the exhausted resource, from `error` or one of its causes; empty for other errors."""
    for _ in range(_MOST_CAUSES):
        if error is None:
            break
        if words := _lacking(error):
            return words
        error = error.__cause__ or error.__context__
    return ""


def _lacking(error: BaseException) -> str:
    # Python itself raises SystemError where memory ends while it makes an exception.
    if isinstance(error, (MemoryError, SystemError)):
        return _MEMORY
    if isinstance(error, OSError):
        return _SYSTEM.get(error.errno or 0, "")
    words = str(error).lower()
    if isinstance(error, ImportError) and any(each in words for each in _UNMAPPED):
        return _MEMORY
    return _THREADS if isinstance(error, RuntimeError) and "start new thread" in words else ""


def run(module: str) -> None:
    """Run ``main()`` of `module` and exit with its code; 1 and a line after a shortage. Ctrl-C
    during the import, before the module handles signals itself, ends it in the same way."""
    try:
        code = import_module(module).main()
    except KeyboardInterrupt:
        code = 128 + signal.SIGINT
    except Exception as error:
        words = shortage(error)
        if not words:
            raise
        os.write(2, f"cardan: {words}\n".encode())
        code = 1
    sys.exit(code)


if __name__ == "__main__":
    del sys.argv[0]
    run(sys.argv[0])
