"""Arbitrary movements of the PR2's right arm: seven joints, two of them continuous."""

from __future__ import annotations

import math
from typing import NamedTuple

from cardan.common.arm_libraries import np, pin
from cardan.gateway.motion.shaping import PoseShaperLimits
from studies.metrics import delay_by_correlation, delay_by_least_error, stop_phases
from studies.thesis.bench import (
    DT_S,
    Array,
    Bench,
    Drive,
    Metronome,
    Row,
    Shaped,
    Streams,
    Trace,
    both,
    quantiles_ms,
    signed_delays,
)

ROBOT = "pr2_right_arm"
RATE_HZ = 50.0
TURNS = 10.5
TURN_RAD_S = 3.0
WANDER_S = 40.0
LONGEST_S = 1.0
SEED = 2
START_DEG = (-35.0, 20.0, -60.0, -95.0, 178.0, -50.0, 178.0)
"""Start with both continuous joints near the half turn, so that the motion crosses it
repeatedly."""
REACH_M = 0.07
REACH_RAD = 0.5
TAIL_S = 1.0


SHAPER = PoseShaperLimits(
    linear_acceleration_m_s2=5.0,
    linear_jerk_m_s3=500.0,
    angular_speed_rad_s=3.4,
    angular_acceleration_rad_s2=30.0,
    angular_jerk_rad_s3=3000.0,
)


def _driving(bench: Bench, shaped: bool) -> Streams | Shaped:
    return bench.shaped(SHAPER) if shaped else bench.streams("pose")


class Turning(NamedTuple):
    """More than ten turns of the wrist about its own axis."""

    asked: float
    """Commanded number of turns, without sign."""
    turns: float
    """Measured number of turns of the TCP."""
    refusals: int
    refusal: str
    """Reason of the first refusal."""
    stops: int
    largest_step_rad_s: float
    """Largest speed of any joint."""
    delay_s: float
    """Delay by least error of the angle."""
    trace: Trace
    angle_rad: Array
    """Angle commanded by the program."""


def turning(drive: Drive, sign: float, shaped: bool, turns: float = TURNS) -> Turning:
    """Stream absolute poses at 50 Hz that turn the TCP about its x axis, at 3 rad/s."""
    bench = Bench(ROBOT, drive, counterbalanced=True)
    driving = _driving(bench, shaped)
    start = bench.placement(driving)
    ramp_s, total = 1.0, 2.0 * math.pi * turns
    duration_s = total / TURN_RAD_S + ramp_s
    clock = Metronome(RATE_HZ)

    def angle(times_s: Array) -> Array:
        t = np.clip(times_s, 0.0, duration_s)
        up = np.minimum(t, ramp_s) ** 2 / (2.0 * ramp_s)
        flat = np.clip(t - ramp_s, 0.0, duration_s - 2.0 * ramp_s)
        down = np.clip(t - (duration_s - ramp_s), 0.0, ramp_s)
        return sign * TURN_RAD_S * (up + flat + down - down**2 / (2.0 * ramp_s))

    def operator(now_s: float) -> None:
        due_s = clock.due(now_s)
        if due_s is not None:
            turn = float(angle(np.array((due_s,)))[0])
            rotation = start.rotation @ pin.exp3(np.array((turn, 0.0, 0.0)))
            driving.pose(start.translation, rotation)

    trace = bench.run(driving, duration_s + TAIL_S, operator)
    wanted = angle(trace.times_s)[:, None]
    first = trace.rotations[0]
    about = np.array([pin.log3(first.T @ rotation)[0] for rotation in trace.rotations[::5]])
    done = np.interp(trace.times_s, trace.times_s[::5], np.unwrap(about))[:, None]
    stops = stop_phases(trace.times_s, wanted, done)
    speeds = np.abs(np.gradient(trace.joints, DT_S, axis=0))
    return Turning(
        turns,
        float(done[-1, 0] / (2.0 * math.pi)),
        len(driving.refusals),
        driving.refusals[0] if driving.refusals else "",
        stops.count,
        float(speeds.max()),
        delay_by_least_error(DT_S, wanted, done, LONGEST_S),
        trace,
        wanted[:, 0],
    )


class Wander(NamedTuple):
    """Free motion along three axes, with rotation."""

    trace: Trace
    wanted_m: Array
    delays_s: Array
    sent_s: Array
    """Times of the commands that have a delay."""
    correlation_s: float
    least_error_s: float
    refusals: int
    stops: int
    crossings: tuple[int, int]
    """Number of times that forearm and wrist roll cross an odd multiple of pi."""
    path_m: float


