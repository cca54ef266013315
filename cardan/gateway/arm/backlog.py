"""Limits on the delay of a request for motion between its sender and the arm, by any route."""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import NamedTuple

from cardan.types import NEVER_S

STALE_S = 0.3
"""A command that may have waited for longer is dropped: its sender may have stopped since."""

STREAMED_S = 0.2
"""Limit for a streamed command, at the arm: with the stream's timeout and its braking ramp the arm
is at rest within 0.4 s."""

PROVEN_S = 0.3
"""Longest delay that the first command of an unknown sender may have had until its connection was
made."""

NEVER_STALE = "/stop", "/release", "/cancel_goal"
"""Endings of the names of commands that only end motion or give up authority."""

UNKNOWN_CLOCK = "the clock of its sender is not known yet"
"""Reason for refusing the first commands of a sender, for PROVEN_S at most."""

BACKLOGGED_S = 1.0
"""A client is disconnected when its messages have waited for more than STALE_S for this long: it
sends more than can be handled."""

BACKLOGGED = f"your commands have waited here for more than {STALE_S:g} s: send less often"
"""The reason for the client, of 123 bytes at most, the limit of WebSocket."""


def is_stale(name: str, waited_s: float) -> bool:
    """Return whether a client's message, call or goal waited too long to act on; a stop is never
    too late."""
    return waited_s > STALE_S and not name.endswith(NEVER_STALE)


def stale_words(name: str, waited_s: float) -> str:
    """Return why a stale call or goal is refused."""
    return f"{name}: it waited here for up to {waited_s:.1f} s; commands that old are not executed"


def late_words(waited_s: float) -> str:
    """Return why a streamed command that waited for longer than STREAMED_S is refused."""
    return (
        f"it waited for {waited_s:.2f} s on its way; commands older than "
        f"{STREAMED_S:g} s are not executed"
    )


class Backlog:
    """Detector of a client whose messages wait too long, for too long."""

    def __init__(self) -> None:
        self._since_s = NEVER_S

    def lasts(self, waited_s: float, now_s: float) -> bool:
        """Return whether the backlog has lasted too long; `waited_s`: longest possible delay of the
        newest message read at `now_s`."""
        if waited_s <= STALE_S:
            self._since_s = NEVER_S
            return False
        if self._since_s == NEVER_S:
            self._since_s = now_s
        return now_s - self._since_s > BACKLOGGED_S


SENDERS = 64
"""Senders whose delays are kept; the longest silent one is dropped first."""

REMEMBERED_S = 30.0
"""Shortest time for which the smallest delay of an active sender counts; twice this at most. Two
clocks that differ by 100 ppm drift apart by 6 ms meanwhile, and a clock that was set is trusted
again."""

FORGOTTEN_S = 3600.0
"""Silence after which a sender's clock counts as unknown again."""

DRIFT = 1e-4
"""Largest relative drift between two clocks while their sender is silent."""

AGREE_S = 0.005
"""Shortest time between two stamps from which their clock is judged."""


class _Quickest(NamedTuple):
    """The smallest delays of one sender, s: of the present period and of the one before."""

    began_s: float
    now_s: float
    before_s: float
    heard_s: float
    """Time of reception of its newest command."""
    unproven_s: float
    """Time of reception of its first command while nothing shows that its stamps are live; else
    infinite."""
    anchor: tuple[float, float]
    """Stamp and time of reception of the command that the next ones are compared with."""
    waited_s: float = 0.0
    """Delay of its newest command, compared with its quickest one."""


class Delays:
    """The smallest recent difference between time of reception and stamp, for each sender."""

    def __init__(self) -> None:
        self._quickest: dict[Hashable, _Quickest] = {}

    def hear(self, owner: Hashable, stamp_s: float, now_s: float, retained: str = "") -> float:
        """Learn from a command, taken or not. Return its delay compared with its sender's quickest
        command, s; 0 for a first. `retained`: a sender that is not dropped in favor of others."""
        known = self._quickest.pop(owner, None)
        if known is None or now_s - known.heard_s > FORGOTTEN_S:
            # No owner means this program, which has no queue between itself and the arm.
            unproven_s = now_s if owner else math.inf
            known = _Quickest(now_s, math.inf, math.inf, now_s, unproven_s, (stamp_s, now_s))
        began_s, quickest_s, before_s, heard_s, unproven_s, anchor, _ = known
        if now_s - began_s >= REMEMBERED_S:
            began_s, quickest_s, before_s = now_s, math.inf, quickest_s
        silent_s = now_s - heard_s
        delay_s = now_s - stamp_s
        waited_s = delay_s - min(quickest_s, before_s, delay_s)
        if silent_s > REMEMBERED_S:
            waited_s = max(0.0, waited_s - DRIFT * silent_s)
        if unproven_s < math.inf:
            step_s, passed_s = stamp_s - anchor[0], now_s - anchor[1]
            if now_s - unproven_s > PROVEN_S or (
                step_s >= AGREE_S and abs(passed_s - step_s) <= 0.5 * step_s
            ):
                unproven_s = math.inf
            elif abs(step_s) >= AGREE_S:
                anchor = stamp_s, now_s
        if len(self._quickest) >= SENDERS:
            del self._quickest[next(each for each in self._quickest if each != retained)]
        self._quickest[owner] = _Quickest(
            began_s, min(quickest_s, delay_s), before_s, now_s, unproven_s, anchor, waited_s
        )
        return waited_s

    def late(self, owner: Hashable) -> str:
        """Return why the newest command of a sender is too old to execute; empty if it is not."""
        known = self._quickest.get(owner)
        if known is None:
            return ""
        if known.waited_s > STREAMED_S:
            return late_words(known.waited_s)
        if known.unproven_s < math.inf:
            return (
                f"{UNKNOWN_CLOCK}, so it may have waited on its way: commands count once two "
                f"stamps agree with their arrival, or after {PROVEN_S:g} s"
            )
        return ""
