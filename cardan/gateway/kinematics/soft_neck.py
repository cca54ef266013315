"""Kinematics of a soft neck: a platform on a flexible link that three tendons bend.

Constant curvature: the link bends into an arc of its own length, and the platform stands square on
its end. Three tendon positions correspond to an inclination (two numbers) and a co-contraction (the
pull of all three beyond the arc's geometry), so each triple has one shape. This is the corrected
model of TEO's neck; the public source (SoftNeckControl of the group's humasoft-yarp-devices) has
sin² where cos² is meant, and its platform matrix is no rotation.

Inclination is a vector: its length is the angle in rad, its direction the azimuth in the base
towards which the platform leans. No formula divides by its length, so straight up is no special
case.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, ClassVar, NamedTuple

from cardan.common import bounds
from cardan.common.arm_libraries import np, npt, pin
from cardan.common.options import Options, require
from cardan.common.places import in_file
from cardan.common.tables import read_table, read_toml
from cardan.errors import about
from cardan.gateway.kinematics.base import SE3, FloatArray
from cardan.robots import TIME_TO_FULL_SPEED_S, SixWeights

_FOLDER = Path(str(resources.files("cardan").joinpath("robots")))

SOFT_NECKS = ("teo_soft_neck",)
"""Names of the soft necks in `cardan/robots`."""

FOLD_SHARE = 0.75
"""Share of the inclination at which the anchors on the inside of the bend meet. There the map from
tendons to shapes folds; up to this share it is one to one."""

ROTATION_Z_TOLERANCE_RAD = 1e-6
"""Largest rotation about z in a target: a neck cannot turn about z."""

_SERIES_BELOW_RAD2 = 1e-3
"""Squared inclination below which series are exact to the last digits and quotients are not."""

_MAX_ITERATIONS = 30
_STEP_TOLERANCE_RAD = 1e-12


_Length = Annotated[float, bounds.LENGTH_M]
_Speed = Annotated[float, bounds.LINEAR_SPEED_M_S]


@dataclass(frozen=True, kw_only=True)
class Tendon(Options):
    """``[[tendon]]``: a tendon of the neck."""

    name: str
    azimuth_deg: bounds.Angle
    """Azimuths of its anchors on both circles, from x towards y."""


@dataclass(frozen=True, kw_only=True)
class TendonLimits(Options):
    """``[limits]`` of every tendon; positive travel is shortened."""

    travel_m: _Length
    speed_m_s: _Speed
    reference_speed_m_s: _Speed
    reference_acceleration_m_s2: Annotated[float, bounds.LINEAR_ACCELERATION_M_S2]


@dataclass(frozen=True, kw_only=True)
class SoftNeckData(Options):
    """A soft neck's file."""

    base_anchor_radius_m: _Length
    platform_anchor_radius_m: _Length
    link_length_m: _Length
    tendon_offset_m: Annotated[float, bounds.NEAR_M]
    """Position of every tendon with the link straight and no co-contraction."""
    winch_radius_m: _Length
    tendon: tuple[Tendon, Tendon, Tendon]
    limits: TendonLimits

    def __post_init__(self) -> None:
        super().__post_init__()
        a, b, c = azimuths = [tendon.azimuth_deg for tendon in self.tendon]
        turns = (math.radians(angle) for angle in (b - a, c - b, a - c))
        spread = abs(sum(map(math.sin, turns))) >= 0.1
        require(spread, "tendon", azimuths, "azimuths that are spread around the circle")
        names = [tendon.name for tendon in self.tendon]
        require(len({*names}) == 3, "tendon", names, "names that differ")


def load_soft_neck(name_or_file: str = "teo_soft_neck") -> SoftNeckData:
    """A soft neck of `cardan/robots` by name, or one from the path of a ``.toml`` file.

    Raises ConfigurationError that names the file, its fault, and the allowed values.
    """
    own = not name_or_file.endswith(".toml")
    path = _FOLDER / f"{name_or_file}.toml" if own else Path(name_or_file)
    table = read_toml(path)
    with about(path), in_file(path):
        return read_table(SoftNeckData, table)


