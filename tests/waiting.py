"""Bounded waits for other threads and processes, and repetition of acts that were cut short."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

from cardan.errors import CardanError

WITHIN_S = 120.0
"""A machine with other work to do starts processes slowly: at a load of 18, in 30 s."""
PERIOD_S = 0.002

STOOD_STILL = "stood still for"
"""In a session's words for why a motion has ended or has not begun: nobody served the arm for
longer than `stall_s`, as the computer did nothing."""
MOVES_STILL = "moves already"
"""Of a robot that follows its last command for a moment."""
BRAKES_S = 0.1
TRIES = 10
"""Of an act that takes some seconds: a computer that cuts all of them short is none to test on."""
ZERO_PERIOD_S = 0.05

_T = TypeVar("_T")


def until(found: Callable[[], _T], what: str = "it", within_s: float = WITHIN_S) -> _T:
    """Return the first true result of `found`; fail after `within_s`."""
    deadline_s = time.monotonic() + within_s
    while not (answer := found()):
        assert time.monotonic() < deadline_s, f"{what} did not happen"
        threading.Event().wait(PERIOD_S)
    return answer


def done_again(act: Callable[[], _T], reason: Callable[[_T], str] = str) -> _T:
    """Return the result of `act`. It is repeated while the session says by `reason` of it, or as an
    error, that it was cut short as the computer stood still, or, after that, that the robot is not
    at rest yet. Any other words stay as they are."""
    said = ""
    for _ in range(TRIES):
        again = (STOOD_STILL, MOVES_STILL) if said else (STOOD_STILL,)
        try:
            answer = act()
        except CardanError as error:
            said = str(error)
            if not any(each in said for each in again):
                raise
        else:
            said = reason(answer)
            if not any(each in said for each in again):
                return answer
        threading.Event().wait(BRAKES_S)
    raise AssertionError(f"{TRIES} times: {said}")


def until_streamed(
    found: Callable[[], _T],
    outcomes: Callable[[], list[str]],
    zero: Callable[[], object],
    what: str,
) -> _T:
    """`until`, of an arm that a program streams to: where it was refused last, as what goes on
    streaming is after the computer stood still, `zero` has the program send that first."""

    def streamed() -> _T:
        if outcomes()[-1:] == ["refused"]:
            zero()  # It may be displaced by the next message, and then it is sent again.
            threading.Event().wait(ZERO_PERIOD_S)
        return found()

    return until(streamed, what)
