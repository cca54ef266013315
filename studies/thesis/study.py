"""The thesis of 2020: measurements, tables and figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from cardan.common.arm_libraries import np
from studies.result import Drawn, Figure, Result, Table, known
from studies.side_by_side import side_by_side
from studies.thesis import arbitrary, collision, eight, faults, line
from studies.thesis.bench import DRIVES, DT_S, Array, Drive, Row

QUICK_LENGTH_M = 0.05
QUICK_EIGHT_S = 5.0
QUICK_TURNS = 1.0
QUICK_WANDER_S = 4.0

SMALLEST_M = 1e-4
"""Smallest spread of distances: smaller differences are ignored."""

HOW = (
    "Virtual time at 500 Hz: the same figures in every run. The simulated arm is behind its own "
    "driver and protocol, with ideal drives (joints are where they were commanded to be one cycle "
    "before) and with its dynamics (rigid bodies, a position servo, friction, sag). The published "
    "figures are one interface on ROS with its network and camera, ours a simulation without them."
)


class Measured(NamedTuple):
    """Measurements of the thesis. In each pair the ideal drive comes first."""

    straight: list[line.Result]
    others: tuple[line.Line, line.Line, line.Line]
    courses: list[eight.Result]
    simulated_s: Array
    """Delays of the published mechanism on the eight-course."""
    hits: list[collision.Result]
    free: dict[bool, list[arbitrary.Result]]
    """Results by driving: True for the shaper, False for the Cartesian controller's streams."""
    broken: list[tuple[faults.Fault, ...]]
    """Results of the disturbed stream; empty: left out."""


class _Driven(NamedTuple):
    """Measurements on one drive."""

    straight: line.Result
    course: eight.Result
    hits: collision.Result
    free: dict[bool, arbitrary.Result]
    broken: tuple[faults.Fault, ...]


def _one(drive: Drive, quick: bool) -> _Driven:
    length_m, axes = (QUICK_LENGTH_M, 1) if quick else (0.5, 3)
    turns = QUICK_TURNS if quick else arbitrary.TURNS
    wander_s = QUICK_WANDER_S if quick else arbitrary.WANDER_S
    return _Driven(
        line.measure(drive, length_m, axes),
        eight.measure(drive, _eight_s(quick)),
        collision.measure(drive),
        {
            shaped: arbitrary.measure(drive, shaped, turns, wander_s)
            for shaped in ((False,) if quick else (False, True))
        },
        () if quick else faults.measure(drive),
    )


def _eight_s(quick: bool) -> float:
    return QUICK_EIGHT_S if quick else eight.DURATION_S + eight.TAIL_S


def measure(quick: bool = False) -> Measured:
    """Measure everything; `quick`: shorter paths, one axis, no disturbed stream, no shaper
    alone."""
    found = side_by_side(_one, [(drive, quick) for drive in DRIVES])
    return Measured(
        [each.straight for each in found],
        line.simulated(QUICK_LENGTH_M if quick else 0.5),
        [each.course for each in found],
        eight.mechanism(_eight_s(quick)),
        [each.hits for each in found],
        {shaped: [each.free[shaped] for each in found] for shaped in found[0].free},
        [] if quick else [each.broken for each in found],
    )


def tables(found: Measured) -> list[tuple[str, list[Row]]]:
    """Return the tables' titles and rows."""
    free = arbitrary.rows("Cartesian device", *found.free[False])
    if True in found.free:
        free += arbitrary.rows("shaper and servo", *found.free[True])
    made = [
        ("Straight line, UR5", line.rows(found.straight[0], found.straight[1], found.others)),
        ("Eight-course, UR5", eight.rows(found.courses[0], found.courses[1], found.simulated_s)),
        ("Collision, UR5", collision.rows(*found.hits)),
        ("Arbitrary movements, PR2's right arm", free),
    ]
    if found.broken:
        disturbed = "A disturbed stream of poses, 0.3 m in 3 s, UR5"
        made.append((disturbed, faults.rows(*found.broken)))
    return made


