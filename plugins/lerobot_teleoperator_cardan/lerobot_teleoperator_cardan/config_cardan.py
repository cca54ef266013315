"""Options of ``--teleop.…``."""

from dataclasses import dataclass, field
from typing import Any

from lerobot.teleoperators import TeleoperatorConfig


@TeleoperatorConfig.register_subclass("cardan")
@dataclass
class CardanTeleopConfig(TeleoperatorConfig):
    """A device of Cardan: of a session's file, or of a driver."""

    session: str = ""
    """File of a session, of which [device], [mapping], [gripper], [limits] and [watchdogs] are
    read; or else:"""
    driver: str = ""
    """A driver, as `cardan devices drivers` lists them."""
    options: dict[str, Any] = field(default_factory=dict)
    """Its options, as a session's [device] has them."""
    mapping: dict[str, Any] = field(default_factory=dict)
    """As a session's [mapping], and in place of the file's."""
    gripper: dict[str, Any] = field(default_factory=dict)
    """As a session's [gripper]: its buttons."""
    action: str = "delta"
    """"delta": shares of full speed; "target": the way since following began."""
    success_button: str = ""
    """Ends an episode that succeeded; empty: none."""
    failure_button: str = ""
    """Ends an episode that failed."""
    rerecord_button: str = ""
    """Ends an episode that is to be recorded anew."""
