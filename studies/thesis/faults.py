"""Transmission faults of a stream of poses: silence, clocks, NaN, order, bursts (UR5)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from cardan.common.arm_libraries import np
from studies.metrics import stop_phases
from studies.thesis.bench import DT_S, Bench, Drive, Row, Streams, Trace, both
from studies.thesis.line import START_DEG

SPEED_M_S = 0.1
RATE_HZ = 50.0
LENGTH_M = 0.3
AT_S = 1.0
"""Start time of the fault."""
HOUR_S = 3600.0


class Packet(NamedTuple):
    """A streamed command with its time of arrival."""

    arrives_s: float
    way_m: float
    sequence: int | None = None
    stamp_s: float | None = None


class Fault(NamedTuple):
    """Result of the line under a fault."""

    name: str
    reached_m: float
    refused: int
    back_m: float
    """Largest motion backwards along the line."""
    stops: int
    acceleration_m_s2: float
    """Largest commanded acceleration of the TCP."""
    stop_s: float
    """Time from the last accepted command until the TCP rested, if it stopped; else NaN."""
    run_on_m: float
    """Distance covered in that time."""
    message: str
    trace: Trace


def _packets() -> list[Packet]:
    """Return the commands of the line, and its end for another 0.5 s."""
    times = np.arange(0.0, LENGTH_M / SPEED_M_S + 0.5, 1.0 / RATE_HZ)
    return [
        Packet(float(t), min(LENGTH_M, float(SPEED_M_S * t)), sequence=i)
        for i, t in enumerate(times)
    ]


def _line(
    name: str,
    drive: Drive,
    packets: list[Packet],
    timeout_s: float = 0.1,
    silent_s: float = math.nan,
) -> Fault:
    """Send `packets`; `silent_s`: start of a silence, for the analysis of the stop."""
    bench = Bench("ur5", drive, np.radians(START_DEG))
    driving: Streams = bench.streams("pose", timeout_s=timeout_s)
    start = bench.placement(driving)
    queue = sorted(packets, key=lambda packet: packet.arrives_s)
    taken: list[float] = [0.0]
    messages: list[str] = []

    def operator(now_s: float) -> None:
        while queue and queue[0].arrives_s <= now_s + 1e-9:
            packet = queue.pop(0)
            how = {
                key: value
                for key, value in (("sequence", packet.sequence), ("stamp_s", packet.stamp_s))
                if value is not None
            }
            goal = start.translation + np.array((packet.way_m, 0.0, 0.0))
            if not driving.pose(goal, start.rotation, **how):
                taken.append(now_s)
        message = driving.verbs.status().message
        if message and message not in messages:
            messages.append(message)

    trace = bench.run(driving, LENGTH_M / SPEED_M_S + 1.0, operator)
    way = trace.measured_m[:, 0] - trace.measured_m[0, 0]
    commanded = trace.commanded_m - trace.commanded_m[0]
    speed = np.gradient(commanded, DT_S, axis=0)
    program = np.zeros((len(way), 3))
    program[:, 0] = np.clip(SPEED_M_S * trace.times_s, 0.0, LENGTH_M)
    stops = stop_phases(trace.times_s, program, commanded)
    stop_s = run_on_m = math.nan
    last_s = taken[-1] if messages else silent_s
    if last_s == last_s:
        still = (trace.times_s > last_s) & (np.linalg.norm(speed, axis=1) < 1e-4)
        if still.any():
            rest = int(np.argmax(still))
            stop_s = float(trace.times_s[rest] - last_s)
            run_on_m = float(way[rest] - way[int(np.searchsorted(trace.times_s, last_s))])
    return Fault(
        name,
        float(way[-1]),
        len(driving.refusals),
        float(max(0.0, (np.maximum.accumulate(way) - way).max())),
        stops.count,
        float(np.linalg.norm(np.gradient(speed, DT_S, axis=0), axis=1).max()),
        stop_s,
        run_on_m,
        messages[0] if messages else "",
        trace,
    )


def silence(drive: Drive, gap_s: float) -> Fault:
    """Gap: nothing arrives for `gap_s`."""
    packets = [p for p in _packets() if not AT_S < p.arrives_s < AT_S + gap_s - 1e-9]
    return _line(f"{gap_s * 1e3:.0f} ms of silence", drive, packets, silent_s=AT_S)


def clock_jump(drive: Drive, jump_s: float, stamped: bool) -> Fault:
    """Jump of the sender's clock in the middle; `stamped`: packets have stamps, else numbers."""
    packets = [
        Packet(p.arrives_s, p.way_m, None, p.arrives_s + (jump_s if p.arrives_s > AT_S else 0.0))
        if stamped
        else p
        for p in _packets()
    ]
    kind = "stamps" if stamped else "numbers"
    return _line(f"clock {jump_s / HOUR_S:+.0f} h, by {kind}", drive, packets)


