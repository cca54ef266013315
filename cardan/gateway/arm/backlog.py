"""Limits on the time that a request for motion may have waited on its way, by any route."""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import NamedTuple

from cardan.types import NEVER_S

STALE_S = 0.3
"""A command that may have waited for longer is dropped: its sender may have stopped since."""

STREAMED_S = 0.2
"""The same of a streamed command, at the arm: with the stream's timeout and the way that braking
takes it is at rest within 0.4 s."""

PROVEN_S = 0.3
"""How long a command of a sender that is not known yet may have waited until that was connected."""

NEVER_STALE = "/stop", "/release", "/cancel_goal"
"""Endings of the names of commands that only end something."""

UNKNOWN_CLOCK = "the clock of its sender is not known yet"
"""Why the first commands of a sender are refused, for PROVEN_S at most."""

BACKLOGGED_S = 1.0
"""A client of which something waits for more than STALE_S, for this long, sends more than can be
handled: it is disconnected."""

BACKLOGGED = f"what you send has waited here for more than {STALE_S:g} s: send less often"
"""The reason for the client, of 123 bytes at most, the limit of WebSocket."""


def is_stale(name: str, waited_s: float) -> bool:
    """Whether a client's message, call or goal waited for too long to act on; a stop is never too
    late."""
    return waited_s > STALE_S and not name.endswith(NEVER_STALE)


def stale_words(name: str, waited_s: float) -> str:
    """Why a call or a goal that `is_stale` is refused."""
    return f"{name}: it waited here for up to {waited_s:.1f} s; that is too late to act on"


def late_words(waited_s: float) -> str:
    """Why a streamed command is refused that waited for longer than STREAMED_S."""
    return (
        f"it waited for {waited_s:.2f} s on its way; more than {STREAMED_S:g} s is too late to act "
        "on"
    )


class Backlog:
    """Whether more waits of one client, and for longer, than is tolerated."""

    def __init__(self) -> None:
        self._since_s = NEVER_S

    def lasts(self, waited_s: float, now_s: float) -> bool:
        """Whether it has lasted for too long, as of `now_s` the newest that was read can have
        waited for `waited_s`."""
        if waited_s <= STALE_S:
            self._since_s = NEVER_S
            return False
        if self._since_s == NEVER_S:
            self._since_s = now_s
        return now_s - self._since_s > BACKLOGGED_S


SENDERS = 64
"""Senders whose delays are kept; the longest silent one is dropped first."""

REMEMBERED_S = 30.0
"""How long the smallest delay of a sender that goes on counts, at least; twice this at most. Two
clocks that differ by 100 ppm part by 6 ms meanwhile, and a clock that was set is trusted again."""

FORGOTTEN_S = 3600.0
"""After so long a silence nothing is known of a sender's clock any more."""

DRIFT = 1e-4
"""By how much two clocks may part while their sender is silent."""

AGREE_S = 0.005
"""Shortest time between two stamps that says something."""


class _Quickest(NamedTuple):
    """The smallest delays of one sender, s: of the present period and of the one before."""

    began_s: float
    now_s: float
    before_s: float
    heard_s: float
    """When its newest command came."""
    unproven_s: float
    """When its first command came, while nothing shows that its stamps are live; else infinite."""
    anchor: tuple[float, float]
    """Times of a command that the next ones are compared with: its stamp, and when it came."""
    waited_s: float = 0.0
    """Delay of its newest command: how much longer than its quickest it was on its way."""


class Delays:
    """The smallest difference seen lately between reception here and each sender's own stamps."""

    def __init__(self) -> None:
        self._quickest: dict[Hashable, _Quickest] = {}

    def hear(self, owner: Hashable, stamp_s: float, now_s: float, retained: str = "") -> float:
        """Learn from a command, taken or not; how much longer than its sender's quickest it was on
        its way, s; 0 for a first. `retained`: a sender that is not forgotten for others."""
        known = self._quickest.pop(owner, None)
        if known is None or now_s - known.heard_s > FORGOTTEN_S:
            # Between a program without a name, which is this one, and the arm there is no queue.
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
        """Why the newest command of a sender is too late to act on; empty: it is not."""
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
