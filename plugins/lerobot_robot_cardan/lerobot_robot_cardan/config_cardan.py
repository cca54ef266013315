"""Options of ``--robot.…``."""

from dataclasses import dataclass, field
from typing import Any

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig


@RobotConfig.register_subclass("cardan")
@dataclass
class CardanRobotConfig(RobotConfig):
    """An arm of Cardan: of a session's file, of a driver, or of a running session on the
    network."""

    session: str = ""
    """File of a session, whose operator device is left out; or else:"""
    driver: str = ""
    """A driver, as `cardan devices drivers` lists them."""
    options: dict[str, Any] = field(default_factory=dict)
    """Its options, as a session's [robot] has them."""
    address: str = ""
    """Or the arm that a running session shows on the network: tcp/192.168.1.10:7447/NODE."""
    model: str = ""
    """The arm's model; a session's file names it."""
    mapping: dict[str, Any] = field(default_factory=dict)
    """As a session's [mapping], and in place of the file's: the frame and the full speeds of
    actions, and the approach. The teleoperator's has to be the same."""
    gripper: dict[str, Any] = field(default_factory=dict)
    """As a session's [gripper]: the output that it is on."""
    limits: dict[str, Any] = field(default_factory=dict)
    """As a session's [limits]."""
    action: str = "delta"
    """"delta": shares of full speed; "target": the way since following began; "pose": where the
    TCP is to be."""
    network_gripper: bool = False
    """Whether the arm at `address` has a gripper."""
    ready_timeout_s: float = 10.0
    """Longest wait for the robot's first measurement."""
    silence_timeout_s: float = 5.0
    """Longest wait for a robot that falls silent: an observation takes as long, and is never an old
    one."""
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    """LeRobot's, by name: observed beside the arm."""
