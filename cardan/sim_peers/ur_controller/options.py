"""Settings of the simulated Universal Robots controller."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import Options, require_each
from cardan.protocols.ur.dashboard import DASHBOARD_PORT
from cardan.protocols.ur.primary import PRIMARY_PORT, READ_ONLY, SECONDARY_PORT
from cardan.protocols.ur.realtime import REALTIME_PORT
from cardan.protocols.ur.rtde import RTDE_PORT, ControllerVersion
from cardan.robots import ArmModel, load_arm
from cardan.sim_peers.base import check_faults
from cardan.sim_peers.command import option
from cardan.sim_peers.ur_controller.faults import FAULTS

TAKES_S = Range(0.0, 60.0, "s", "no controller takes longer")

_VERSION = re.compile(r"\d{1,2}\.\d{1,2}(\.\d{1,7}){0,2}", re.ASCII)
_Takes = Annotated[float, TAKES_S]


@dataclass(frozen=True, kw_only=True)
class UrControllerOptions(Options):
    """Settings of the simulated controller."""

    robot: Literal["ur5e", "ur5"] = option(
        "ur5e", "ur5e: an e-Series, 500 Hz; ur5: a CB3, 125 Hz, without remote control."
    )
    software: str = option(
        "",
        "The version of its software. Default: 5.12, of a CB3 3.15.",
        metavar="VERSION",
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
    secondary_port: Annotated[int, bounds.ANY_PORT] | None = option(
        None,
        "The secondary interface. Default: 30002 where the primary one is at 30001, else any.",
        metavar="PORT",
    )
    realtime_port: Annotated[int, bounds.ANY_PORT] | None = option(
        None,
        "The real-time interface. Default: 30003 where the primary one is at 30001, else any.",
        metavar="PORT",
    )
    dashboard_port: Annotated[int, bounds.ANY_PORT] = option(
        DASHBOARD_PORT, "The dashboard server.", metavar="PORT"
    )
    allow_connect: str = option(
        "",
        "Hosts, with commas, that programs may open sockets to beside this computer.",
        metavar="HOST",
    )
    programs: str = option(
        "",
        "Programs that the dashboard loads: NAME.script, and NAME.urp with it.",
        metavar="FOLDER",
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
    """Time from the order to switch the power on until it is on."""
    release_s: _Takes = 0.6
    """Time from the order to release the brakes until they are released."""
    program_start_s: _Takes = 0.05
    """Time from a program's last byte until its first statement."""
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
            ("software", self._has_software, "5.0 to 5.99, of a CB3 3.2 to 3.15, as 5.9.4"),
            ("start", inside, f"{len(arm.joints)} joints inside their ranges"),
        )
        check_faults(self.faults, FAULTS)

    @property
    def ports(self) -> dict[str, int]:
        """Ports by interface; 0: any free one. A send-only interface is 10 above its counterpart,
        if that is at its published port."""
        published = self.primary_port == PRIMARY_PORT
        secondary, realtime = (
            (port if published else 0) if given is None else given
            for given, port in (
                (self.secondary_port, SECONDARY_PORT),
                (self.realtime_port, REALTIME_PORT),
            )
        )
        sent = (
            ("primary", self.primary_port, PRIMARY_PORT),
            ("secondary", secondary, SECONDARY_PORT),
            ("realtime", realtime, REALTIME_PORT),
        )
        return {
            "rtde": self.rtde_port,
            "dashboard": self.dashboard_port,
            **{kind: port for kind, port, _ in sent},
            **{
                f"{kind}-read": port + READ_ONLY if port == usual else 0
                for kind, port, usual in sent
            },
        }

    @property
    def allowed_hosts(self) -> frozenset[str]:
        """Hosts of `allow_connect`."""
        return frozenset(filter(None, map(str.strip, self.allow_connect.split(","))))

    @property
    def arm(self) -> ArmModel:
        """The arm."""
        return load_arm(self.robot)

    @property
    def e_series(self) -> bool:
        """True for an e-Series, False for a CB3."""
        return self.robot.endswith("e")

    @property
    def rate_hz(self) -> float:
        """Rate of the control loop."""
        return 500.0 if self.e_series else 125.0

    @property
    def version(self) -> ControllerVersion:
        """Version of its software."""
        words = self.software or ("5.12" if self.e_series else "3.15")
        numbers = [int(word) for word in words.split(".")]
        return ControllerVersion(*numbers, *[0] * (4 - len(numbers)))

    @property
    def _has_software(self) -> bool:
        """Return True if this version exists for the robot."""
        if _VERSION.fullmatch(self.software) is None:
            return not self.software
        if self.e_series:
            return self.version.major == 5
        return (3, 2) <= self.version[:2] <= (3, 15)