def not_a_number(drive: Drive) -> Fault:
    """NaN in every tenth pose."""
    packets = [p._replace(way_m=math.nan) if i % 10 == 5 else p for i, p in enumerate(_packets())]
    return _line("every 10th pose NaN", drive, packets)


def reordering(drive: Drive) -> Fault:
    """Reordering: the next two poses overtake every fifth one."""
    packets = [
        p._replace(arrives_s=p.arrives_s + 2.5 / RATE_HZ) if i % 5 == 2 else p
        for i, p in enumerate(_packets())
    ]
    return _line("every 5th pose 50 ms late", drive, packets)


def bursts(drive: Drive, timeout_s: float) -> Fault:
    """Bursts: poses arrive together, every 150 ms."""
    burst_s = 0.15
    packets = [
        p._replace(arrives_s=math.ceil(p.arrives_s / burst_s - 1e-9) * burst_s) for p in _packets()
    ]
    return _line(f"150 ms bursts, timeout {timeout_s * 1e3:.0f} ms", drive, packets, timeout_s)


def measure(drive: Drive) -> tuple[Fault, ...]:
    """Run all faults on one drive."""
    return (
        silence(drive, 0.1),
        clock_jump(drive, HOUR_S, stamped=False),
        clock_jump(drive, HOUR_S, stamped=True),
        clock_jump(drive, -HOUR_S, stamped=True),
        not_a_number(drive),
        reordering(drive),
        bursts(drive, 0.1),
        bursts(drive, 0.2),
    )


def _no_aim(_: Fault) -> bool:
    return True


def rows(ideal: tuple[Fault, ...], dynamic: tuple[Fault, ...]) -> list[Row]:
    """Return the table."""

    def text(fault: Fault) -> str:
        said = f"{fault.reached_m * 1e3:.0f} mm, {fault.refused} refused, {fault.stops} stops"
        if fault.run_on_m > 1e-4:
            said += f", at rest after {fault.stop_s * 1e3:.0f} ms and {fault.run_on_m * 1e3:.1f} mm"
        return said

    aims: dict[str, tuple[str, Callable[[Fault], bool]]] = {
        "100 ms of silence": ("rests, then continues", lambda f: f.reached_m > 0.299),
        "clock +1 h, by numbers": ("no effect", lambda f: f.reached_m > 0.299 and not f.refused),
        "clock +1 h, by stamps": ("no effect", lambda f: f.reached_m > 0.299),
        "clock -1 h, by stamps": ("no effect", lambda f: f.reached_m > 0.299),
        "every 10th pose NaN": (
            "refused, no effect",
            lambda f: f.reached_m > 0.299 and not f.stops,
        ),
        "every 5th pose 50 ms late": ("never back", lambda f: f.back_m < 1e-4 and not f.stops),
    }
    found = []
    for one, two in zip(ideal, dynamic, strict=True):
        aim, met = aims.get(one.name, ("", _no_aim))
        verdict = met(one) if aim else None
        found.append(Row(one.name, "", text(one), text(two), aim, verdict))
    hardest = both(lambda run: f"{max(f.acceleration_m_s2 for f in run):.2f} m/s²", ideal, dynamic)
    steady = max(f.acceleration_m_s2 for f in ideal) <= 5.0 * 1.01
    found.append(Row("largest acceleration of all", "", *hardest, "5 m/s² (+1 %)", steady))
    return found
