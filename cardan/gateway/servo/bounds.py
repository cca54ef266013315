"""Joint velocities from which every limit can still be met: bounds that are never empty."""

from __future__ import annotations

from operator import truediv

from cardan.common.braking import stopping_speed
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import FloatArray, Kinematics
from cardan.robots import JointKind


class JointBounds:
    """Lower and upper velocity of each joint for the next period.

    Speed, acceleration and position limits hold together by construction: from any velocity that
    these bounds allow, the joint can stop at its limit with its acceleration (v·dt + v²/2a = d,
    as in :func:`cardan.common.braking.stopping_speed`), and no sooner than the joint that takes
    longest to stop: all can slow down alike, on the line. A joint that is outside its range anyway
    may only move inwards. Plain floats: for six joints numpy would cost twice as much.
    """

    def __init__(self, kinematics: Kinematics, speed_share: float, acceleration_share: float):
        self.lower = kinematics.lower.tolist()
        self.upper = kinematics.upper.tolist()
        self.velocity = [speed_share * v for v in kinematics.velocity.tolist()]
        self.acceleration = [acceleration_share * a for a in kinematics.acceleration.tolist()]
        self.prismatic = [False] * len(self.lower)
        if isinstance(kinematics, ArmKinematics):
            kinds = [joint.kind for joint in kinematics.arm.joints]
            self.prismatic = [kind is JointKind.PRISMATIC for kind in kinds]
        self._joints = tuple(
            zip(self.lower, self.upper, self.velocity, self.acceleration, strict=True)
        )

    def fill(
        self,
        q: list[float],
        v: list[float],
        dt_s: float,
        lowest: FloatArray,
        highest: FloatArray,
    ) -> bool:
        """Write the bounds into the first entries of `lowest` and `highest`. Return whether the end
        of a joint's range bounds it more than speed and acceleration do."""
        ending = False
        longest_s = max(map(truediv, map(abs, v), self.acceleration))
        for index, (lower, upper, fastest, acceleration) in enumerate(self._joints):
            position, speed = q[index], v[index]
            gain = acceleration * dt_s
            slowed, sped = speed - gain, speed + gain
            top = fastest if fastest < sped else sped
            bottom = -fastest if -fastest > slowed else slowed
            room = upper - position
            if room > 0.0 and top * longest_s > 2.0 * room:
                top, ending = 2.0 * room / longest_s, True
            if room * acceleration < fastest * (fastest + gain):
                stop = stopping_speed(room, acceleration, dt_s)
                if top > stop:
                    top, ending = stop, True
            room = position - lower
            if room > 0.0 and bottom * longest_s < -2.0 * room:
                bottom, ending = -2.0 * room / longest_s, True
            if room * acceleration < fastest * (fastest + gain):
                stop = -stopping_speed(room, acceleration, dt_s)
                if bottom < stop:
                    bottom, ending = stop, True
            # Braking harder than the joint can is impossible, and no program may be infeasible.
            highest[index] = top if top > slowed else slowed
            lowest[index] = bottom if bottom < sped else sped
        return ending

    def limiting(self, lowest: FloatArray, highest: FloatArray, v: FloatArray) -> list[int]:
        """Return the joints whose velocity is at a bound."""
        return [
            index
            for index in range(len(self.velocity))
            if v[index] >= highest[index] - 1e-9 or v[index] <= lowest[index] + 1e-9
        ]
