"""Effect of events before a contact on the energy that the tick gives in it.

A loop with energy accounting may be charged in advance: energy absorbed in free motion would mask
an unstable contact until it is spent. Here a hand stirs in free air, or leans on a wall that
returns all energy, before it meets a remote wall.
"""

from __future__ import annotations

import dataclasses
import math
import random
from typing import NamedTuple

from cardan.common.arm_libraries import np
from cardan.common.haptics import HapticCommand
from cardan.types import ZERO3, Vector3
from cardan_omni.driver.limits import TickLimits
from cardan_omni.peer.settings import HandMotion, Waypoint
from studies.haptics.loop import TICK_S, Bench, Trace
from studies.haptics.remote import Link, RemoteWall, Wall
from studies.haptics.stability import (
    HELD,
    LIGHTLY,
    OURS,
    PLAIN,
    RESTLESS_M_S,
    Hand,
    hidden_j,
    link_words,
)

SURPLUS_J = 0.05
"""Largest surplus that the tick keeps of absorbed energy, by tick.h of cardan_omni.driver."""
STIR_M_S = 0.2
"""RMS speed in free air."""
STIR_M = 0.05
FREE_M = 0.06
"""Height over the wall while stirring."""
CONTACT_S = 4.0
"""Duration of the observed contact."""
PASSIVE = (100.0, Link())
"""Stiffness, N/m, and link of a wall that returns all energy."""
LEAN_N = 1.9
"""Force that stores 18 mJ in that wall's spring."""
LEAN_S = 2.0


class Before(NamedTuple):
    """Events before a contact."""

    name: str
    stir_s: float = 0.0
    noise_n: float = 0.0
    """RMS of the noise on the measured force, of all axes together, at all times."""
    leans: bool = False
    """True: the hand leans on the passive wall."""
    keeps: bool = False
    """True: the wall under the hand gets a delay, and the hand leans less."""


class Contact(NamedTuple):
    """Wall that the hand touches afterwards."""

    hand: Hand
    stiffness_n_m: float
    link: Link


BEFORES = (
    Before("nothing"),
    Before("stirs for 40 s", 40.0),
    Before("stirs for 40 s, noise 0.05 N", 40.0, 0.05),
    Before("stirs for 40 s, noise 0.35 N", 40.0, 0.35),
    Before("leans on an undelayed wall, leaves it", leans=True),
    Before("leans on a wall that becomes delayed", leans=True, keeps=True),
)
CONTACTS = (Contact(LIGHTLY, 400.0, Link(0.01)), Contact(HELD, 400.0, Link(0.05)))


class Found(NamedTuple):
    """Result of one contact. Energies are taken from the simulation."""

    before: Before
    contact: Contact
    given_j: float
    """Largest net energy given to the hand since the contact began."""
    surplus_j: float
    """Surplus in the tick's energy account when the contact began."""
    bound_j: float
    """Bound at that time: the budget, a surplus, and the energy hidden by the sensors since."""
    margin_j: float
    """Smallest difference between bound and energy since."""
    restless_m_s: float
    """RMS speed in the last half second."""


def _motion(before: Before, hand: Hand) -> tuple[list[tuple[float, Vector3]], float]:
    """Return the hand's desired positions of the stylus by time, in HDAPI's frame (y is up), and
    the time when the contact begins."""
    points = [(0.0, Vector3(0.0, FREE_M, 0.0))]
    turn_s = 2.0 * math.pi * STIR_M / (math.sqrt(2.0) * STIR_M_S)
    turns = round(before.stir_s / turn_s)
    for count in range(int(turns * turn_s / 0.01)):
        angle = 2.0 * math.pi * count * 0.01 / turn_s
        points.append((0.3 + 0.01 * count, Vector3(STIR_M * math.sin(angle), FREE_M, 0.0)))
    time_s = 0.3 + turns * turn_s
    points.append((time_s, Vector3(0.0, FREE_M, 0.0)))
    if before.leans:
        deep = Vector3(0.0, -LEAN_N * (1.0 / PASSIVE[0] + 1.0 / hand.stiffness_n_m), 0.0)
        points.append((time_s + 0.6, deep))
        time_s += 0.6 + LEAN_S
        points.append((time_s, deep))
        if before.keeps:
            points.append((time_s + 0.3, Vector3(0.0, -hand.depth_m, 0.0)))
            return points, time_s
    points.append((time_s + 0.3, Vector3(0.0, 0.005, 0.0)))
    points.append((time_s + 0.6, Vector3(0.0, 0.005, 0.0)))
    points.append((time_s + 0.9, Vector3(0.0, -hand.depth_m, 0.0)))
    return points, time_s + 0.6


