"""Bounded waits for other threads and processes, and repetition of interrupted actions."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

from cardan.errors import CardanError

WITHIN_S = 120.0
"""Longest wait. A busy computer starts processes slowly: in 30 s at a load of 18."""
PERIOD_S = 0.002

STOOD_STILL = "stalled for"
"""Text of a session's reason for ended or refused motion: no process served the arm for more than
`stall_s`, because the computer stood still."""
MOVES_STILL = "moves already"
"""Text of a reason while the robot still follows its last command."""
BRAKES_S = 0.1
TRIES = 10
"""Limit on attempts of an action that takes seconds, each interrupted by a pause of the
computer."""
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
    """Return the result of `act`, repeated if a pause of the computer interrupted it.

    The session reports an interruption by `reason` or in an error. After one, `act` is also
    repeated while the robot is not at rest. Other results are returned, and other errors raised.
    """
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
    """Wait with `until` for an arm that a program streams to. After a pause of the computer refused
    the stream, `zero` lets the program send zero first."""

    def streamed() -> _T:
        if outcomes()[-1:] == ["refused"]:
            zero()  # The next message may replace it; then it is sent again.
            threading.Event().wait(ZERO_PERIOD_S)
        return found()

    return until(streamed, what)
