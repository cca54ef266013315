"""Comparison of a plain loop with ours: energy given to the hand.

The plain loop is the same tick with the same clamp and watchdogs, without the measures for
passivity: no passivity controller, no damping, no extrapolation, no slew limit, no detectors.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

from cardan.common.arm_libraries import np
from cardan.common.haptics import HapticCommand, Plane
from cardan.types import ZERO3, Vector3
from cardan_omni.driver.limits import TickLimits, UncheckedLimits
from cardan_omni.peer.settings import HandMotion, OmniSettings, Waypoint
from studies.haptics.loop import TICK_S, Array, Bench, Trace
from studies.haptics.remote import Link, RemoteWall, Wall
from studies.side_by_side import side_by_side

OURS = TickLimits(engage_ramp_s=0.1)
PLAIN = UncheckedLimits(
    engage_ramp_s=0.1,
    passivity=False,
    damping_n_s_m=0.0,
    extrapolate_s=0.0,
    slew_rise_n_s=400.0,
    velocity_gate_m_s=100.0,
    oscillation_speed_m_s=100.0,
)
"""Slew rate that the tick's own release needs at most: 0.4 N a tick."""
CONTROLLER_OFF = dataclasses.replace(OURS, passivity=False)
"""Our loop without the passivity controller only, to show the controller's effect."""

DURATION_S = 3.0
RESTLESS_M_S = 0.02
"""Limit for the RMS speed in the last half second, above which a loop has not settled: the hand is
at rest then, and one encoder quantum back and forth at 100 Hz is 0.014 m/s."""


DROOP_N = 0.2
"""Weight of an unheld stylus that friction carries in free air."""


class Hand(NamedTuple):
    """Model of the hand that holds the stylus, and its motion to the wall at z = 0."""

    name: str
    mass_kg: float
    damping_n_s_m: float
    stiffness_n_m: float
    depth_m: float
    """Desired depth in the wall."""
    gripped: bool = True
    push_n: float = 0.0
    """Additional force on the stylus: a weight."""
    friction_n: float = 0.26
    """Friction of the device."""

    @property
    def settings(self) -> OmniSettings:
        """Motion from 5 mm above the wall into it within 0.3 s, and then rest."""
        stiff = Vector3(self.stiffness_n_m, self.stiffness_n_m, self.stiffness_n_m)
        ways = ((0.0, 0.005), (0.3, 0.005), (0.6, -self.depth_m))
        points = tuple(
            Waypoint(t, Vector3(0.0, z, 0.0), gripped=self.gripped, stiffness_n_m=stiff)
            for t, z in ways
        )
        return OmniSettings(
            motion=HandMotion(points),
            hand_mass_kg=self.mass_kg,
            hand_damping_n_s_m=self.damping_n_s_m,
            hand_stiffness_n_m=self.stiffness_n_m,
            gripped=self.gripped,
            friction_n=self.friction_n,
            droop_n=DROOP_N,
        )


HELD = Hand("held", 0.2, 5.0, 200.0, 0.005)
LIGHTLY = Hand("lightly held", 0.05, 0.5, 50.0, 0.015)
UNHELD = Hand("unheld", 0.0, 0.0, 0.0, 0.0, gripped=False, push_n=-0.6)
HANDS = (HELD, LIGHTLY, UNHELD)


class Verdict(NamedTuple):
    """Result of a run. Energies are taken from the simulation."""

    given_j: float
    """Largest net energy given to the hand by the motors."""
    bound_j: float
    """Bound of `given_j` at that time: the budget, and the energy hidden by the sensors so far."""
    margin_j: float
    """Smallest difference between bound and energy; below 0: violated."""
    hidden_j: float
    """Largest energy hidden from the tick's account by the sensors."""
    harder_j: float
    """Energy that tick.h allows in addition to the budget for true accelerations > 100 m/s² in the
    run."""
    restless_m_s: float
    """RMS speed in the last half second."""
    peak_n: float

    @property
    def passive(self) -> bool:
        """True if the bound was kept at all times."""
        return self.margin_j >= 0.0

    @property
    def settled(self) -> bool:
        """True if the stylus came to rest."""
        return self.restless_m_s <= RESTLESS_M_S

    @property
    def stable(self) -> bool:
        """True if it is passive and settled."""
        return self.passive and self.settled


def harder_j(trace: Trace, limits: TickLimits) -> Array:
    """Evaluate the sum in tick.h's bound at each tick, from the true motion."""
    most = math.ceil(limits.clamp_n / (limits.slew_fall_n_s * TICK_S))
    price_n = limits.clamp_n * (most + 3) / 2.0
    moved = np.diff(trace.position_m, axis=0, prepend=trace.position_m[:1])
    change = np.linalg.norm(np.diff(moved, axis=0, prepend=moved[:1]), axis=1)
    found: Array = price_n * np.cumsum(np.maximum(0.0, change - limits.prediction_error_m))
    return found


