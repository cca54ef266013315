"""Each low-cost device with the one controller: the sessions of the demos, with simulated devices,
in real time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cardan.demos.demo import choose_demo, find_problems, simulated_hardware
from cardan.demos.examples import find_demos
from cardan.gateway.operator.mapping import Mode
from cardan.gateway.session.snapshot import BOUNDS_S, Snapshot
from cardan.gateway.session.supervisor import supervise
from studies.result import Figure, Table, known, spread_of


class Device(NamedTuple):
    """A device and its demo."""

    name: str
    demo: str
    published: str = ""
    """Commands and frame in the paper; empty: the paper has no such device."""


PUBLISHED = (
    Device("SpaceNavigator, SpaceMouse", "spacemouse-ur5", "velocity, base"),
    Device("Leap Motion", "leap-ur5", "position, base"),
    Device("Wii Remote", "wiimote-ur5", "velocity, tool"),
)
OTHERS = (
    Device("gamepad", "gamepad-ur5"),
    Device("keyboard", "keyboard-ur5"),
)
SERIAL = Device("serial 3Dconnexion device", "spacemouse-serial")
"""Needs the plug-in cardan-serial-mice."""

COMMANDS = {Mode.RATE: "velocity", Mode.POSITION: "position", Mode.ABSOLUTE: "absolute position"}


class Driven(NamedTuple):
    """Result of the sessions with one device."""

    device: Device
    commands: str
    """Kind of the commands, and their frame."""
    runs: tuple[Snapshot, ...]
    """Last snapshot of each run."""
    problems: tuple[str, ...]


def others() -> tuple[Device, ...]:
    """Return the installed devices that no paper has."""
    return (*OTHERS, SERIAL) if SERIAL.demo in find_demos() else OTHERS


def measure(devices: Sequence[Device], seconds: float, turns: int) -> list[Driven]:
    """Measure each device for `seconds`, or as long as its demo needs, in `turns` rounds over all
    devices."""
    found: dict[Device, Driven] = {}
    for _ in range(turns):
        for device in devices:
            demo = choose_demo(device.demo)
            length_s = max(seconds, demo.shortest_s)
            with simulated_hardware(demo, length_s) as (config, through):
                last = supervise(config, length_s, through=through).last
            mapping = config.mapping
            words = f"{COMMANDS[mapping.mode]}, {mapping.frame.value}"
            before = found.get(device, Driven(device, words, (), ()))
            problems = (*before.problems, *find_problems(last))
            found[device] = Driven(device, words, (*before.runs, last), problems)
    return list(found.values())


def age_s(last: Snapshot) -> float | None:
    """Mean age of the newest report in a control instant."""
    loop = last.loop
    return loop.input_age_sum_s / loop.inputs if loop.inputs else None


def within(last: Snapshot) -> list[tuple[float, float]]:
    """Return ages, s, and the share of control instants whose newest report was at most that
    old."""
    counts, inputs = last.loop.input_age_within, last.loop.inputs
    return [(b, n / inputs) for b, n in zip(BOUNDS_S, counts, strict=False) if inputs]


def table(found: Sequence[Driven]) -> Table:
    """Return the table, a row per device, from its last run."""
    rows = []
    for each in found:
        last, age = each.runs[-1], age_s(each.runs[-1])
        rows.append(
            (
                each.device.name,
                each.device.published or "–",
                each.commands,
                f"{1e3 * last.tracking.path_m:.0f} mm",
                f"{1e3 * last.tracking.error_rms_m:.2f} / {1e3 * last.tracking.error_max_m:.2f} mm",
                "–" if age is None else f"{1e3 * age:.1f} ms",
                f"{1e6 * last.loop.tick_p50_s:.0f} / {1e6 * last.loop.tick_p99_s:.0f} µs",
                f"{last.robot.missed_cycles} of {last.loop.cycles}",
                str(last.arm.trips),
                "; ".join(dict.fromkeys(each.problems)) or "none",
            )
        )
    columns = (
        *("device", "published: commands, frame", "ours", "way of the reference"),
        *("arm off it, RMS / most", "age of the newest report, mean", "answer, median / p99"),
        *("cycles missed", "disengaged", "problems"),
    )
    return Table(
        "Each device through the one controller, simulated UR5", columns, tuple(rows), _NOTE
    )


_NOTE = (
    "The paper's table 1 has commands and frames, and no figures. The way is what each device's "
    "scripted hand asks for. Mice are silent at rest, which makes their newest report old, and the "
    "simulated arm sags under its weight. Problems are what `cardan demo` would name."
)


def figures(found: Sequence[Driven]) -> list[Figure]:
    """Return the figures by which reports are compared: means of the runs."""
    made = []
    for each in found:
        name = each.device.name
        columns = (
            (
                "arm off its reference, RMS",
                "mm",
                [1e3 * last.tracking.error_rms_m for last in each.runs],
            ),
            ("answer, median", "µs", [1e6 * last.loop.tick_p50_s for last in each.runs]),
            ("answer, p99", "µs", [1e6 * last.loop.tick_p99_s for last in each.runs]),
            ("age of the newest report", "ms", [1e3 * (age_s(x) or 0.0) for x in each.runs]),
        )
        for what, unit, values in columns:
            spread = spread_of(values) if len(values) > 1 else None
            mean = known(sum(values) / len(values))
            made.append(Figure(f"{name}: {what}", mean, unit, "less", spread))
        trips = sum(last.arm.trips for last in each.runs)
        made.append(Figure(f"{name}: disengaged", float(trips), "", "less", 0.0))
    return made
