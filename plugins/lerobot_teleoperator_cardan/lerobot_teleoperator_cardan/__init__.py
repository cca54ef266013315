"""Any hand-held device of Cardan as a teleoperator of LeRobot: ``--teleop.type=cardan``."""

from lerobot_teleoperator_cardan.config_cardan import CardanTeleopConfig
from lerobot_teleoperator_cardan.teleoperator import CardanTeleop

__all__ = ["CardanTeleop", "CardanTeleopConfig"]
