"""A hand, a network and a stiff wall in virtual time: the rendered force of a remote contact."""

from __future__ import annotations

import heapq
import itertools
import random
from typing import NamedTuple

from cardan.gateway.force.passive import DevicePort, FarPort, share_left
from cardan.types import Vector3

STEP_S = 0.0005
CYCLE_S = 0.004
"""Cycle of both ends."""
WALL_N_M = 400.0
"""Stiffness of the wall in the haptics study, with which a plain loop is unstable."""
MOST_N = 3.3


class Way:
    """One direction of a link: late, uneven, lossy, out of order, and at times silent."""

    def __init__(self, delay_s, jitter_s, loss, stalls, chosen):
        self._delay_s, self._jitter_s, self._loss = delay_s, jitter_s, loss
        self._stalls, self._chosen = stalls, chosen
        self._queue, self._numbers = [], itertools.count()

    def send(self, item, now_s):
        if self._chosen.random() < self._loss:
            return
        at_s = now_s + self._delay_s + self._chosen.uniform(0.0, self._jitter_s)
        for from_s, until_s in self._stalls:
            if from_s <= at_s < until_s:
                at_s = until_s
        heapq.heappush(self._queue, (at_s, next(self._numbers), item))

    def arrived(self, now_s):
        while self._queue and self._queue[0][0] <= now_s:
            yield heapq.heappop(self._queue)[2]


class Hand(NamedTuple):
    """A hand that holds the stylus and pulls it by a spring to its desired place."""

    mass_kg: float = 0.1
    damping_n_s_m: float = 1.0
    stiffness_n_m: float = 100.0


class WallContact(NamedTuple):
    """State at one step, along the wall's normal; the wall is below 0."""

    now_s: float
    place_m: float
    speed_m_s: float
    force_n: float
    given_j: float
    """Net energy given to the hand."""


def press(
    wanted,
    seconds,
    *,
    delay_s=0.0,
    jitter_s=0.0,
    loss=0.0,
    stalls=(),
    cut_s=float("inf"),
    passive=True,
    hand=Hand(),  # noqa: B008  # immutable
    wall_n_m=WALL_N_M,
    seed=1,
):
    """Simulate a hand whose desired place is `wanted(now_s)`; return the states. Each direction of
    the link has `delay_s` and the other faults; from `cut_s` on no packet arrives. Without
    `passive`, each force is rendered until the next one arrives."""
    chosen = random.Random(seed)
    there, back = (Way(delay_s, jitter_s, loss, stalls, chosen) for _ in range(2))
    far, port = FarPort(), DevicePort()
    place, speed, force, given_j = wanted(0.0), 0.0, 0.0, 0.0
    goal, newest_there = (-1, place, 0.0), -1
    asked, heard_s = (-1, 0.0, 0.0, 0.0), 0.0
    rows = []
    every = round(CYCLE_S / STEP_S)
    for count in range(round(seconds / STEP_S)):
        now_s = count * STEP_S
        if count % every == 0:
            number = count // every
            there.send((number, place, now_s), now_s)
            for item in there.arrived(now_s):
                if item[0] > newest_there and now_s < cut_s:
                    newest_there, goal = item[0], item
            _, at, made_s = goal
            push = wall_n_m * max(0.0, -at)
            absorbed_j = far.step(Vector3(0.0, 0.0, at), Vector3(0.0, 0.0, push))
            back.send((number, push, absorbed_j, made_s), now_s)
            for item in back.arrived(now_s):
                if item[0] > asked[0] and now_s < cut_s:
                    asked, heard_s = item, now_s
            _, push, absorbed_j, answers_s = asked
            if passive:
                left = share_left(now_s - heard_s, now_s - answers_s)
                at = Vector3(0.0, 0.0, place)
                force = port.step(at, Vector3(0.0, 0.0, push), absorbed_j, left, now_s).z
            else:
                force = push if now_s - heard_s < 0.1 else 0.0
            force = min(MOST_N, force)
        own = hand.stiffness_n_m * (wanted(now_s) - place) - hand.damping_n_s_m * speed
        speed += (own + force) / hand.mass_kg * STEP_S
        step = speed * STEP_S
        place += step
        given_j += force * step
        rows.append(WallContact(now_s, place, speed, force, given_j))
    assert asked[0] >= 0
    return rows


def into_the_wall(now_s):
    """Move from 5 mm above the wall to 15 mm below its surface within 0.5 s, then rest."""
    return 0.005 - 0.02 * min(1.0, max(0.0, (now_s - 0.3) / 0.5))
