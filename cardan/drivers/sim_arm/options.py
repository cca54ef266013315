"""Options of the driver of the simulated arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.options import Options, require, require_each
from cardan.errors import ConfigurationError, ScriptError
from cardan.robots import load_arm
from cardan.sim_peers.arm.faults import FAULTS
from cardan.sim_peers.arm.options import (
    PERIOD_S,
    Ball,
    PlantOptions,
    SimulatedArmOptions,
    TouchPlane,
)
from cardan.sim_peers.base import parse_faults
from cardan.types import JointLimits, Vector3

SILENT_PERIODS = 3
"""Missed states after which the link is LOST; fewer are network jitter."""

_Meter = Annotated[float, bounds.COORDINATE_M]
_Radius = Annotated[float, bounds.LENGTH_M]
_Component = Annotated[float, bounds.DIRECTION]


@dataclass(frozen=True)
class SimArmOptions(Options):
    """Options of :class:`SimArm`. With transport "udp" the arm's own are the served peer's:
    `robot` and `period_s` must then agree with it, and drive, planes, spheres, payload, start,
    faults and seed must be left alone."""

    robot: Annotated[str, bounds.ARM_FILE] = "ur5"
    """An arm's name, or the path of a .toml or .urdf file."""
    transport: Literal["in-process", "udp"] = "in-process"
    """in-process: the arm runs in this process; udp: a served arm."""
    endpoint: str = "127.0.0.1:6520"
    """HOST:PORT of a served arm (`cardan sim arm`), for transport "udp"."""
    pacing: Literal["real-time", "virtual"] = "real-time"
    """virtual: cycles come as fast as they are consumed, with stamps from 0 s; for tests and
    benchmarks that take their time from the states. In-process only."""
    period_s: Annotated[float, PERIOD_S] = 0.002
    """Cycle of the controller; udp: the peer's."""
    drive: Literal["dynamic", "ideal"] = "dynamic"
    """ideal: the joints are exactly where they are commanded to be."""
    gravity_feedforward: bool = False
    """True: the servo compensates gravity, with hardly any sag."""
    planes: tuple[tuple[_Meter, _Meter, _Meter, _Component, _Component, _Component], ...] = ()
    """Solid half spaces: x y z of a point in m and the outward normal, base frame."""
    spheres: tuple[tuple[_Meter, _Meter, _Meter, _Radius], ...] = ()
    """Solid spheres: center x y z and radius, m, base frame."""
    payload_kg: Annotated[float, bounds.PAYLOAD_KG] = 0.0
    """A point mass at the TCP."""
    start: tuple[Annotated[float, bounds.JOINT_POSITION], ...] = ()
    """Joints at the start, rad or m; empty: the arm's home."""
    faults: tuple[str, ...] = ()
    """NAME or NAME=VALUE, as `cardan sim arm --list-faults` names them."""
    seed: Annotated[int, bounds.SEED] = 0
    """Seed of all random numbers."""
    command_timeout_s: Annotated[float, bounds.BLIND_S] = 0.1
    """Time without a command after which the simulated controller brakes."""
    silence_s: Annotated[float, bounds.BLIND_S] = 0.1
    """Silence (at least three periods) after which the link is LOST."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.address
        joints = len(load_arm(self.robot, "robot").joints)
        try:
            _ = self.arm_options
        except ScriptError as error:
            raise ConfigurationError("faults", str(error)) from None
        require_each(self, ("start", len(self.start) in (0, joints), f"{joints} joints, or none"))
        if self.transport == "udp":
            fields = SimArmOptions.__dataclass_fields__
            require_each(
                self,
                ("pacing", self.pacing == "real-time", "real-time over udp"),
                *(
                    (
                        key,
                        getattr(self, key) == fields[key].default,
                        "left out over udp: it is set at the served peer",
                    )
                    for key in _OF_THE_PEER
                ),
            )

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of `endpoint`; OptionError if it is invalid."""
        host, _, port = self.endpoint.rpartition(":")
        good = host and port.isdecimal() and len(port) <= 5 and int(port) in bounds.PORT
        require(good, "endpoint", self.endpoint, "HOST:PORT, as 127.0.0.1:6520")
        require(host in bounds.HOST, "endpoint", self.endpoint, f"HOST:PORT with {bounds.HOST}")
        return host, int(port)

    @property
    def arm_options(self) -> SimulatedArmOptions:
        """Return options of the simulated arm in this process. Raises a CardanError for an invalid
        one."""
        return SimulatedArmOptions(
            robot=self.robot,
            plant=PlantOptions(
                drive=self.drive,
                gravity_feedforward=self.gravity_feedforward,
                planes=tuple(TouchPlane(Vector3(*p[:3]), Vector3(*p[3:])) for p in self.planes),
                balls=tuple(Ball(Vector3(*s[:3]), s[3]) for s in self.spheres),
                payload_kg=self.payload_kg,
                start=self.start or None,
            ),
            period_s=self.period_s,
            command_timeout_s=self.command_timeout_s,
            faults=parse_faults(self.faults, FAULTS),
            seed=self.seed,
        )

    @property
    def lost_after_s(self) -> float:
        """Silence after which the link is LOST, s."""
        return max(self.silence_s, SILENT_PERIODS * self.period_s)

    @property
    def joint_limits(self) -> JointLimits:
        """Joint limits of the arm."""
        return load_arm(self.robot).limits


_OF_THE_PEER = (
    "drive",
    "gravity_feedforward",
    "planes",
    "spheres",
    "payload_kg",
    "start",
    "faults",
    "seed",
    "command_timeout_s",
)
