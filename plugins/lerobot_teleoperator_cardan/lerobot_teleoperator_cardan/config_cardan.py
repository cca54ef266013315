"""Options of ``--teleop.…``."""

from dataclasses import dataclass, field
from typing import Any

from lerobot.teleoperators import TeleoperatorConfig


@TeleoperatorConfig.register_subclass("cardan")
@dataclass
class CardanTeleopConfig(TeleoperatorConfig):
    """Device of a session's file, or of a driver."""

    session: str = ""
    """File of a session, for [device], [mapping], [gripper], [limits] and [watchdogs]. Alternative:
    `driver`."""
    driver: str = ""
    """Name of a driver, from `cardan devices drivers`."""
    options: dict[str, Any] = field(default_factory=dict)
    """Options of the driver, as in a session's [device]."""
    mapping: dict[str, Any] = field(default_factory=dict)
    """Mapping as in a session's [mapping], in place of the file's."""
    gripper: dict[str, Any] = field(default_factory=dict)
    """Gripper as in a session's [gripper]: its buttons."""
    action: str = "delta"
    """"delta": shares of full speed; "target": displacement since the start of following."""
    success_button: str = ""
    """Button that ends a successful episode; empty: none."""
    failure_button: str = ""
    """Button that ends a failed episode."""
    rerecord_button: str = ""
    """Button that ends an episode to be recorded again."""