def hidden_j(trace: Trace) -> Array:
    """Return the energy given until each tick that is missing in the tick's account, because of
    sensors and motors; exact, and of either sign.

    The tick receives y(k) = x(k-1) + q(k): a tick old, and quantized. Its account adds at least
    F(k-2) . (y(k) - y(k-1)). This is the true work except for F(k-2) . (q(k) - q(k-1)) and the
    rounding of the motors' converter. Tick k knows the rows up to k - 1.
    """
    x, y, sent = trace.position_m, trace.measured_m, trace.sent_n
    q = y[1:] - x[:-1]
    moved = np.diff(x, axis=0)
    quantized = np.einsum("ij,ij->i", sent[:-2], np.diff(q, axis=0))
    rounded = np.einsum("ij,ij->i", (trace.rendered_n - sent)[:-1], moved)
    found: Array = np.zeros(len(x))
    found[1:-1] = -np.cumsum(quantized) + np.cumsum(rounded[:-1])
    found[-1] = found[-2]
    return found


def judge(trace: Trace, limits: TickLimits) -> Verdict:
    """Judge a run with one engagement and a hand at rest in the end."""
    hidden = hidden_j(trace)
    bound = limits.energy_budget_j + np.maximum(0.0, hidden)
    last = trace.times_s > trace.times_s[-1] - 0.5
    speed = np.linalg.norm(trace.velocity_m_s[last], axis=1)
    worst = int(np.argmax(trace.given_j))
    return Verdict(
        float(trace.given_j[worst]),
        float(bound[worst]),
        float((bound - trace.given_j)[:-1].min()),
        float(hidden.max()),
        float(harder_j(trace, limits)[-1]),
        float(np.sqrt((speed**2).mean())),
        float(np.linalg.norm(trace.sent_n, axis=1).max()),
    )


Each = Callable[[float], None]


def _run(
    limits: TickLimits, hand: Hand, environment: Callable[[Bench], Each], every: int, seconds: float
) -> Trace:
    with Bench(limits, hand.settings) as bench:
        bench.tick.enable()
        each = environment(bench)
        bench.run(0.3, each, every)
        bench.sim.push(Vector3(0.0, 0.0, hand.push_n))
        bench.run(seconds - 0.3, each, every)
        return bench.trace


def local(
    limits: TickLimits,
    hand: Hand,
    stiffness_n_m: float,
    damping_n_s_m: float = 0.0,
    seconds: float = DURATION_S,
) -> Trace:
    """Run with a wall rendered by the tick itself."""
    wall = Plane(ZERO3, Vector3(0.0, 0.0, 1.0), stiffness_n_m, damping_n_s_m=damping_n_s_m)

    def environment(bench: Bench) -> Each:
        sequence = iter(range(1, 1_000_000))

        def each(now_s: float) -> None:
            bench.tick.command(HapticCommand(next(sequence), now_s, True, fixtures=(wall,)))

        return each

    return _run(limits, hand, environment, 4, seconds)


def remote(
    limits: TickLimits,
    hand: Hand,
    stiffness_n_m: float,
    link: Link,
    seconds: float = DURATION_S,
    seed: int = 1,
) -> Trace:
    """Run with a wall touched by a remote robot; `link`: each direction."""
    wall = Wall(ZERO3, Vector3(0.0, 0.0, 1.0), stiffness_n_m)

    def environment(bench: Bench) -> Each:
        far = RemoteWall(wall, link, link, start=Vector3(0.0, 0.0, 0.005), seed=seed)
        sequence = iter(range(1, 1_000_000))

        def each(now_s: float) -> None:
            measured = far.cycle(bench.position, now_s)
            bench.tick.command(HapticCommand(next(sequence), now_s, True, measured=measured))

        return each

    return _run(limits, hand, environment, round(link.period_s / TICK_S), seconds)


class Push(NamedTuple):
    """A parameter pushed until the plain loop, stable at `calm`, is unstable at `pushed`."""

    name: str
    hand: Hand
    calm: tuple[float, Link]
    """Stiffness, N/m, and link in each direction."""
    pushed: tuple[float, Link]


PUSHES = (
    Push("stiffness", LIGHTLY, (100.0, Link(0.01)), (400.0, Link(0.01))),
    Push("delay", HELD, (400.0, Link(0.01)), (400.0, Link(0.05))),
    Push("delay", HELD, (400.0, Link(0.01)), (400.0, Link(0.1))),
    Push("delay", LIGHTLY, (100.0, Link(0.01)), (100.0, Link(0.05))),
    Push("delay", LIGHTLY, (100.0, Link(0.01)), (100.0, Link(0.1))),
    Push("jitter", LIGHTLY, (200.0, Link(0.005)), (200.0, Link(0.005, jitter_s=0.05))),
    Push("loss", LIGHTLY, (140.0, Link(0.01)), (140.0, Link(0.01, loss=0.7))),
    Push("sampling", HELD, (2000.0, Link()), (2000.0, Link(period_s=0.018))),
)