def run(quick: bool) -> Result:
    """Run the study."""
    found = measure(quick)

    def draw() -> Iterator[Drawn]:
        from studies.thesis import plots

        return plots.draw(*found)

    return Result(
        HOW,
        tuple(_table(title, rows) for title, rows in tables(found)),
        figures(found),
        draw,
        (f"eight-course's camera: {eight.SEED}", f"free motion: {arbitrary.SEED}"),
        _shortened() if quick else (),
    )


def _shortened() -> tuple[str, ...]:
    return (
        f"straight lines of {QUICK_LENGTH_M:g} m instead of 0.5 m, along x alone",
        f"the first {QUICK_EIGHT_S:g} s of the eight-course, of {eight.DURATION_S:g} s",
        f"{QUICK_WANDER_S:g} s of free motion instead of {arbitrary.WANDER_S:g} s, and "
        f"{QUICK_TURNS:g} turn each way instead of {arbitrary.TURNS:g}",
        "left out: arbitrary movements by the shaper alone, and the disturbed stream",
    )


def _table(title: str, rows: list[Row]) -> Table:
    verdicts = {None: "", True: "met", False: "MISSED"}
    return Table(
        title,
        ("", "published", "ours, ideal", "ours, dynamic", "aim", "on the ideal drive"),
        tuple(
            (
                _indented(row.what),
                *(str(cell) for cell in row[1:5]),
                verdicts[None if row.met is None else bool(row.met)],
            )
            for row in rows
        ),
    )


def _indented(words: str) -> str:
    return f"– {words.strip()}" if words.startswith(" ") else words


def figures(found: Measured) -> tuple[Figure, ...]:
    """Return the figures by which reports are compared."""
    made: list[Figure] = []

    def both(name: str, unit: str, values: list[float], **more: object) -> None:
        spread = 1e3 * (DT_S if unit == "ms" else SMALLEST_M) if unit else 0.0
        for drive, value in zip(DRIVES, values, strict=True):
            scaled = known(float(value) * (1e3 if unit else 1.0))
            made.append(Figure(f"{name}, {drive}", scaled, unit, spread=spread, **more))  # type: ignore[arg-type]

    for what, published in (("relative", 350.0), ("absolute", 350.0), ("predicted", 350.0)):
        lines = [getattr(one, what)[0] for one in found.straight]
        name = f"line along x, {what}"
        both(f"{name}: delay", "ms", [x.delays.least_error_s for x in lines], published=published)
        both(f"{name}: RMS error", "mm", [x.errors.rms_m for x in lines])
    for what in ("raw", "tracked"):
        courses = [getattr(one, what) for one in found.courses]
        name = f"eight-course, {what}"
        both(f"{name}: median delay", "ms", _quantiles(courses, 0.5))
        both(f"{name}: delay, 95 %", "ms", _quantiles(courses, 0.95), published=650.0)
        both(f"{name}: least clearance", "mm", [x.clearance_m for x in courses], better="more")
        both(f"{name}: stops", "", [x.stops for x in courses], published=1.0)
    stops: tuple[tuple[str, str], ...] = (
        ("poses into a wall", "poses"),
        ("twist into a wall", "twists"),
        ("twist into itself", "itself"),
        ("one pose behind a wall", "jump"),
    )
    for what, key in stops:
        hits = [getattr(one, key) for one in found.hits]
        both(f"{what}: least clearance", "mm", [x.smallest_m for x in hits], better="more")
    for shaped, results in found.free.items():
        name = "shaper alone" if shaped else "Cartesian device"
        wanders = [one.wander for one in results]
        both(f"free motion, {name}: delay, 95 %", "ms", _quantiles(wanders, 0.95), published=500.0)
        both(f"free motion, {name}: refused poses", "", [float(x.refusals) for x in wanders])
        both(f"turns, {name}: delay", "ms", [x.left.delay_s for x in results])
    return tuple(made)


def _quantiles(runs: list[eight.Course] | list[arbitrary.Wander], share: float) -> list[float]:
    quantile: Callable[..., object] = np.nanquantile
    return [float(quantile(one.delays_s, share)) for one in runs]  # type: ignore[arg-type]
