"""Signal handling as in the foreground."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator


@contextlib.contextmanager
def signals_act() -> Iterator[None]:
    """Restore the default actions of ending signals.

    A shell ignores SIGINT and SIGQUIT in background processes, nohup SIGHUP, and child processes
    inherit this.
    """
    acting = {signal.SIGINT: signal.default_int_handler}
    acting |= dict.fromkeys((signal.SIGQUIT, signal.SIGHUP, signal.SIGTERM), signal.SIG_DFL)
    ignored = [each for each in acting if signal.getsignal(each) is signal.SIG_IGN]
    for each in ignored:
        signal.signal(each, acting[each])
    try:
        yield
    finally:
        for each in ignored:
            signal.signal(each, signal.SIG_IGN)
