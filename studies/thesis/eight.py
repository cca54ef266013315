"""Figure of eight: one lap around two boxes in 33 s, position only, noisy camera, on the UR5."""

from __future__ import annotations

from typing import Any, NamedTuple

from cardan.common.arm_libraries import np, npt
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import box_obstacle
from cardan.robots import load_arm
from cardan.types import Vector3
from studies.metrics import delay_by_correlation, delay_by_least_error, stop_phases
from studies.thesis.bench import (
    DT_S,
    Array,
    Bench,
    Drive,
    Row,
    Trace,
    published_mechanism,
    quantiles_ms,
    signed_delays,
)

DURATION_S = 33.0
TAIL_S = 2.0
CAMERA_HZ = 30.0
CENTER_M = np.array((0.45, 0.0, 0.30))
HALF_LENGTH_M, HALF_WIDTH_M = 0.30, 0.14
BOX_M = (0.05, 0.04, 0.295)
"""Half sizes of a box along x and y, and height of its top; the boxes stand on the base plane."""
BOX_AT_Y_M = 0.198
NOISE_M = 0.0025
"""Standard deviation of each axis of a tag's position."""
OUTLIER_SHARE = 0.01
OUTLIER_M = (0.02, 0.05)
"""Range of the size of an outlier, in any direction: a tag whose corners were misdetected in one
image."""
SEED = 2020
LONGEST_S = 2.0

RAMP = 0.03
"""Share of the duration in which the hand accelerates, and in which it decelerates."""

TRACK_1_S = 4.0
"""Natural frequency of the tracking filter."""
GATE_M = 0.015
"""Distance from the prediction beyond which a measurement is an outlier, unless the next one
agrees."""

BOXES = tuple(
    box_obstacle(
        name,
        Vector3(CENTER_M[0] - BOX_M[0], side * BOX_AT_Y_M - BOX_M[1], 0.0),
        Vector3(CENTER_M[0] + BOX_M[0], side * BOX_AT_Y_M + BOX_M[1], BOX_M[2]),
    )
    for name, side in (("left box", 1.0), ("right box", -1.0))
)


def course(times_s: Array, duration_s: float = DURATION_S) -> Array:
    """True position of the hand (time × 3), starting and ending at rest in the middle."""
    share = np.clip(times_s / duration_s, 0.0, 1.0)
    ramp = RAMP
    # Constant speed between two smooth ends.
    eased = np.where(
        share < ramp,
        share**2 / (2.0 * ramp),
        np.where(
            share > 1.0 - ramp,
            1.0 - ramp - (1.0 - share) ** 2 / (2.0 * ramp),
            share - 0.5 * ramp,
        ),
    )
    angle = 2.0 * np.pi * eased / (1.0 - ramp)
    return CENTER_M + np.stack(
        (HALF_WIDTH_M * np.sin(2.0 * angle), HALF_LENGTH_M * np.sin(angle), 0.0 * angle), axis=1
    )


def camera(times_s: Array) -> Array:
    """Return the camera's measurements at its times: the path with noise and rare outliers."""
    generator = np.random.default_rng(SEED)
    seen = course(times_s) + generator.normal(0.0, NOISE_M, (len(times_s), 3))
    wrong = np.flatnonzero(generator.random(len(times_s)) < OUTLIER_SHARE)
    for index in wrong:
        direction = generator.normal(size=3)
        length = generator.uniform(*OUTLIER_M)
        seen[index] += length * direction / np.linalg.norm(direction)
    return seen


class Tracker:
    """Filter on the operator's side: position and velocity, critically damped, with a gate; its
    output is the hand's predicted position one image later.

    It is not a part of Cardan, but represents the tag tracking that sends the poses.
    """

    def __init__(self, start: Array, period_s: float) -> None:
        self.position, self.velocity = start.copy(), np.zeros_like(start)
        self._period_s = period_s
        keep = float(np.exp(-TRACK_1_S * period_s))
        self._alpha, self._beta = 1.0 - keep**2, (1.0 - keep) ** 2
        self._suspect: Array | None = None

    def take(self, seen: Array) -> Array:
        """Process the position of an image; return the position to send."""
        self.position = self.position + self.velocity * self._period_s
        off = seen - self.position
        if np.linalg.norm(off) > GATE_M and (
            self._suspect is None or np.linalg.norm(seen - self._suspect) > GATE_M
        ):
            self._suspect = seen
            return self.ahead
        self._suspect = None
        self.position = self.position + self._alpha * off
        self.velocity = self.velocity + self._beta / self._period_s * off
        return self.ahead

    @property
    def ahead(self) -> Array:
        """Predicted position of the hand when the next image comes."""
        predicted: Array = self.position + self.velocity * self._period_s
        return predicted


class Course(NamedTuple):
    """Result of one run of the course."""

    name: str
    trace: Trace
    sent_s: Array
    sent_m: Array
    """Streamed positions."""
    delays_s: Array
    """Per image: time until the output is nearest to the hand's position at that image."""
    correlation_s: float
    least_error_s: float
    rms_m: float
    """RMS distance between the hand's path and the output after removal of the mean delay."""
    stops: int
    stopped_s: float
    refusals: int
    clearance_m: float


