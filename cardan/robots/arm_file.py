"""TOML beside a URDF: settings that a URDF cannot express."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal

from cardan.common.bounds import Length, Point, Range
from cardan.common.options import Options
from cardan.errors import ConfigurationError, below
from cardan.robots.arm_model import Capsule, OrientedBox, Shape, Task
from cardan.robots.urdf import LARGEST_NUMBER
from cardan.types import Vector3

_Number = Annotated[float, Range(-LARGEST_NUMBER, LARGEST_NUMBER, "", "")]
_Positive = Annotated[float, Range(0.0, LARGEST_NUMBER, "", "", above=True)]


@dataclass(frozen=True, kw_only=True)
class SolidTable(Options):
    """A solid body: its name, and one of the keys that give its shape."""

    FORMS: ClassVar[Mapping[str, str]] = {
        "box": "[corner, corner]",
        "capsule": "[end, end, radius]",
    }

    name: str
    box: tuple[Point, Point] | None = None
    """Lowest and highest corner, m."""
    capsule: tuple[Point, Point, Length] | None = None
    """Ends and radius, m; the same point twice: a sphere."""

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [key for key in self.FORMS if getattr(self, key) is not None]
        if len(given) != 1:
            name = repr(self.name) if self.name else "it"
            forms = ", ".join(f"{key} = {form}" for key, form in self.FORMS.items())
            raise ConfigurationError(
                "", f"{name} has {' and '.join(given) or 'no shape'}; give one of {forms}"
            )
        with below("box"):
            self.shape()

    def shape(self) -> Shape | None:
        """The box or the capsule; None if it is neither."""
        if self.box is not None:
            return OrientedBox.between(*(Vector3(*corner) for corner in self.box))
        if self.capsule is not None:
            start, end, radius_m = self.capsule
            return Capsule(Vector3(*start), Vector3(*end), radius_m)
        return None


@dataclass(frozen=True, kw_only=True)
class ShapeTable(SolidTable):
    """``[[collision.shape]]``, along the axes of the link that it is fixed to."""

    name: str = ""
    """Name; empty: the link's."""
    link: str = ""
    """Link; empty: the base."""


@dataclass(frozen=True, kw_only=True)
class CollisionTable(Options):
    """``[collision]``"""

    ignore: tuple[tuple[str, str], ...] = ()
    """Pairs of links, or of names of shapes, that always touch, besides neighbors."""
    meshes: Literal["fit", "ignore"] = "fit"
    """Treatment of meshes: covered by shapes, or ignored."""
    fit: Literal["tight", "coarse"] = "tight"
    """Cover of a mesh: up to four capsules and boxes, or one."""
    shape: tuple[ShapeTable, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ArmFile(Options):
    """Contents of the file."""

    urdf: str
    """Path from the folder of this file, or ``PACKAGE:FILE``; a ``.xacro`` is expanded."""
    xacro: Mapping[str, str] = field(default_factory=dict)
    """Arguments for xacro."""
    srdf: str = ""
    """SRDF, likewise, with the links that are not checked. Empty: determined from 10,000
    postures."""
    tcp: str = ""
    """Link whose frame is the TCP; default: the last link, if there is one."""
    flange: str = ""
    base: str = ""
    """Link whose frame is the arm's base; default: the root, or if moving joints precede the arm,
    the link that carries its first joint."""
    joints: tuple[str, ...] = ()
    """Joints of the arm, of those between `base` and `tcp`; empty: all."""
    hold: Mapping[str, _Number] = field(default_factory=dict)
    """Positions of other joints, deg or m; default: nearest to 0 in their range."""
    package_dirs: tuple[str, ...] = ()
    """Folders of packages, relative to the URDF's folder, searched before all others."""
    home_deg: tuple[_Number, ...] | None = None
    """Home, revolute joints in deg, prismatic ones in m; default: a bent posture is chosen."""
    velocity_deg_s: Mapping[str, _Positive] = field(default_factory=dict)
    """Speeds by joint, deg/s, m/s for prismatic ones; they replace the URDF's, as do the next."""
    lower_deg: Mapping[str, _Number] = field(default_factory=dict)
    """Ends of ranges, deg, m for prismatic joints."""
    upper_deg: Mapping[str, _Number] = field(default_factory=dict)
    effort: Mapping[str, _Positive] = field(default_factory=dict)
    """Efforts, N·m, or N for prismatic joints."""
    acceleration_deg_s2: _Positive | tuple[_Positive, ...] | None = None
    """One value for all joints, or one each; deg/s², m/s² for prismatic joints."""
    counterbalance: str = ""
    """Last joint from the base whose weight springs carry; empty: there are none."""
    task: Task = field(default_factory=Task)
    collision: CollisionTable = field(default_factory=CollisionTable)