def _wandering(times_s: Array) -> tuple[Array, Array]:
    """Position and rotation vector relative to the start: sums of slow sines that begin at rest."""
    generator = np.random.default_rng(SEED)
    rates = generator.uniform(0.5, 1.7, (6, 3))
    phases = generator.uniform(0.0, 2.0 * np.pi, (6, 3))
    waves = np.sin(rates[None] * times_s[:, None, None] + phases[None]) - np.sin(phases)[None]
    eased = np.clip(times_s / 2.0, 0.0, 1.0)
    eased = (eased * eased * (3.0 - 2.0 * eased))[:, None]
    found = eased * waves.mean(axis=2)
    return REACH_M * found[:, :3], REACH_RAD * found[:, 3:]


def wander(drive: Drive, shaped: bool, seconds: float = WANDER_S) -> Wander:
    """Stream absolute poses at 50 Hz on a smooth random path."""
    bench = Bench(ROBOT, drive, np.radians(START_DEG), counterbalanced=True)
    driving = _driving(bench, shaped)
    start = bench.placement(driving)
    clock = Metronome(RATE_HZ)

    def operator(now_s: float) -> None:
        due_s = clock.due(now_s)
        if due_s is not None:
            way, turn = _wandering(np.array((due_s,)))
            driving.pose(start.translation + way[0], pin.exp3(turn[0]) @ start.rotation)

    trace = bench.run(driving, seconds, operator)
    wanted = _wandering(trace.times_s)[0]
    output = trace.measured_m - trace.measured_m[0]
    speed = np.linalg.norm(np.gradient(wanted, DT_S, axis=0), axis=1)
    sent_s = np.arange(0.0, seconds - LONGEST_S, 1.0 / RATE_HZ)
    sent_s = sent_s[np.interp(sent_s, trace.times_s, speed) > 0.3 * np.median(speed)]
    stops = stop_phases(trace.times_s, wanted, output)
    half_turns = np.floor((trace.joints[:, (4, 6)] + math.pi) / (2.0 * math.pi))
    crossed = np.count_nonzero(np.diff(half_turns, axis=0), axis=0)
    return Wander(
        trace,
        wanted,
        signed_delays(sent_s, _wandering(sent_s)[0], trace.times_s, output, LONGEST_S),
        sent_s,
        delay_by_correlation(DT_S, wanted, output, LONGEST_S),
        delay_by_least_error(DT_S, wanted, output, LONGEST_S),
        len(driving.refusals),
        stops.count,
        (int(crossed[0]), int(crossed[1])),
        float(np.linalg.norm(np.diff(wanted, axis=0), axis=1).sum()),
    )


class Result(NamedTuple):
    """Result for one drive and one way of driving."""

    wander: Wander
    left: Turning
    right: Turning


def measure(drive: Drive, shaped: bool, turns: float = TURNS, seconds: float = WANDER_S) -> Result:
    """Run all movements on one drive; `shaped`: by shaper and servo, else by the Cartesian
    controller's streams."""
    return Result(
        wander(drive, shaped, seconds),
        turning(drive, 1.0, shaped, turns),
        turning(drive, -1.0, shaped, turns),
    )


def rows(name: str, ideal: Result, dynamic: Result) -> list[Row]:
    """Return the table for one way of driving."""
    one, two = ideal.wander, dynamic.wander
    found = [
        Row(
            f"{name}, free motion: 5 / 50 / 95 / 100 % (ms)",
            "about 500, outliers to 6000",
            quantiles_ms(one.delays_s),
            quantiles_ms(two.delays_s),
            "95 % <= 40 ms",
            float(np.nanquantile(one.delays_s, 0.95)) <= 0.04,
        ),
        Row(
            "  delay by correlation / least error",
            "",
            *both(
                lambda w: f"{w.correlation_s * 1e3:.0f} / {w.least_error_s * 1e3:.0f} ms", one, two
            ),
        ),
        Row(
            "  refused poses, stop phases",
            "often",
            *both(lambda w: f"{w.refusals}, {w.stops}", one, two),
            "0, 0",
            one.refusals == 0 and one.stops == 0,
        ),
        Row(
            "  ways over ±pi, forearm and wrist roll",
            "refused",
            *both(lambda w: f"{w.crossings[0]} and {w.crossings[1]}", one, two),
        ),
    ]
    for left, right, what in (
        (ideal.left, dynamic.left, "turns forward"),
        (ideal.right, dynamic.right, "turns backward"),
    ):
        found.append(
            Row(
                f"  {what}: turns, refused, stops, delay",
                "refused",
                *both(
                    lambda t: f"{t.turns:+.2f}, {t.refusals}, {t.stops}, {t.delay_s * 1e3:.0f} ms",
                    left,
                    right,
                ),
                f"> {left.asked - 0.5:g}, 0, 0",
                abs(left.turns) > left.asked - 0.5 and left.refusals == 0 and left.stops == 0,
            )
        )
    return found