def run(limits: TickLimits, before: Before, contact: Contact) -> tuple[Trace, int]:
    """Return the whole trace, and the first tick of the contact."""
    hand = contact.hand
    points, begins_s = _motion(before, hand)
    stiff = Vector3(hand.stiffness_n_m, hand.stiffness_n_m, hand.stiffness_n_m)
    motion = HandMotion(tuple(Waypoint(t, p, gripped=True, stiffness_n_m=stiff) for t, p in points))
    settings = dataclasses.replace(hand.settings, motion=motion)
    chance = random.Random(1)
    axis_n = before.noise_n / math.sqrt(3.0)

    def wall(stiffness_n_m: float, link: Link, start: Vector3) -> RemoteWall:
        return RemoteWall(
            Wall(ZERO3, Vector3(0.0, 0.0, 1.0), stiffness_n_m), link, link, start=start
        )

    with Bench(limits, settings) as bench:
        bench.tick.enable()
        first_k, first_link = PASSIVE if before.leans else contact[1:]
        far = wall(first_k, first_link, Vector3(0.0, 0.0, FREE_M))
        sequence = 0

        def each(now_s: float) -> None:
            nonlocal sequence
            sequence += 1
            measured = far.cycle(bench.position, now_s)
            if measured is not None and axis_n:
                force = Vector3(*(f + chance.gauss(0.0, axis_n) for f in measured.force))
                measured = measured._replace(force=force)
            bench.tick.command(HapticCommand(sequence, now_s, True, measured=measured))

        begins = 4 * round(begins_s / (4.0 * TICK_S))
        bench.run(begins * TICK_S, each)
        if before.leans:
            far = wall(*contact[1:], bench.position)
        bench.run(CONTACT_S, each)
        return bench.trace, begins


def find(limits: TickLimits, before: Before, contact: Contact) -> Found:
    """Run a contact and return its result."""
    trace, begins = run(limits, before, contact)
    surplus_j = float(trace.surplus_j[begins - 1])
    # The account at the beginning covers the motion until a tick before it.
    given, hidden = trace.given_j[begins - 2 : -1], hidden_j(trace)[begins - 2 : -1]
    given, hidden = given - given[0], hidden - hidden[0]
    bound = limits.energy_budget_j + max(0.0, surplus_j) + np.maximum(0.0, hidden)
    speed = np.linalg.norm(trace.velocity_m_s[-500:], axis=1)
    worst = int(np.argmax(given))
    return Found(
        before,
        contact,
        float(given[worst]),
        surplus_j,
        float(bound[worst]),
        float((bound - given).min()),
        float(np.sqrt((speed**2).mean())),
    )


def table(found: list[tuple[Found, Found]]) -> str:
    """Return the Markdown table: plain loop and ours, contact by contact."""
    lines = [
        "| before | then | K, N/m | there and back | plain: energy, speed | ours "
        "| surplus on the books | its bound |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for plain, ours in found:
        hand, stiffness, link = ours.contact
        mark = "**" if plain.margin_j < 0.0 or plain.restless_m_s > RESTLESS_M_S else ""
        lines.append(
            f"| {ours.before.name} | {hand.name} | {stiffness:.0f} | {link_words(link)} "
            f"| {mark}{1e3 * plain.given_j:.1f} mJ, {1e3 * plain.restless_m_s:.0f} mm/s{mark} "
            f"| {1e3 * ours.given_j:.1f} mJ, {1e3 * ours.restless_m_s:.0f} mm/s "
            f"| {1e3 * max(0.0, ours.surplus_j):.1f} mJ | {1e3 * ours.bound_j:.1f} mJ |"
        )
    return "\n".join(lines)


def measure() -> list[tuple[Found, Found]]:
    """Summarize the plain loop and ours over all contacts."""
    return [
        (find(PLAIN, before, contact), find(OURS, before, contact))
        for contact in CONTACTS
        for before in BEFORES
    ]
