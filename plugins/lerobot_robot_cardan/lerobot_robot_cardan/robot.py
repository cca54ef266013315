"""LeRobot's robot class for Cardan's arms."""

import logging
import time
from typing import Any

from lerobot.cameras import make_cameras_from_configs
from lerobot.robots import Robot
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from cardan.errors import MotionLoopError, MotionRefusedError
from cardan.gateway.arm.interface import CartesianArm
from cardan_learning.arm import ArmActions
from cardan_learning.features import action_names, observation_names
from cardan_learning.setup import make_arm
from lerobot_robot_cardan.config_cardan import CardanRobotConfig

logger = logging.getLogger(__name__)

LOOK_S = 0.05
"""Period of checks in `connect` for the robot's first state."""


class CardanRobot(Robot):
    """Arm whose session runs at the robot's rate in a separate process. An action is a request; the
    session applies its limits, and brakes without further actions."""

    config_class = CardanRobotConfig
    name = "cardan"

    def __init__(self, config: CardanRobotConfig) -> None:
        """Create the robot without opening it. Raises Cardan's ConfigurationError, a ValueError."""
        self._arm: CartesianArm | None = None
        self._actions: ArmActions | None = None
        super().__init__(config)
        self.config = config
        self.cameras: dict[str, Any] = make_cameras_from_configs(config.cameras)
        self._made = make_arm(
            session=config.session,
            driver=config.driver,
            options=config.options,
            model=config.model,
            mapping=config.mapping,
            gripper=config.gripper,
            limits=config.limits,
            address=config.address,
            network_gripper=config.network_gripper,
            action=config.action,
        )
        self._said = ""

    @property
    def observation_features(self) -> dict[str, type | tuple[int | None, ...]]:
        """Observations by name: joints (rad, m), TCP in the base (m, rotation vector in rad),
        gripper; for cameras the shape of an image."""
        made = self._made
        numbers = dict.fromkeys(observation_names(made.joints, made.gripper), float)
        pictures = {
            name: (camera.height, camera.width, 3) for name, camera in self.config.cameras.items()
        }
        return {**numbers, **pictures}

    @property
    def action_features(self) -> dict[str, type]:
        """Actions by name."""
        return dict.fromkeys(action_names(self._made.kind, self._made.gripper), float)

    @property
    def is_connected(self) -> bool:
        """True if the arm and the cameras are open."""
        opened = all(camera.is_connected for camera in self.cameras.values())
        return self._arm is not None and opened

    @property
    def is_calibrated(self) -> bool:
        """Always True: no calibration is needed."""
        return True

    def connect(self, calibrate: bool = True) -> None:
        """Open the arm and the cameras, without motion. Raises Cardan's errors if they cannot be
        opened, and DeviceNotConnectedError if the robot sends no state in time."""
        if self._arm is not None:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        made = self._made
        arm = made.make()
        arm.open()
        actions = ArmActions(
            arm, made.joints, made.kind, made.mapping, made.gripper, made.reference
        )
        try:
            self._observed(actions, self.config.ready_timeout_s)
            for camera in self.cameras.values():
                camera.connect()
        except BaseException:
            self._close(arm)
            raise
        self._arm, self._actions, self._said = arm, actions, ""

    def _observed(self, actions: ArmActions, timeout_s: float) -> dict[str, float]:
        end_s = time.monotonic() + timeout_s
        while True:
            try:
                return actions.observe()
            except MotionRefusedError as error:
                if time.monotonic() >= end_s:
                    raise DeviceNotConnectedError(f"{self}: {error}") from error
                self._say(str(error))
            except MotionLoopError as error:
                raise DeviceNotConnectedError(f"{self}: {error}") from error
            time.sleep(LOOK_S)

    def _say(self, words: str) -> None:
        """Log a new warning."""
        if words != self._said:
            self._said = words
            if words:
                logger.warning("%s: %s", self.name, words)

    def calibrate(self) -> None:
        """Do nothing: an arm of Cardan needs no calibration."""

    def configure(self) -> None:
        """Do nothing: the configuration has all settings."""

    def get_observation(self) -> dict[str, Any]:
        """Return the present measurement, and each camera's newest image. Waits for a silent robot,
        and raises DeviceNotConnectedError if it stays silent."""
        actions = self._opened()
        observed: dict[str, Any] = dict(self._observed(actions, self.config.silence_timeout_s))
        for name, camera in self.cameras.items():
            observed[name] = camera.async_read()
        return observed

    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Send an action within the arm's limits; return the action really sent. The first action
        begins at the arm's present pose; a far target is approached slowly.

        If nothing can be sent now, the log says why, and the returned action is that of an arm that
        holds. Raises Cardan's CommandError for missing or invalid numbers.
        """
        actions = self._opened()
        try:
            sent = actions.act(action, time.monotonic())
        except (MotionRefusedError, MotionLoopError) as error:
            raise DeviceNotConnectedError(f"{self}: {error}") from error
        self._say(actions.why_not)
        return sent

    def disconnect(self) -> None:
        """Brake to rest, and close the arm and the cameras."""
        self._opened()
        arm, self._arm, self._actions = self._arm, None, None
        assert arm is not None
        self._close(arm)

    def _close(self, arm: CartesianArm) -> None:
        arm.close()
        for camera in self.cameras.values():
            if camera.is_connected:
                camera.disconnect()

    def _opened(self) -> ArmActions:
        if self._actions is None:
            raise DeviceNotConnectedError(f"{self} is not connected: call connect() first.")
        return self._actions