class Shape(NamedTuple):
    """Bend of the neck."""

    inclination_rad: float
    orientation_rad: float
    """Azimuth of the lean, -pi to pi; 0 without a lean."""
    co_contraction_m: float


class _Arc(NamedTuple):
    """Functions of the inclination t that are smooth in t²."""

    s: float
    """sin(t)/t"""
    c: float
    """(1 - cos(t))/t²"""
    ds: float
    """(ds/dt)/t"""
    dc: float
    """(dc/dt)/t"""
    e: float
    """(1 - s)/t²"""


def _arc(squared: float) -> _Arc:
    t2 = squared
    if t2 < _SERIES_BELOW_RAD2:
        return _Arc(
            1.0 - t2 / 6.0 * (1.0 - t2 / 20.0 * (1.0 - t2 / 42.0)),
            0.5 - t2 / 24.0 * (1.0 - t2 / 30.0 * (1.0 - t2 / 56.0)),
            -1.0 / 3.0 + t2 / 30.0 * (1.0 - t2 / 28.0),
            -1.0 / 12.0 + t2 / 180.0 * (1.0 - t2 / 37.333333333333336),
            1.0 / 6.0 - t2 / 120.0 * (1.0 - t2 / 42.0 * (1.0 - t2 / 72.0)),
        )
    t = math.sqrt(t2)
    s = math.sin(t) / t
    half = math.sin(0.5 * t) / t
    c = 2.0 * half * half
    return _Arc(s, c, (math.cos(t) - s) / t2, (s - 2.0 * c) / t2, (1.0 - s) / t2)


