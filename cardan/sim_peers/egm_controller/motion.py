"""Motion of the simulated arm: EGM's control law, and servos with limits.

Source of the law: ABB Application manual, Externally Guided Motion (3HAC073318-001), "Execution
modes" and system parameters: speed = k·(pos_ref - pos) + speed_ref, then a low-pass filter.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Sequence

from cardan.sim_peers.kinematics import AXES, Frames, SixAxisArm, forward

_NOISE_SAMPLES = 1021
"""A prime number, to keep the repetition of the encoder noise apart from other periods."""


class ControlLaw:
    """speed = gain·error + feed_forward through a one-pole low-pass, a = 1 - exp(-2π·f·Ts)."""

    def __init__(self, gain_per_s: float, filter_hz: float | None, period_s: float) -> None:
        self._gain = gain_per_s
        self._share = (
            1.0 if filter_hz is None else 1.0 - math.exp(-2.0 * math.pi * filter_hz * period_s)
        )
        self._speed = [0.0] * AXES

    def speeds(self, error: Sequence[float], feed_forward: Sequence[float]) -> list[float]:
        """Return the filtered speed for this cycle; call once a cycle."""
        gain, share = self._gain, self._share
        self._speed = [
            v + share * (gain * e + f - v)
            for v, e, f in zip(self._speed, error, feed_forward, strict=True)
        ]
        return self._speed


class ServoAxes:
    """Six speed-controlled axes that keep their limits and follow some ms later.

    `planned` is the controller's reference, `measured` the arm's position, `delay_s` behind. Every
    limit scales all axes by the same ratio, which keeps the direction.
    """

    def __init__(
        self,
        arm: SixAxisArm,
        period_s: float,
        delay_s: float,
        start: Sequence[float],
        noise_rad: float = 0.0,
        seed: int = 0,
    ) -> None:
        self.arm = arm
        self.period_s = period_s
        self.planned = list(start)
        self.speeds = [0.0] * AXES
        """Speeds of `planned`, rad/s."""
        self.accelerations = [0.0] * AXES
        """Accelerations of `planned`, rad/s²."""
        self.utilization = 0.0
        """Demanded over possible joint speed of the last cycle; above 1 it was shortened."""
        whole = math.floor(delay_s / period_s)
        self._fraction = delay_s / period_s - whole
        self._history: deque[list[float]] = deque(maxlen=whole + 2)
        normal = random.Random(seed).gauss
        self._noise = [
            [normal(0.0, 1.0) * noise_rad for _ in range(AXES)] for _ in range(_NOISE_SAMPLES)
        ]
        self._tick = 0
        self._frames: tuple[list[float], Frames] | None = None
        self.place(start)

    def place(self, joints: Sequence[float]) -> None:
        """Place the arm at `joints` (it was jogged while it was not simulated)."""
        self.planned = list(joints)
        self.speeds = [0.0] * AXES
        self.accelerations = [0.0] * AXES
        self._demanded = self.speeds
        self._history.clear()
        self._history.extend([list(joints)] * (self._history.maxlen or 0))

    @property
    def at_rest(self) -> bool:
        """True when the reference stands still."""
        return not any(self.speeds)

    @property
    def planned_frames(self) -> Frames:
        """TCP pose and joint axes at `planned`."""
        if self._frames is None or self._frames[0] is not self.planned:
            self._frames = (self.planned, forward(self.planned, self.arm.links))
        return self._frames[1]

    @property
    def actual(self) -> list[float]:
        """True joints of the arm, rad."""
        if not self._fraction:
            return self._history[1]
        older, newer, f = self._history[0], self._history[1], self._fraction
        return [b + f * (a - b) for a, b in zip(older, newer, strict=True)]

    @property
    def actual_speeds(self) -> list[float]:
        """True joint speeds of the arm, rad/s."""
        older, newer, period_s = self._history[0], self._history[1], self.period_s
        return [(b - a) / period_s for a, b in zip(older, newer, strict=True)]

    @property
    def measured(self) -> list[float]:
        """Joints by the encoders, rad: `actual` with noise, new every cycle."""
        noise = self._noise[self._tick % _NOISE_SAMPLES]
        return [q + n for q, n in zip(self.actual, noise, strict=True)]

    def drive(self, speeds: Sequence[float], cap_rad_s: float = math.inf) -> None:
        """Move for one cycle at `speeds` (rad/s) as far as `cap_rad_s` and the limits allow."""
        arm, period = self.arm, self.period_s
        fastest = max(map(abs, speeds))
        self.utilization = max([abs(v) / top for v, top in zip(speeds, arm.velocity, strict=True)])
        shrink = min(1.0, cap_rad_s / fastest) if fastest else 1.0
        self._demanded = [v * shrink for v in speeds]
        shrink = min(shrink, 1.0 / self.utilization) if self.utilization else shrink
        changes = [v * shrink - now for v, now in zip(speeds, self.speeds, strict=True)]
        excess = (
            max([abs(dv) / top for dv, top in zip(changes, arm.acceleration, strict=True)]) / period
        )
        if excess > 1.0:
            changes = [dv / excess for dv in changes]
            self.speeds = [v + dv for v, dv in zip(self.speeds, changes, strict=True)]
        else:
            self.speeds = [v * shrink for v in speeds]
        self.accelerations = [dv / period for dv in changes]
        self.planned = [q + v * period for q, v in zip(self.planned, self.speeds, strict=True)]
        self._history.append(self.planned)
        self._tick += 1

    def demanded_acceleration(self, speeds: Sequence[float], cap_rad_s: float) -> float:
        """Return the jump from the last demand to this one, in multiples of joint accelerations."""
        fastest = max(map(abs, speeds))
        shrink = min(1.0, cap_rad_s / fastest) if fastest else 1.0
        return (
            max(
                [
                    abs(v * shrink - before) / top
                    for v, before, top in zip(
                        speeds, self._demanded, self.arm.acceleration, strict=True
                    )
                ]
            )
            / self.period_s
        )

    def out_of_range(self) -> int | None:
        """Index of a planned joint outside its range, if any."""
        for axis, (q, low, high) in enumerate(
            zip(self.planned, self.arm.lower, self.arm.upper, strict=True)
        ):
            if not low <= q <= high:
                return axis
        return None


class RampDown:
    """Bring the speed to zero linearly within `ramp_s`; 0 is as fast as the axes can."""

    def __init__(self, servo: ServoAxes, ramp_s: float) -> None:
        self._servo = servo
        self._from = list(servo.speeds)
        self._ramp_s = ramp_s
        self._elapsed_s = 0.0

    def tick(self) -> bool:
        """Move for one cycle; True when the arm stands."""
        self._elapsed_s += self._servo.period_s
        share = 1.0 - self._elapsed_s / self._ramp_s if self._ramp_s > 0.0 else 0.0
        share = max(0.0, share)
        self._servo.drive([share * v for v in self._from])
        return share == 0.0 and self._servo.at_rest


class JointMove:
    """Programmed joint movement to `target`, at rest at both ends."""

    _SPEED_SHARE = 0.5
    """Share of the joint speeds and accelerations: a programmed move uses less than the arm can."""

    def __init__(self, servo: ServoAxes, target: Sequence[float], at_least_s: float = 0.0) -> None:
        self._servo = servo
        self._target = list(target)
        self._start = list(servo.planned)
        way = [abs(b - a) for a, b in zip(self._start, self._target, strict=True)]
        # The cubic s = 3u²-2u³ peaks at 1.5 times the mean speed and 6·way/T² in acceleration.
        self.duration_s = max(
            at_least_s,
            *(
                1.5 * d / (self._SPEED_SHARE * v)
                for d, v in zip(way, servo.arm.velocity, strict=True)
            ),
            *(
                math.sqrt(6.0 * d / (self._SPEED_SHARE * a))
                for d, a in zip(way, servo.arm.acceleration, strict=True)
            ),
        )
        self._elapsed_s = 0.0

    def tick(self) -> bool:
        """Move for one cycle; True when the arm stands at the target."""
        servo = self._servo
        self._elapsed_s += servo.period_s
        u = min(1.0, self._elapsed_s / self.duration_s) if self.duration_s > 0.0 else 1.0
        s = u * u * (3.0 - 2.0 * u)
        servo.drive(
            [
                (a + s * (b - a) - q) / servo.period_s
                for a, b, q in zip(self._start, self._target, servo.planned, strict=True)
            ]
        )
        if u < 1.0:
            return False
        if max(abs(b - q) for b, q in zip(self._target, servo.planned, strict=True)) > 1e-9:
            return False
        servo.speeds = [0.0] * AXES
        return True
