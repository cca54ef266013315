"""Rendered stiffness over delay: a wall at a remote arm, over a network with jitter and loss.

The simulated Omni and the compiled tick meet a remote wall: either the newest force is rendered as
it arrives, or the control law of `cardan devices share` runs at both ends.
"""

from __future__ import annotations

from typing import NamedTuple

from cardan.common.arm_libraries import np
from cardan.common.haptics import HapticCommand, MeasuredForce
from cardan.gateway.force.passive import DevicePort, FarPort, share_left
from cardan.types import NEVER_S, ZERO3, Vector3
from cardan_omni.driver.limits import TickLimits
from studies.haptics.loop import TICK_S, Bench, Trace
from studies.haptics.remote import Channel, Link, Robot, Wall
from studies.haptics.stability import HELD, LIGHTLY, OURS, PLAIN, Hand, Verdict, judge
from studies.side_by_side import side_by_side

DELAYS_S = (0.0, 0.01, 0.05, 0.1, 0.2)
"""Delay per direction."""
LOSS, JITTER = 0.05, 0.5
"""Loss per direction; jitter as a share of the delay."""
STIFFNESS_N_M = 400.0
SECONDS, PRESSED_S = 6.0, 1.0
"""Duration of a run, and of its end in which the hand rests on the wall."""
LAG_S, FASTEST_M_S = 0.004, 2.0


class FarWall:
    """The wall behind both links. `law`: the control law runs at both ends."""

    def __init__(self, link: Link, law: bool, seed: int = 1) -> None:
        self._there: Channel[tuple[int, Vector3, float]] = Channel(link, seed)
        self._back: Channel[tuple[int, Vector3, float, float]] = Channel(link, seed + 1)
        start = Vector3(0.0, 0.0, 0.005)
        wall = Wall(ZERO3, Vector3(0.0, 0.0, 1.0), STIFFNESS_N_M)
        self._robot = Robot(wall, LAG_S, FASTEST_M_S, start)
        self._period_s = link.period_s
        self._goal: tuple[int, Vector3, float] = (0, start, NEVER_S)
        self._asked: tuple[int, Vector3, float, float] = (0, ZERO3, 0.0, NEVER_S)
        self._heard_s = NEVER_S
        self._sent = 0
        self._far, self._hand = FarPort(), DevicePort() if law else None

    def cycle(self, stylus: Vector3, now_s: float) -> MeasuredForce:
        """Run both ends for a period; return the force for the tick."""
        self._sent += 1
        self._there.send((self._sent, stylus, now_s), now_s)
        self._goal = max([self._goal, *self._there.receive(now_s)], key=lambda item: item[0])
        _, goal, made_s = self._goal
        force = self._robot.step(goal, self._period_s)
        absorbed_j = self._far.step(goal, force)
        self._back.send((self._sent, force, absorbed_j, made_s), now_s)
        for item in self._back.receive(now_s):
            if item[0] > self._asked[0]:
                self._asked, self._heard_s = item, now_s
        _, force, absorbed_j, answers_s = self._asked
        if self._hand is not None:
            left = share_left(now_s - self._heard_s, now_s - answers_s)
            force = self._hand.step(stylus, force, absorbed_j, left, now_s)
        return MeasuredForce(force, now_s, position=stylus)


class Point(NamedTuple):
    """Result at one delay."""

    hand: Hand
    delay_s: float
    plain: Verdict
    """Newest force as it arrives, with the plain tick."""
    ours: Verdict
    """Control law at both ends, with our tick."""
    alone_n_m: float
    """Ratio of force to depth at rest, with our tick and without the law."""
    rendered_n_m: float
    """The same ratio with the law."""


def run(limits: TickLimits, hand: Hand, link: Link, law: bool) -> Trace:
    """Press on the remote wall and rest there."""
    with Bench(limits, hand.settings) as bench:
        bench.tick.enable()
        far = FarWall(link, law)
        sequence = iter(range(1, 1_000_000))

        def each(now_s: float) -> None:
            measured = far.cycle(bench.position, now_s)
            bench.tick.command(HapticCommand(next(sequence), now_s, True, measured=measured))

        bench.run(SECONDS, each, round(link.period_s / TICK_S))
        return bench.trace


def rendered_n_m(trace: Trace) -> float:
    """Ratio of mean force to mean depth at the end."""
    late = trace.times_s > trace.times_s[-1] - PRESSED_S
    depth_m = -float(np.mean(trace.position_m[late, 2]))
    return float(np.mean(trace.rendered_n[late, 2])) / depth_m if depth_m > 0.0 else 0.0


def _point(delay_s: float, hand: Hand) -> Point:
    link = Link(delay_s, JITTER * delay_s, LOSS)
    plain, alone, ours = (
        run(limits, hand, link, law)
        for limits, law in ((PLAIN, False), (OURS, False), (OURS, True))
    )
    return Point(
        hand,
        delay_s,
        judge(plain, PLAIN),
        judge(ours, OURS),
        rendered_n_m(alone),
        rendered_n_m(ours),
    )


def measure(hands: tuple[Hand, ...] = (HELD, LIGHTLY)) -> list[Point]:
    """Measure all delays, hand by hand."""
    return side_by_side(_point, [(delay_s, hand) for hand in hands for delay_s in DELAYS_S])


def table(found: list[Point]) -> str:
    """Return the Markdown table."""
    lines = [
        "| hand | delay one way | plain: energy, speed | ours: energy, speed "
        f"| felt of {STIFFNESS_N_M:.0f} N/m | the tick alone |",
        "|---|---|---|---|---|---|",
    ]
    for hand, delay_s, plain, ours, alone, rendered in found:
        plain_mj, ours_mj = 1e3 * plain.given_j, 1e3 * ours.given_j
        jitter = f" + 0..{1e3 * JITTER * delay_s:.0f} ms" if delay_s else ""
        mark = "" if plain.stable else "**"
        lines.append(
            f"| {hand.name} | {1e3 * delay_s:.0f}{jitter or ' ms'} "
            f"| {mark}{plain_mj:.1f} mJ, {1e3 * plain.restless_m_s:.0f} mm/s{mark} "
            f"| {ours_mj:.1f} mJ, {1e3 * ours.restless_m_s:.0f} mm/s "
            f"| {rendered:.0f} N/m | {alone:.0f} N/m |"
        )
    return "\n".join(lines)
