"""Settings of the simulated ROS 2 arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from cardan.bus.dds_options import DdsOptions
from cardan.bus.options import DOMAIN, BusOptions
from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import Options
from cardan.errors import ConfigurationError
from cardan.robots import load_arm
from cardan.sim_peers.arm.options import PlantOptions
from cardan.sim_peers.base import FaultSwitch, check_faults, check_jam
from cardan.sim_peers.command import listen_option, option
from cardan.sim_peers.link import LINK_FAULTS

RATE_HZ = Range(10.0, 1000.0, "Hz", "the simulation of the arm is no faster")

FAULTS: tuple[FaultSwitch, ...] = (
    *LINK_FAULTS,
    FaultSwitch("silence", "no joint states for this long every 5 s, s", 0.3),
    FaultSwitch.at("restart", "the nodes stop and return after 1 s,"),
    FaultSwitch.at("stale", "joint states repeat unchanged, with their stamp, from"),
    FaultSwitch.share("nan", "share of joint states with a position that is not a number"),
    FaultSwitch.share("absurd", "share of joint states with a position of 1e9 rad"),
    FaultSwitch.at("wrong-names", "joints have other names from"),
    FaultSwitch.at("missing", "joint states lack the last joint from"),
    FaultSwitch.flag("extra", "joint states have a finger's joint, too"),
    FaultSwitch.flag("gripper", "another node publishes a gripper's joint on the same topic"),
    FaultSwitch.at(
        "second-publisher",
        "another publisher has the arm's joints, too, as zeros at 10 Hz, as a forgotten "
        "joint_state_publisher does, from",
    ),
    FaultSwitch("clock-step", "the stamps jump by this at 5 s, s", -3600.0, -1e9, 1e9),
    FaultSwitch.flag("no-stamps", "stamps are zero"),
    FaultSwitch.at("inactive", "the controller is unloaded"),
    FaultSwitch("jam", "this joint (1: the first) does not move any more from 2 s on", 2.0, 1, 16),
)

NEVER_ON_DDS = frozenset({"duplicate", "reorder"})
"""Network faults that DDS repairs by its own sequence numbers."""

SILENCE_EVERY_S = 5.0
CLOCK_STEP_AT_S = 5.0
JAM_AT_S = 2.0
SECOND_HZ = 10.0
"""Default of joint_state_publisher's parameter `rate`."""
RESTART_S = 1.0
"""A real restart takes longer; to the other side only the silence counts."""


@dataclass(frozen=True, kw_only=True)
class RosArmOptions(Options):
    """Settings of the simulated arm, its controller and its transport."""

    robot: str = option("ur5", "Which arm: a name, a .toml or a .urdf file.", metavar="NAME|FILE")
    drive: Literal["dynamic", "ideal"] = option("dynamic", "ideal: exactly where commanded.")
    sag: bool = option(False, "Its servo does not compensate gravity.")
    payload_kg: Annotated[float, bounds.PAYLOAD_KG] = option(0.0, "A mass at the TCP.")
    transport: Literal["zenoh", "dds"] = option(
        "zenoh", "What its nodes speak: rmw_zenoh, or DDS (domain instead of listen and router)."
    )
    host: Annotated[str, bounds.LISTEN_HOST] = listen_option("Where other nodes connect to")
    port: Annotated[int, bounds.ANY_PORT] = 7447
    """TCP port; used by default instead of a router."""
    router: str = option(
        "", "A Zenoh router to find other nodes by (tcp/127.0.0.1:7447).", metavar="ENDPOINT"
    )
    domain: Annotated[int, DOMAIN] = option(0, "ROS_DOMAIN_ID.", metavar="NUMBER")
    controller: Literal["position", "velocity", "joint_state", "trajectory"] = option(
        "position", "Which controller is active, on its usual topic."
    )
    rate_hz: Annotated[float, RATE_HZ] = option(100.0, "Joint states are published this often.")
    faults: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_faults(self.faults, FAULTS)
        check_jam(self.faults, len(load_arm(self.robot, "robot").joints))
        if self.transport == "dds" and (never := NEVER_ON_DDS.intersection(self.faults)):
            raise ConfigurationError(
                "faults",
                f"{', '.join(sorted(never))}: DDS gives each message once and in order; take zenoh",
            )

    @property
    def plant(self) -> PlantOptions:
        """Arm without its controllers."""
        return PlantOptions(
            drive=self.drive, gravity_feedforward=not self.sag, payload_kg=self.payload_kg
        )

    @property
    def bus(self) -> BusOptions:
        """Options to join the bus."""
        return BusOptions(
            domain=self.domain, router=self.router, listen=(f"tcp/{self.host}:{self.port}",)
        )

    @property
    def dds(self) -> DdsOptions:
        """Options to join DDS."""
        return DdsOptions(dds_domain=self.domain)

    @property
    def period_s(self) -> float:
        """Period of the joint states."""
        return 1.0 / self.rate_hz
