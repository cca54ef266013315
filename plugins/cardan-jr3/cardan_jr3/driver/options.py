"""Options of the JR3 driver."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import Options, require
from cardan_jr3.bounds import CAN_NAME, CAN_PORTS
from cardan_jr3.protocol import MAX_CUTOFF_HZ, MAX_NODE_ID

NODE_ID = Range(1, MAX_NODE_ID, "", "a CANopen bus has no other numbers")
BITRATE = Range(10_000, 1_000_000, "bit/s", "CAN has no other bit rates")
PERIOD_S = Range(
    0.001, 0.04, "s", "boards are tested to 1 ms; beyond, one lost sample makes the sensor stale"
)
CUTOFF_HZ = Range(0.0, MAX_CUTOFF_HZ, "Hz", "the board's field holds no more", zero="none")
FORCE_FULL_SCALE_N = Range(1, 65535, "N", "the board's field has 16 bits")
TORQUE_FULL_SCALE_NM = Range(0.1, 6553.5, "N·m", "the board's field has 16 bits, in tenths")

PORT_OR_OWN = replace(bounds.PORT, lowest=0, zero="the interface's own")

_Angle = Annotated[float, bounds.ANGLE_DEG]
_Near = Annotated[float, bounds.NEAR_M]
_Newton = Annotated[int, FORCE_FULL_SCALE_N]
_NewtonMeter = Annotated[float, TORQUE_FULL_SCALE_NM]


@dataclass(frozen=True, kw_only=True)
class Jr3Options(Options):
    """Options of :class:`Jr3`. Raises OptionError for a value that is not allowed."""

    interface: Annotated[str, CAN_NAME] = "socketcan"
    """python-can's name of the interface to the bus: "socketcan", "slcan", "pcan", "gs_usb" ... for
    hardware, "udp_multicast" or "socketcand" for a simulated sensor."""
    channel: Annotated[str, CAN_NAME] = "can0"
    """The bus: the network interface of socketcan, the serial port of slcan, the group of
    udp_multicast ("239.74.163.2")."""
    bitrate: Annotated[int, BITRATE] = 1_000_000
    """Bit rate of the bus, bit/s; socketcan's is set with `ip link` instead."""
    host: Annotated[str, bounds.HOST] = "127.0.0.1"
    """Host of socketcand."""
    port: Annotated[int, PORT_OR_OWN] = 0
    """Port of udp_multicast (0: 43113) or socketcand (0: 29536)."""
    hop_limit: Annotated[int, bounds.HOP_LIMIT] = 0
    """Hop limit of udp_multicast; 0: frames stay on this computer."""
    node_id: Annotated[int, NODE_ID] = 33
    """Node id of the board on the bus, 1 to 127."""
    mode: Literal["async", "sync"] = "async"
    """async: the board sends by its own clock; sync: it answers each SYNC."""
    period_s: Annotated[float, PERIOD_S] = 0.01
    """Time between two samples that the board sends, or between two SYNC."""
    send_sync: bool = True
    """Cut-off of the board's first-order low-pass filter; 0: unfiltered."""
    cutoff_hz: Annotated[float, CUTOFF_HZ] = 10.0
    """Cut-off of the board's first-order low-pass filter; 0: unfiltered."""
    host_cutoff_hz: Annotated[float, CUTOFF_HZ] = 0.0
    """Cut-off of a second filter, on this computer; 0: none."""
    force_full_scales_n: tuple[_Newton, _Newton, _Newton] | None = None
    """The sensor's full scales x, y, z; none: they are read from the board."""
    torque_full_scales_nm: tuple[_NewtonMeter, _NewtonMeter, _NewtonMeter] | None = None
    """Full scales of the torques; none: they are read from the board."""
    left_handed: bool = False
    """The sensor's axes are left-handed, as on some models: the signs of Fx and Mx are inverted."""
    sensor_rpy_deg: tuple[_Angle, _Angle, _Angle] = (0.0, 0.0, 0.0)
    """Orientation of the sensor in the tool's frame: Rz(yaw)·Ry(pitch)·Rx(roll)."""
    sensor_xyz_m: tuple[_Near, _Near, _Near] = (0.0, 0.0, 0.0)
    """Position of the sensor's origin in the tool's frame; torques are given about the TCP."""
    zero_on_open: bool = True
    """Take the measurement at opening as zero; false: the board's zero stays."""
    steady_n_s: Annotated[float, bounds.FORCE_RATE_S] = 10.0
    """Zero is taken only while no force changes faster than this."""
    steady_nm_s: Annotated[float, bounds.FORCE_RATE_S] = 1.0
    """Zero is taken only while no torque changes faster than this."""
    force_dead_band_n: Annotated[float, bounds.ROBOT_FORCE_N] = 1.0
    """Dead band, subtracted from each force before it deflects an axis; forces below it are rest.
    Never 0: the sensor's noise would drive the arm, and rest would not be detected."""
    torque_dead_band_nm: Annotated[float, bounds.ROBOT_TORQUE_NM] = 0.1
    """Dead band, subtracted from each torque before it deflects an axis; torques below it are
    rest."""
    force_full_n: Annotated[float, bounds.ROBOT_FORCE_N] = 10.0
    """Force beyond the dead band at full deflection."""
    torque_full_nm: Annotated[float, bounds.ROBOT_TORQUE_NM] = 2.0
    """Torque beyond the dead band at full deflection."""
    wait_for_device: bool = False
    """open() succeeds without a sensor, which is used once it answers."""

    def __post_init__(self) -> None:
        super().__post_init__()
        good = not 0.0 < self.cutoff_hz < 0.01
        require(good, "cutoff_hz", self.cutoff_hz, "0, or 0.01 Hz and more")

    @property
    def full_port(self) -> int:
        """Port to use: the interface's default if `port` is 0."""
        return self.port or CAN_PORTS.get(self.interface, 0)
