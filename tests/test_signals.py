"""Ending signals count as a request, and only if the program would have died of them."""

import os
import signal
import threading

import pytest

from cardan.common.signals import (
    ENDING_SIGNALS,
    EndingSignalError,
    on_ending,
    raised_on_ending,
    signal_name,
    take_ending,
)

FREE = sorted(
    each for each in ENDING_SIGNALS - {signal.SIGALRM} if signal.getsignal(each) is signal.SIG_DFL
)
"""Signals without a handler of the test runner, which limits test times by SIGALRM."""


def test_every_signal_that_would_end_a_process_is_among_them():
    for name in [
        "HUP",
        "INT",
        "QUIT",
        "ABRT",
        "USR1",
        "USR2",
        "ALRM",
        "TERM",
        "XCPU",
        "VTALRM",
        "PROF",
        "IO",
        "PWR",
    ]:
        assert getattr(signal, f"SIG{name}") in ENDING_SIGNALS, name
    assert {signal.SIGRTMIN, signal.SIGRTMAX} <= ENDING_SIGNALS
    for name in [
        "KILL",
        "STOP",
        "SEGV",
        "BUS",
        "FPE",
        "ILL",
        "PIPE",
        "CHLD",
        "CONT",
        "WINCH",
        "TSTP",
    ]:
        assert getattr(signal, f"SIG{name}") not in ENDING_SIGNALS, name


@pytest.mark.parametrize("number", FREE, ids=signal_name)
def test_each_is_taken_and_given_back(number):
    raised = []
    with on_ending(raised.append):
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)
    assert raised == [number, number]
    assert signal.getsignal(number) is signal.SIG_DFL


def test_what_is_ignored_or_handled_by_others_stays_so():
    raised, theirs = [], []
    before = (
        signal.signal(signal.SIGHUP, signal.SIG_IGN),
        signal.signal(signal.SIGUSR1, lambda number, _frame: theirs.append(number)),
    )
    try:
        with on_ending(raised.append):
            os.kill(os.getpid(), signal.SIGHUP)
            os.kill(os.getpid(), signal.SIGUSR1)
    finally:
        signal.signal(signal.SIGHUP, before[0])
        signal.signal(signal.SIGUSR1, before[1])
    assert (raised, theirs) == ([], [signal.SIGUSR1])


def test_an_ignored_interrupt_is_taken_nevertheless():
    raised = []
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with on_ending(raised.append):
            os.kill(os.getpid(), signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
    assert raised == [signal.SIGINT]


def test_the_inner_one_takes_them_from_the_outer_one():
    outer, inner = [], []
    with on_ending(outer.append):
        with on_ending(inner.append, also=(signal.SIGTSTP,)):
            os.kill(os.getpid(), signal.SIGHUP)
            os.kill(os.getpid(), signal.SIGTSTP)
        os.kill(os.getpid(), signal.SIGHUP)
    assert (outer, inner) == ([signal.SIGHUP], [signal.SIGHUP, signal.SIGTSTP])


def test_elsewhere_than_in_the_main_thread_none_is_taken():
    found = []
    thread = threading.Thread(target=lambda: found.append(take_ending(print)))
    thread.start()
    thread.join()
    assert found == [{}]


def unwound(first, second, cleaned):
    """Receive an ending signal, and a second one during the clean-up."""
    with raised_on_ending():
        try:
            os.kill(os.getpid(), first)
        finally:
            os.kill(os.getpid(), second)
            cleaned.append(True)


def test_the_first_is_raised_and_a_login_session_s_second_one_breaks_nothing():
    cleaned = []
    with pytest.raises(EndingSignalError) as raised:
        unwound(signal.SIGTERM, signal.SIGHUP, cleaned)
    assert (raised.value.code, cleaned) == (128 + signal.SIGTERM, [True])


def test_another_interrupt_is_raised_again():
    cleaned = []
    with pytest.raises(EndingSignalError) as raised:
        unwound(signal.SIGTERM, signal.SIGINT, cleaned)
    assert (raised.value.code, cleaned) == (128 + signal.SIGINT, [])
