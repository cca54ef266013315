"""Settings of the simulated Universal Robots controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import Options, require_each
from cardan.protocols.ur.dashboard import DASHBOARD_PORT
from cardan.protocols.ur.primary import PRIMARY_PORT
from cardan.protocols.ur.rtde import RTDE_PORT, ControllerVersion
from cardan.robots import ArmModel, load_arm
from cardan.sim_peers.base import check_faults
from cardan.sim_peers.command import option
from cardan.sim_peers.ur_controller.faults import FAULTS

TAKES_S = Range(0.0, 60.0, "s", "no controller takes longer")

_Takes = Annotated[float, TAKES_S]


@dataclass(frozen=True, kw_only=True)
class UrControllerOptions(Options):
    """How the simulated controller is set up."""

    robot: Literal["ur5e", "ur5"] = option(
        "ur5e", "ur5e: an e-Series, 500 Hz; ur5: a CB3, 125 Hz, without remote control."
    )
    host: Annotated[str, bounds.LISTEN_HOST] = option(
        "127.0.0.1", "The address it listens on.", metavar="HOST"
    )
    rtde_port: Annotated[int, bounds.ANY_PORT] = option(
        RTDE_PORT, "RTDE. 0: any free port.", metavar="PORT"
    )
    primary_port: Annotated[int, bounds.ANY_PORT] = option(
        PRIMARY_PORT, "The primary interface, which takes programs.", metavar="PORT"
    )
    dashboard_port: Annotated[int, bounds.ANY_PORT] = option(
        DASHBOARD_PORT, "The dashboard server.", metavar="PORT"
    )
    allow_connect: str = option(
        "",
        "Hosts, with commas, that programs may open sockets to beside this computer.",
        metavar="HOST",
    )
    running: bool = option(False, "Power is on and the brakes are released from the start.")
    remote: bool = option(True, "An e-Series in local control: it takes no programs.", name="local")
    contact_z_m: Annotated[float, bounds.NEAR_M] | None = option(
        None, "Height in its base of a plane that the TCP touches; none: nothing is touched."
    )
    contact_stiffness_n_m: Annotated[float, bounds.ENVIRONMENT_STIFFNESS_N_M] = option(
        20_000.0, "Of that plane.", name="contact-stiffness", metavar="N/M"
    )
    start: tuple[float, ...] | None = None
    """Joints at the start, rad; None: the arm's home."""
    boot_s: _Takes = 1.0
    """From the order to switch the power on until it is."""
    release_s: _Takes = 0.6
    """From the order to release the brakes until they are."""
    program_start_s: _Takes = 0.05
    """From a program's last byte until its first statement."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by name, from `cardan.sim_peers.base.parse_faults`."""
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        ports = [port for port in self.ports.values() if port]
        arm = self.arm
        inside = self.start is None or arm.holds(self.start)
        require_each(
            self,
            ("rtde_port", len(set(ports)) == len(ports), "another one than the others"),
            ("start", inside, f"{len(arm.joints)} joints inside their ranges"),
        )
        check_faults(self.faults, FAULTS)

    @property
    def ports(self) -> dict[str, int]:
        """By what is served there."""
        return {
            "rtde": self.rtde_port,
            "primary": self.primary_port,
            "dashboard": self.dashboard_port,
        }

    @property
    def allowed_hosts(self) -> frozenset[str]:
        """`allow_connect`, one by one."""
        return frozenset(filter(None, map(str.strip, self.allow_connect.split(","))))

    @property
    def arm(self) -> ArmModel:
        """The arm."""
        return load_arm(self.robot)

    @property
    def e_series(self) -> bool:
        """Not a CB3."""
        return self.robot.endswith("e")

    @property
    def rate_hz(self) -> float:
        """Of the control loop."""
        return 500.0 if self.e_series else 125.0

    @property
    def version(self) -> ControllerVersion:
        """Of the software it has."""
        return ControllerVersion(5, 12, 0, 0) if self.e_series else ControllerVersion(3, 15, 0, 0)