def run(drive: Drive, tracked: bool, seconds: float) -> Course:
    """Run the path's first `seconds` with streamed poses; `tracked`: through the tracker."""
    arm = ArmKinematics(load_arm("ur5"))
    home = np.array(arm.arm.home)
    rotation = arm.forward(home).rotation
    goal = arm.placement.copy()
    goal.translation, goal.rotation = CENTER_M, rotation
    start = arm.inverse(goal, home)
    assert start is not None
    bench = Bench("ur5", drive, start.tolist(), BOXES)
    driving = bench.streams("pose", timeout_s=0.2)
    images_s = np.arange(0.0, seconds - 1e-9, 1.0 / CAMERA_HZ)
    seen = camera(np.arange(0.0, DURATION_S + TAIL_S, 1.0 / CAMERA_HZ))[: len(images_s)]
    tracker = Tracker(CENTER_M, 1.0 / CAMERA_HZ)
    sent = np.array([tracker.take(image) for image in seen]) if tracked else seen
    turn = bench.placement(driving).rotation.copy()
    offset = bench.placement(driving).translation - CENTER_M
    upcoming = iter(zip(images_s, sent, strict=True))
    waiting: list[Any] = [next(upcoming)]

    def operator(now_s: float) -> None:
        while waiting and now_s >= waiting[0][0] - 1e-9:
            driving.pose(waiting[0][1] + offset, turn)
            waiting[:] = [following] if (following := next(upcoming, None)) else []

    trace = bench.run(driving, seconds, operator)
    name = "tracked poses" if tracked else "raw poses"
    sag = trace.measured_m[0] - trace.commanded_m[0] + offset
    return _evaluated(name, trace, trace.measured_m - sag, images_s, sent, len(driving.refusals))


def _moving(images_s: Array, end_s: float) -> npt.NDArray[np.bool_]:
    """Select the images in which the hand has full speed: at rest no delay can be measured."""
    ramp_s = RAMP * DURATION_S
    return (images_s > ramp_s) & (images_s < min(DURATION_S - ramp_s, end_s - LONGEST_S))


def _evaluated(
    name: str, trace: Trace, output: Array, images_s: Array, sent: Array, refusals: int
) -> Course:
    true = course(trace.times_s)
    moving = _moving(images_s, trace.times_s[-1])
    delays = signed_delays(
        images_s[moving], course(images_s[moving]), trace.times_s, output, LONGEST_S
    )
    least_s = delay_by_least_error(DT_S, true, output, LONGEST_S)
    shift = round(least_s / DT_S)
    errors = np.linalg.norm(true[: len(true) - shift] - output[shift:], axis=1)
    stops = stop_phases(trace.times_s, true, output)
    return Course(
        name,
        trace,
        images_s,
        sent,
        delays,
        delay_by_correlation(DT_S, true, output, LONGEST_S),
        least_s,
        float(np.sqrt((errors**2).mean())),
        stops.count,
        stops.total_s,
        refusals,
        float(trace.obstacle_m.min()),
    )


def mechanism(seconds: float) -> Array:
    """Delays of the published mechanism, simulated on the raw images without obstacles, s."""
    times_s = np.arange(0.0, seconds, DT_S)
    images_s = np.arange(0.0, seconds - 1e-9, 1.0 / CAMERA_HZ)
    seen = camera(np.arange(0.0, DURATION_S + TAIL_S, 1.0 / CAMERA_HZ))[: len(images_s)]
    output = published_mechanism(images_s, seen, times_s)
    moving = _moving(images_s, seconds)
    return signed_delays(images_s[moving], course(images_s[moving]), times_s, output, LONGEST_S)


class Result(NamedTuple):
    """Results for one drive."""

    raw: Course
    tracked: Course


def measure(drive: Drive, seconds: float = DURATION_S + TAIL_S) -> Result:
    """Run the path with the raw and with the tracked poses on one drive."""
    return Result(run(drive, False, seconds), run(drive, True, seconds))


def rows(ideal: Result, dynamic: Result, published_s: Array) -> list[Row]:
    """Return the table; `published_s`: delays from :func:`mechanism`."""
    found = []
    for one, two in zip(ideal, dynamic, strict=True):
        mostly = float(np.nanquantile(one.delays_s, 0.95))
        found += [
            Row(
                f"{one.name}: 5 / 50 / 95 / 100 % (ms)",
                "95 % in 370 to 650, one 1700",
                quantiles_ms(one.delays_s),
                quantiles_ms(two.delays_s),
                "95 % <= 40 ms",
                mostly <= 0.04,
            ),
            Row(
                "  delay by correlation / least error",
                "peak at 550 ms",
                f"{one.correlation_s * 1e3:.0f} / {one.least_error_s * 1e3:.0f} ms",
                f"{two.correlation_s * 1e3:.0f} / {two.least_error_s * 1e3:.0f} ms",
            ),
            Row(
                "  off the hand's way, without delay, RMS",
                "",
                f"{one.rms_m * 1e3:.1f} mm",
                f"{two.rms_m * 1e3:.1f} mm",
            ),
            Row(
                "  stop phases, refused poses",
                "1 stop",
                f"{one.stops}, {one.refusals}",
                f"{two.stops}, {two.refusals}",
                "0",
                one.stops == 0 and one.refusals == 0,
            ),
            Row(
                "  smallest clearance to a box",
                "no contact",
                f"{one.clearance_m * 1e3:.1f} mm",
                f"{two.clearance_m * 1e3:.1f} mm",
                "> 0",
                one.clearance_m > 0.0,
            ),
        ]
    found.append(
        Row(
            "published mechanism, simulated (ms)", "", quantiles_ms(published_s), "no arm, no boxes"
        )
    )
    return found
