"""Signals that end a program, handled as a request for an orderly shutdown. A program that moves or
simulates a robot must not die of a signal that it could handle: a robot is braked by the process
that commands it."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from types import FrameType
from typing import Any

_OWN_FAULTS = ("SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL", "SIGTRAP", "SIGSYS")
"""Signals of a fault in the process itself, which cannot continue."""

_NO_END = ("SIGCHLD", "SIGCONT", "SIGURG", "SIGWINCH", "SIGTSTP", "SIGTTIN", "SIGTTOU")
"""Signals that are ignored, or stop a process, unless it handles them."""

_NEVER_HANDLED = ("SIGKILL", "SIGSTOP")

_ERRORS = ("SIGPIPE", "SIGXFSZ")
"""Signals that Python ignores: the call that caused one raises OSError."""

ENDING_SIGNALS: frozenset[int] = frozenset(signal.valid_signals()) - {
    getattr(signal, name)
    for name in (*_OWN_FAULTS, *_NO_END, *_NEVER_HANDLED, *_ERRORS)
    if hasattr(signal, name)
}
"""Every signal that ends a process which does not handle it, and that can be handled: HUP, INT,
QUIT, ABRT, USR1, USR2, ALRM, TERM, STKFLT, XCPU, VTALRM, PROF, IO, PWR and the real-time ones."""

_ALWAYS = frozenset({signal.SIGINT, signal.SIGTERM})
"""Signals handled even if they are ignored, as in the background of a shell without job control."""

Handler = Any
"""Handler in the form of :func:`signal.signal`."""


class _Taken:
    """A handler of this module, which a later one may replace."""

    def __init__(self, action: Callable[[int], None]) -> None:
        self._action = action

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        self._action(number)


def take_ending(action: Callable[[int], None], also: Iterable[int] = ()) -> Mapping[int, Handler]:
    """Call `action` with the number of each ending signal, and of those in `also`, from now on.
    SIGINT and SIGTERM are always handled, others if they would have ended (stopped) the process: a
    signal that is ignored (``nohup``), or has another handler, stays so. Return the previous
    handlers; none outside the main thread, which cannot set any. `action` runs in the main thread,
    between two of its instructions, and must neither wait nor print.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    handler = _Taken(action)
    before = {}
    for number in sorted(ENDING_SIGNALS.union(also)):
        current = signal.getsignal(number)
        if number in _ALWAYS or current is signal.SIG_DFL or isinstance(current, _Taken):
            before[number] = signal.signal(number, handler)
    return before


@contextlib.contextmanager
def on_ending(action: Callable[[int], None], also: Iterable[int] = ()) -> Iterator[None]:
    """Call :func:`take_ending` for a ``with`` block."""
    before = take_ending(action, also)
    try:
        yield
    finally:
        for number, handler in before.items():
            if handler is not None:  # A handler not set by Python cannot be set again.
                signal.signal(number, handler)


def ignore_ending() -> None:
    """Ignore all ending signals: for the last steps of a process that is leaving anyway."""
    for number in ENDING_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


class EndingSignalError(SystemExit):
    """Ending signal as an exception; `code` is 128 and its number, as in a shell."""


@contextlib.contextmanager
def raised_on_ending() -> Iterator[None]:
    """Raise EndingSignalError for the first ending signal, so that ``with`` blocks and ``finally``
    clauses are run. Later signals do not interrupt them, except for another Ctrl-C (SIGINT)."""
    raised = False

    def leave(number: int) -> None:
        nonlocal raised
        if not raised or number == signal.SIGINT:
            raised = True
            raise EndingSignalError(128 + number)

    with on_ending(leave):
        yield


def signal_name(number: int) -> str:
    """Return the name, such as ``SIGHUP``; for a real-time signal its number."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
