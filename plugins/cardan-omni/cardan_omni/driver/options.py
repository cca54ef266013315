"""Options of the Phantom Omni driver."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from cardan.common import bounds
from cardan.drivers.shaping import ShapingOptions
from cardan_omni.driver.limits import TickLimits

CALIBRATION_WAIT_S = bounds.Range(0.0, 600.0, "s", "a longer wait does not help")
STALE_AFTER_S = bounds.Range(0.005, 0.1, "s", "ticks come every 1 ms; a hand moves 10 cm in 0.1 s")
RANGE_M = bounds.Range(0.001, 1.0, "m", "a hand on a desk reaches no farther")
RANGE_DEG = bounds.Range(1.0, 180.0, "deg", "half a turn to either side is all there is")

_LIBRARY = bounds.Located("(?P<path>.*/.*)", is_read=False)
"""Library name or path; the system loader looks for a name without /."""

_Desk = Annotated[float, bounds.DESK_M]
_Angle = Annotated[float, bounds.ANGLE_DEG]


@dataclass(frozen=True, kw_only=True)
class OmniOptions(ShapingOptions, TickLimits):
    """Options of :class:`Omni`. Raises OptionError for a value that is not allowed.

    The limits of the tick are among them, with its defaults: the plug-in's README.md has the reason
    of each.
    The device's own nominal forces are never exceeded, whatever is set here, and the workspace is
    the device's own unless it is set.
    """

    RENAMED: ClassVar = {"centre_m": "center_m", "centre_rpy_deg": "center_rpy_deg"}

    device: str = ""
    """The device's name in the vendor's setup tool; empty: the first one."""
    library: Annotated[str, _LIBRARY] = ""
    """Path or name of libHD; empty: $CARDAN_LIBHD, else what the system's loader
    finds: libHD.so.3.4, libHD.so.3.0, libHD.so."""
    force_mode: Literal["cartesian", "joint"] = "cartesian"
    """First mode of set_feedback: forces at the stylus, or torques of the three joints."""
    drive_by: Literal["force", "joint_torques"] = "force"
    """How the force loop hands a force to the library: as a force at the gimbal's center, which
    the library turns into torques of the motors, or as torques of the three joints, which the
    loop has made of it (transposed Jacobian, each within `torque_limit_n_m`)."""
    inkwell_switch: bool = True
    """No pose and no force while the stylus is in its inkwell. False: the pose ignores the inkwell
    switch (for a unit where it is broken); the tick still gives no force."""
    status_light: bool = True
    """Feedback "led" sets the device's status light, where it has one that can be set."""
    calibration_wait_s: Annotated[float, CALIBRATION_WAIT_S] = 0.0
    """Longest wait of open() for the calibration, s; it succeeds in either case."""
    stale_after_s: Annotated[float, STALE_AFTER_S] = 0.02
    """Time without a tick after which the pose is invalid, s."""
    center_m: tuple[_Desk, _Desk, _Desk] = (0.0, 0.0, 0.0)
    """Rate mode: position at which the axes are zero, hand frame, m."""
    range_m: Annotated[float, RANGE_M] = 0.06
    """Rate mode: displacement from there that is a full deflection, m."""
    center_rpy_deg: tuple[_Angle, _Angle, _Angle] = (0.0, 0.0, 0.0)
    """Rate mode: orientation at which the axes of rotation are zero: Rz(yaw)·Ry(pitch)·Rx(roll) of
    the hand frame."""
    range_deg: Annotated[float, RANGE_DEG] = 35.0
    """Rate mode: rotation from there that is a full deflection."""
    dead_zone: Annotated[float, bounds.DEAD_ZONE] = 0.15
    """Rate mode: dead band, as a share of the full deflection."""
    dead_zone_shape: Literal["axis", "radial"] = "radial"
    """axis: each axis by itself; radial: the lengths of translation and rotation."""
    rotation: bool = False
    """Rate mode: the stylus's orientation also deflects the axes of rotation."""
    realtime: bool = True
    """Request real-time priority for the force loop; if refused, the loop runs without it."""
    wait_for_device: bool = False
    """open() succeeds without a device or its library, which are used once they appear."""

    def __post_init__(self) -> None:
        TickLimits.__post_init__(self)

    def limits(self) -> TickLimits:
        """Limits of the tick."""
        return TickLimits(
            **{field.name: getattr(self, field.name) for field in dataclasses.fields(TickLimits)}
        )
