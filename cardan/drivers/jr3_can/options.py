"""What can be set about the JR3 driver."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from cardan.protocols.jr3_can import MAX_CUTOFF_HZ, MAX_NODE_ID

MODES = ("async", "sync")

SHORTEST_PERIOD_S, LONGEST_PERIOD_S = 0.001, 0.04
"""Boards are tested to 1 ms; with the longest, one lost sample does not make the sensor stale."""

UDP_MULTICAST_PORT = 43113
SOCKETCAND_PORT = 29536
DEFAULT_PORTS = {"udp_multicast": UDP_MULTICAST_PORT, "socketcand": SOCKETCAND_PORT}


@dataclass(frozen=True, kw_only=True)
class Jr3Options:
    """Options of :class:`Jr3`. Raises ValueError for a value that is not allowed."""

    interface: str = "socketcan"
    """python-can's name of the way to the bus: "socketcan", "slcan", "pcan", "gs_usb" ... for
    hardware, "udp_multicast" or "socketcand" for a simulated sensor."""
    channel: str = "can0"
    """The bus: the network interface of socketcan, the serial port of slcan, the group of
    udp_multicast ("239.74.163.2")."""
    bitrate: int = 1_000_000
    """Of the bus, bit/s; socketcan's is set with `ip link` instead."""
    host: str = "127.0.0.1"
    """Where socketcand serves."""
    port: int = 0
    """Of udp_multicast (0: 43113) and socketcand (0: 29536)."""
    hop_limit: int = 0
    """Of udp_multicast; 0: frames stay on this computer."""
    node_id: int = 33
    """The board's number on the bus, 1 to 127."""
    mode: Literal["async", "sync"] = "async"
    """async: the board sends by its own clock; sync: it answers SYNC."""
    period_s: float = 0.01
    """Time between two samples: of the board's sending, or of SYNC."""
    send_sync: bool = True
    """sync: this driver sends SYNC; false: a master on the bus does, every `period_s`."""
    cutoff_hz: float = 10.0
    """Of the board's first-order low-pass filter; 0: unfiltered."""
    host_cutoff_hz: float = 0.0
    """Of another one on this computer; 0: none."""
    force_full_scales_n: tuple[int, int, int] | None = None
    """The sensor's full scales x, y, z; none: the board is asked."""
    torque_full_scales_nm: tuple[float, float, float] | None = None
    """The same of the torques; none: the board is asked."""
    left_handed: bool = False
    """The sensor's axes are left-handed, as some are: Fx and Mx are turned round."""
    sensor_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Orientation of the sensor in the tool's frame: Rz(yaw)·Ry(pitch)·Rx(roll)."""
    sensor_xyz_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the sensor's origin is in the tool's frame; torques are given about the TCP."""
    zero_on_open: bool = True
    """What is measured while opening is taken for zero; false: the board's zero stays."""
    steady_n_s: float = 10.0
    """Zero is taken only while no force changes faster than this."""
    steady_nm_s: float = 1.0
    """Zero is taken only while no torque changes faster than this."""
    force_dead_band_n: float = 1.0
    """Subtracted from each force before it deflects an axis: the hand is off below it."""
    torque_dead_band_nm: float = 0.1
    """The same of torques."""
    force_full_n: float = 10.0
    """Force beyond the dead band that is a full deflection."""
    torque_full_nm: float = 2.0
    """Torque beyond the dead band that is a full deflection."""
    wait_for_device: bool = False
    """open() succeeds without a sensor, which is picked up once it answers."""

    def __post_init__(self) -> None:
        def check(key: str, good: Callable[[float], bool], allowed: str) -> None:
            value = getattr(self, key)
            values = value if isinstance(value, tuple) else (value,)
            if not all(math.isfinite(each) and good(each) for each in values):
                raise ValueError(f"{key} is {value!r}; allowed: {allowed}")

        for key in ("interface", "channel"):
            if not getattr(self, key):
                raise ValueError(f"{key} is ''; it needs a name, as python-can calls it")
        if self.mode not in MODES:
            raise ValueError(f"mode is {self.mode!r}; allowed: {', '.join(MODES)}")
        check("node_id", lambda n: 1 <= n <= MAX_NODE_ID, f"1 to {MAX_NODE_ID}")
        check("bitrate", lambda b: 10_000 <= b <= 1_000_000, "10000 to 1000000 bit/s")
        check("port", lambda p: 0 <= p <= 65535, "a port, 1 to 65535, or 0")
        check("hop_limit", lambda n: 0 <= n <= 255, "0 to 255")
        check(
            "period_s",
            lambda t: SHORTEST_PERIOD_S <= t <= LONGEST_PERIOD_S,
            f"{SHORTEST_PERIOD_S:g} to {LONGEST_PERIOD_S:g} s",
        )
        for key in ("cutoff_hz", "host_cutoff_hz"):
            check(key, lambda f: 0.0 <= f <= MAX_CUTOFF_HZ, f"0 (none) to {MAX_CUTOFF_HZ} Hz")
        if 0.0 < self.cutoff_hz < 0.01:
            raise ValueError(f"cutoff_hz is {self.cutoff_hz!r}; allowed: 0, or 0.01 Hz and more")
        if self.force_full_scales_n is not None:
            check("force_full_scales_n", lambda f: 1 <= f <= 65535, "three of 1 to 65535 N")
        if self.torque_full_scales_nm is not None:
            check("torque_full_scales_nm", lambda m: 0.1 <= m <= 6553.5, "three of 0.1 to 6553.5")
        check("sensor_rpy_deg", lambda a: -360.0 <= a <= 360.0, "three angles, -360 to 360")
        check("sensor_xyz_m", lambda x: -10.0 <= x <= 10.0, "three lengths, -10 to 10 m")
        for key in ("steady_n_s", "steady_nm_s", "force_full_n", "torque_full_nm"):
            check(key, lambda v: v > 0.0, "a number above 0")
        # Without a band the noise of the sensor would drive the arm, and rest would not be seen.
        for key in ("force_dead_band_n", "torque_dead_band_nm"):
            check(key, lambda v: v > 0.0, "a number above 0")
        for key in (
            "sensor_rpy_deg",
            "sensor_xyz_m",
            "force_full_scales_n",
            "torque_full_scales_nm",
        ):
            value = getattr(self, key)
            if value is not None and len(value) != 3:
                raise ValueError(f"{key} is {value!r}; it needs three numbers")

    @property
    def full_port(self) -> int:
        """The port to use: the interface's own where `port` is 0."""
        return self.port or DEFAULT_PORTS.get(self.interface, 0)
