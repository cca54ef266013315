"""Any arm of Cardan as a robot of LeRobot: ``--robot.type=cardan``."""

from lerobot_robot_cardan.config_cardan import CardanRobotConfig
from lerobot_robot_cardan.robot import CardanRobot

__all__ = ["CardanRobot", "CardanRobotConfig"]
