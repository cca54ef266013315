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
    """File of a session, whose operator device is left out. Alternatives: `driver`, `address`."""
    driver: str = ""
    """Name of a driver, from `cardan devices drivers`."""
    options: dict[str, Any] = field(default_factory=dict)
    """Options of the driver, as in a session's [robot]."""
    address: str = ""
    """Arm of a running session on the network: tcp/192.168.1.10:7447/NODE."""
    model: str = ""
    """Model of the arm; a session's file names it."""
    mapping: dict[str, Any] = field(default_factory=dict)
    """Mapping as in a session's [mapping], in place of the file's: frame and full speeds of
    actions, and approach. Use the same for the teleoperator."""
    gripper: dict[str, Any] = field(default_factory=dict)
    """Gripper as in a session's [gripper]: the output that controls it."""
    limits: dict[str, Any] = field(default_factory=dict)
    """Limits as in a session's [limits]."""
    action: str = "delta"
    """"delta": shares of full speed; "target": displacement since the start of following; "pose":
    pose of the TCP."""
    network_gripper: bool = False
    """True if the arm at `address` has a gripper."""
    ready_timeout_s: float = 10.0
    """Longest wait for the robot's first measurement."""
    silence_timeout_s: float = 5.0
    """Longest wait for a robot that falls silent: an observation blocks as long, and never returns
    an old state."""
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    """LeRobot's cameras by name, observed together with the arm."""