class SoftNeck:
    """Kinematics of one soft neck, in the interface of an arm for the servo; the TCP is the
    platform's center. Three joints, the tendons in m, but two degrees of freedom: position and
    inclination of the platform depend on each other, and it never turns about its own axis."""

    TASK: ClassVar[SixWeights] = (0.0, 0.0, 0.0, 1.0, 1.0, 0.0)
    """Task that it can follow: the lean of the platform; all else depends on it."""

    def __init__(self, data: SoftNeckData | None = None) -> None:
        """Make the model of TEO's neck by default."""
        data = load_soft_neck() if data is None else data
        self.data = data
        self.joints = 3
        self.names = tuple(tendon.name for tendon in data.tendon)
        limits = data.limits
        self.lower: FloatArray = np.full(3, -limits.travel_m)
        self.upper: FloatArray = np.full(3, limits.travel_m)
        self.velocity: FloatArray = np.full(3, limits.speed_m_s)
        # The published acceleration is the reference of the drives' own position moves: with it a
        # tendon at full speed would need three seconds to stop.
        self.acceleration: FloatArray = np.full(3, limits.speed_m_s / TIME_TO_FULL_SPEED_S)
        self.continuous: npt.NDArray[np.bool_] = np.zeros(3, dtype=np.bool_)
        base, platform = data.base_anchor_radius_m, data.platform_anchor_radius_m
        self.inclination_limit_rad = min(
            FOLD_SHARE * 2.0 * data.link_length_m / (base + platform), math.pi
        )
        """Largest inclination for which the model is used, whatever the tendons' travel."""
        angles = [math.radians(tendon.azimuth_deg) for tendon in data.tendon]
        # Anchors: x and y on the platform, and those less the base's.
        self._anchors = [
            (
                platform * math.cos(angle),
                platform * math.sin(angle),
                (platform - base) * math.cos(angle),
                (platform - base) * math.sin(angle),
            )
            for angle in angles
        ]
        self._rotation: FloatArray = np.eye(3)
        self._translation: FloatArray = np.zeros(3)
        self._per_inclination: FloatArray = np.zeros((6, 2))
        self._per_tendon: FloatArray = np.zeros((2, 3))
        self.placement: SE3 = pin.SE3.Identity()
        """Platform in the base at the last `update`."""
        self.jacobian: FloatArray = np.zeros((6, 3))
        """Twist of the platform along its own axes, linear part first, a column a tendon."""
        self.update(np.full(3, data.tendon_offset_m))

    def update(self, q: FloatArray) -> None:
        """Set `placement` and `jacobian` for the tendon positions `q` (3), m.

        Tendons that ask for more than `inclination_limit_rad` count as at that limit.
        """
        x, y, _ = self._bend(q)
        arc = _arc(x * x + y * y)
        self._place(x, y, arc)
        self.placement.rotation = self._rotation
        self.placement.translation = self._translation
        length, twist = self.data.link_length_m, self._per_inclination
        bend, rise = length * arc.dc, length * arc.ds
        twist[0, 0] = length * arc.c + bend * x * x
        twist[1, 0] = twist[0, 1] = bend * x * y
        twist[1, 1] = length * arc.c + bend * y * y
        twist[2, 0], twist[2, 1] = rise * x, rise * y
        twist[:3] = self._rotation.T.dot(twist[:3])
        # Right Jacobian of SO(3) times the derivative of the rotation vector (-y, x, 0).
        twist[3, 0], twist[3, 1] = -arc.e * x * y, arc.e * x * x - 1.0
        twist[4, 0], twist[4, 1] = 1.0 - arc.e * y * y, arc.e * x * y
        twist[5, 0], twist[5, 1] = arc.c * y, -arc.c * x
        lengths = self._lengths(x, y, arc)
        mx = (lengths[0][1] + lengths[1][1] + lengths[2][1]) / 3.0
        my = (lengths[0][2] + lengths[1][2] + lengths[2][2]) / 3.0
        xx = xy = yy = 0.0
        for _, gx, gy in lengths:
            xx += (mx - gx) ** 2
            xy += (mx - gx) * (my - gy)
            yy += (my - gy) ** 2
        scale = 1.0 / (xx * yy - xy * xy)
        for k, (_, gx, gy) in enumerate(lengths):
            self._per_tendon[0, k] = scale * (yy * (mx - gx) - xy * (my - gy))
            self._per_tendon[1, k] = scale * (xx * (my - gy) - xy * (mx - gx))
        np.dot(twist, self._per_tendon, out=self.jacobian)

    def forward(self, q: FloatArray) -> SE3:
        """Return the platform in the base for `q`, without changing `placement` and `jacobian`."""
        x, y, _ = self._bend(q)
        self._place(x, y, _arc(x * x + y * y))
        return pin.SE3(self._rotation, self._translation)

    def inverse(self, placement: SE3, near: FloatArray) -> FloatArray | None:
        """Return tendon positions inside the limits that incline the platform as `placement` does.
        Its position follows from the inclination, so the position of `placement` is ignored. The
        co-contraction is the nearest to that of `near` that the limits allow. None for a rotation
        about z, beyond `inclination_limit_rad`, or out of the tendons' travel."""
        rx, ry, rz = pin.log3(placement.rotation).tolist()
        if not abs(rz) <= ROTATION_Z_TOLERANCE_RAD:
            return None
        if not math.hypot(rx, ry) <= self.inclination_limit_rad:
            return None
        arc_only = self._tendons(ry, -rx)
        low = float(np.max(self.lower - arc_only))
        high = float(np.min(self.upper - arc_only))
        if low > high:
            return None
        q = arc_only + min(max(self._bend(near)[2], low), high)
        return np.minimum(np.maximum(q, self.lower), self.upper)

    def tendons(
        self, inclination_rad: float, orientation_rad: float, co_contraction_m: float = 0.0
    ) -> FloatArray:
        """Return the tendon positions (3), m, of a shape; not checked against the tendons' travel.

        Raises ValueError for an inclination that is negative or beyond `inclination_limit_rad`.
        """
        if not 0.0 <= inclination_rad <= self.inclination_limit_rad:
            raise ValueError(
                f"inclination {inclination_rad:g} rad is outside 0 to "
                f"{self.inclination_limit_rad:g}"
            )
        return co_contraction_m + self._tendons(
            inclination_rad * math.cos(orientation_rad), inclination_rad * math.sin(orientation_rad)
        )

    def relaxed(self, q: FloatArray) -> FloatArray:
        """Return the same shape without co-contraction: the tendons' rest positions, m."""
        return q - self.shape(q).co_contraction_m

    def shape(self, q: FloatArray) -> Shape:
        """Return the bend of the neck for the tendon positions `q` (3), m."""
        x, y, co_contraction_m = self._bend(q)
        return Shape(math.hypot(x, y), math.atan2(y, x), co_contraction_m)

    def _tendons(self, x: float, y: float) -> FloatArray:
        straight = self.data.link_length_m + self.data.tendon_offset_m
        lengths = self._lengths(x, y, _arc(x * x + y * y))
        return np.array([straight - length for length, _, _ in lengths])

    def _lengths(self, x: float, y: float, arc: _Arc) -> list[tuple[float, float, float]]:
        """Length of each tendon, anchor to anchor, and its derivatives by the inclination x and y.

        |p + R·b - a|: with m = (x, y)·b it is |(L - m)(c·x, c·y, s) + b - a|.
        """
        s, c, ds, dc, _ = arc
        found = []
        for bx, by, ex, ey in self._anchors:
            rest = self.data.link_length_m - (x * bx + y * by)
            dx, dy, dz = rest * c * x + ex, rest * c * y + ey, rest * s
            length = math.sqrt(dx * dx + dy * dy + dz * dz)
            along = dx * c * x + dy * c * y + dz * s
            curl = rest * (dc * (dx * x + dy * y) + dz * ds)
            found.append(
                (
                    length,
                    (curl * x + rest * c * dx - bx * along) / length,
                    (curl * y + rest * c * dy - by * along) / length,
                )
            )
        return found

    def _bend(self, q: FloatArray) -> tuple[float, float, float]:
        """Inclination x and y, and the co-contraction, by Newton from straight up.

        Steps end at the inclination's limit; from there on the tendons are matched by least
        squares.
        """
        given = q.tolist()
        straight = self.data.link_length_m + self.data.tendon_offset_m
        limit = self.inclination_limit_rad
        x = y = co_contraction = 0.0
        for _ in range(_MAX_ITERATIONS):
            lengths = self._lengths(x, y, _arc(x * x + y * y))
            pulled = [
                value - straight + length[0] for value, length in zip(given, lengths, strict=True)
            ]
            co_contraction = (pulled[0] + pulled[1] + pulled[2]) / 3.0
            mx = (lengths[0][1] + lengths[1][1] + lengths[2][1]) / 3.0
            my = (lengths[0][2] + lengths[1][2] + lengths[2][2]) / 3.0
            xx = xy = yy = rx = ry = 0.0
            for left, (_, gx, gy) in zip(pulled, lengths, strict=True):
                gx, gy, left = mx - gx, my - gy, left - co_contraction
                xx += gx * gx
                xy += gx * gy
                yy += gy * gy
                rx += gx * left
                ry += gy * left
            scale = 1.0 / (xx * yy - xy * xy)
            to_x = x + scale * (yy * rx - xy * ry)
            to_y = y + scale * (xx * ry - xy * rx)
            angle = math.hypot(to_x, to_y)
            if angle > limit:
                to_x, to_y = to_x * limit / angle, to_y * limit / angle
            step = abs(to_x - x) + abs(to_y - y)
            x, y = to_x, to_y
            if step < _STEP_TOLERANCE_RAD:
                break
        return x, y, co_contraction

    def _place(self, x: float, y: float, arc: _Arc) -> None:
        """Fill `_rotation` (about (-y, x, 0)) and `_translation` (the arc's end)."""
        s, c, length = arc.s, arc.c, self.data.link_length_m
        rotation, translation = self._rotation, self._translation
        rotation[0, 0], rotation[1, 1] = 1.0 - c * x * x, 1.0 - c * y * y
        rotation[0, 1] = rotation[1, 0] = -c * x * y
        rotation[0, 2], rotation[1, 2] = s * x, s * y
        rotation[2, 0], rotation[2, 1] = -s * x, -s * y
        rotation[2, 2] = 1.0 - c * (x * x + y * y)
        translation[0], translation[1] = length * c * x, length * c * y
        translation[2] = length * s
