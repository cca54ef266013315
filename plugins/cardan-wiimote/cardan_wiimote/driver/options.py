"""Options of the Wii Remote driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.options import require
from cardan.drivers.shaping import ShapingOptions
from cardan_wiimote.address import BLUETOOTH_ADDRESS

FULL_TILT_DEG = bounds.Range(5.0, 90.0, "deg", "beyond upright a tilt gets smaller again")
LOW_PASS_HZ = bounds.Range(0.5, 50.0, "Hz", "lower is seconds late; it measures 100 times a second")
LED = bounds.Range(0, 4, "", "it has four", zero="none")
RECONNECT_AFTER_S = bounds.Range(0.3, 60.0, "s", "a silence of a moment is no loss, a minute is")

_FULL_TILT_DEG = {"paper": 90.0, "tilt": 45.0, "gyro": 90.0}


@dataclass(frozen=True, kw_only=True)
class WiimoteOptions(ShapingOptions):
    """Options of :class:`Wiimote`. Raises OptionError for a value that is not allowed."""

    dead_zone: Annotated[float, bounds.DEAD_ZONE] = 0.07
    """Share of the full scale that counts as rest; 0.07 of 1 g are 4 degrees."""
    transport: Literal["auto", "hidraw", "l2cap", "socket"] = "auto"
    """auto: hidraw. l2cap: own Bluetooth channels, without the kernel's drivers. socket: a
    simulated remote."""
    path: Annotated[str, bounds.MEETING] = ""
    """hidraw: the device's path as ``cardan devices`` lists it, empty for the first found; socket:
    the folder of the simulated remote's two sockets."""
    address: str = ""
    """Bluetooth address of the remote, "00:1F:32:AA:BB:CC"; must be given for l2cap, empty: any."""
    roles: Literal["paper", "tilt", "gyro"] = "paper"
    """Mapping of the remote's motion while a clutch button is held."""
    full_tilt_deg: Annotated[float, FULL_TILT_DEG] | None = None
    """Tilt of full deflection, 5 to 90; None: 90 (roles "paper"), 45 ("tilt")."""
    neutral: Literal["level", "press"] = "level"
    """Neutral tilt: level, or the attitude when the clutch is pressed."""
    low_pass_hz: Annotated[float, LOW_PASS_HZ] = 7.0
    """Cut-off frequency of the filter on the accelerometer."""
    gyro_full_scale_rad_s: Annotated[float, bounds.HAND_TURN_RAD_S] = 3.0
    """Angular rate of the remote at full deflection (roles "gyro")."""
    motion_plus: Literal["auto", "on", "off"] = "auto"
    """Use of a MotionPlus; auto: if the roles need it."""
    ir: bool = False
    """True: the camera is on; the metrics have the pointing direction."""
    led: Annotated[int, LED] = 1
    """LED, 1 to 4, that is on from opening until the gateway changes it; 0: none."""
    reconnect_after_s: Annotated[float, RECONNECT_AFTER_S] = 0.5
    """Silence after which the remote is reopened; its input is accepted for 0.1 s only."""
    wait_for_device: bool = False
    """open() succeeds without a remote, which is connected once it appears."""

    def __post_init__(self) -> None:
        super().__post_init__()
        address, path, plus = self.address, self.path, self.motion_plus
        good = not address or address in BLUETOOTH_ADDRESS
        require(good, "address", address, f"empty or {BLUETOOTH_ADDRESS}")
        good = self.transport != "l2cap" or bool(address)
        require(good, "address", address, "the remote's address for transport 'l2cap'")
        good = self.transport != "socket" or bool(path)
        require(good, "path", path, "the folder of the sockets for transport 'socket'")
        good = self.roles != "gyro" or plus != "off"
        require(good, "motion_plus", plus, "auto or on: roles 'gyro' need it")

    @property
    def full_tilt_used_deg(self) -> float:
        """Tilt of full deflection."""
        return _FULL_TILT_DEG[self.roles] if self.full_tilt_deg is None else self.full_tilt_deg

    @property
    def wants_motion_plus(self) -> bool:
        """True if a MotionPlus is to be switched on."""
        return self.motion_plus == "on" or (self.motion_plus == "auto" and self.roles == "gyro")