class Compared(NamedTuple):
    """Results of both loops at one point."""

    hand: Hand
    stiffness_n_m: float
    link: Link
    plain: Verdict
    ours: Verdict


def compare(hand: Hand, stiffness_n_m: float, link: Link) -> Compared:
    """Run both loops at one point."""
    plain, ours = (judge(remote(x, hand, stiffness_n_m, link), x) for x in (PLAIN, OURS))
    return Compared(hand, stiffness_n_m, link, plain, ours)


GRID_STIFFNESSES = tuple(float(k) for k in np.geomspace(20.0, 4000.0, 14))
GRID_DELAYS_S = (0.0, 0.005, 0.01, 0.02, 0.035, 0.05, 0.075, 0.1)
"""Delay per direction."""


def grid(hand: Hand) -> list[Compared]:
    """Compare the loops over stiffness and delay, stiffness by stiffness."""
    calls = [(hand, k, Link(d)) for k in GRID_STIFFNESSES for d in GRID_DELAYS_S]
    return side_by_side(compare, calls)


JITTERS_S = (0.0, 0.01, 0.02, 0.05, 0.1)
"""Jitter per direction."""
LOSSES = (0.0, 0.2, 0.4, 0.6, 0.8)
"""Loss per direction."""
CHANNEL_STIFFNESS_N_M = 140.0
CHANNEL_DELAY_S = 0.01
PERIODS_S = (0.004, 0.008, 0.012, 0.015, 0.018)
"""Sampling periods below `hold_s`, after which a silent source counts as dead."""
SAMPLED_STIFFNESSES = (500.0, 1000.0, 1500.0, 2000.0, 3000.0, 4000.0)


def channel_grid() -> list[Compared]:
    """Compare the loops, lightly held, over loss and jitter, loss by loss."""
    calls = [
        (LIGHTLY, CHANNEL_STIFFNESS_N_M, Link(CHANNEL_DELAY_S, jitter, loss))
        for loss in LOSSES
        for jitter in JITTERS_S
    ]
    return side_by_side(compare, calls)


def sampling_grid() -> list[Compared]:
    """Compare the loops, held, over stiffness and sampling period without delay, stiffness by
    stiffness."""
    calls = [
        (HELD, stiffness, Link(period_s=period))
        for stiffness in SAMPLED_STIFFNESSES
        for period in PERIODS_S
    ]
    return side_by_side(compare, calls)


def link_words(link: Link) -> str:
    """Describe a link for the tables; delays are round trips."""
    words = f"{2e3 * link.delay_s:.0f} ms"
    if link.jitter_s:
        words += f" + 0..{2e3 * link.jitter_s:.0f} ms"
    if link.loss:
        words += f", {link.loss:.0%} lost each way"
    if link.period_s != Link().period_s:
        words += f", each {1e3 * link.period_s:.0f} ms"
    return words


def table(found: list[tuple[Push, Compared, Compared]]) -> str:
    """Return the Markdown table of the pushes, calm and pushed."""
    lines = [
        "| varied | hand | K, N/m | there and back | plain: energy, speed | ours | its bound |",
        "|---|---|---|---|---|---|---|",
    ]
    for push, *points in found:
        for point in points:
            plain, ours = point.plain, point.ours
            mark = "" if plain.stable else "**"
            lines.append(
                f"| {push.name} | {point.hand.name} | {point.stiffness_n_m:.0f} "
                f"| {link_words(point.link)} "
                f"| {mark}{1e3 * plain.given_j:.1f} mJ, {1e3 * plain.restless_m_s:.0f} mm/s{mark} "
                f"| {1e3 * ours.given_j:.1f} mJ, {1e3 * ours.restless_m_s:.0f} mm/s "
                f"| {1e3 * ours.bound_j:.1f} mJ |"
            )
    return "\n".join(lines)


def summary(what: str, points: list[Compared]) -> str:
    """Summarize a grid over `what` in one line."""
    unstable = [one for one in points if not one.plain.stable]
    retained = sum(one.ours.passive for one in points)
    rest = sum(one.ours.settled for one in points)
    least = min(one.ours.margin_j for one in points)
    most = max(one.ours.given_j for one in points)
    hidden = max(one.ours.hidden_j for one in points)
    harder = max(one.ours.harder_j for one in points)
    return (
        f"{what}, {points[0].hand.name}: {len(points)} points, plain unstable at {len(unstable)}; "
        f"ours within its bound at {retained}, at rest at {rest}; most energy {1e3 * most:.1f} mJ, "
        f"least margin {1e3 * least:.2f} mJ, most hidden {1e3 * hidden:.2f} mJ, "
        f"sum for harder accelerations {1e3 * harder:.1f} mJ"
    )
