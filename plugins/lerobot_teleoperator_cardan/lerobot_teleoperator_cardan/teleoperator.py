"""LeRobot's teleoperator class for Cardan's devices."""

import logging
import time
from typing import Any

from lerobot.teleoperators import Teleoperator
from lerobot.teleoperators.utils import TeleopEvents
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from cardan.types import DeviceFeedback
from cardan_learning.device_actions import EventButtons
from cardan_learning.features import action_names
from cardan_learning.setup import make_device
from lerobot_teleoperator_cardan.config_cardan import CardanTeleopConfig

logger = logging.getLogger(__name__)


class CardanTeleop(Teleoperator):
    """Hand-held device. The action is zero motion while no clutch is held or the device is lost:
    the rules of the dead-man switch are those of Cardan's sessions."""

    config_class = CardanTeleopConfig
    name = "cardan"

    def __init__(self, config: CardanTeleopConfig) -> None:
        """Create the teleoperator without opening it. Raises Cardan's ConfigurationError, a
        ValueError."""
        self._connected = False
        super().__init__(config)
        self.config = config
        self._device, self._actions = make_device(
            session=config.session,
            driver=config.driver,
            options=config.options,
            mapping=config.mapping,
            gripper=config.gripper,
            action=config.action,
            buttons=EventButtons(
                config.success_button, config.failure_button, config.rerecord_button
            ),
        )
        self._said = ""

    @property
    def action_features(self) -> dict[str, type]:
        """Actions by name, always with the gripper's."""
        return dict.fromkeys(action_names(self._actions.kind, gripper=True), float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """Feedback that the device supports, of: "rumble" (0 to 1), "led" (0 or 1)."""
        able = self._device.capabilities.feedback
        return {name: float for name in ("rumble", "led") if name in able}

    @property
    def is_connected(self) -> bool:
        """True if the device is open, even if it is unplugged; its action is then zero motion."""
        return self._connected

    @property
    def is_calibrated(self) -> bool:
        """Always True: no calibration is needed."""
        return True

    def connect(self, calibrate: bool = True) -> None:
        """Open the device. Raises Cardan's DriverError if there is none."""
        if self._connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        self._device.open()
        self._connected = True
        self._said = ""

    def calibrate(self) -> None:
        """Do nothing: a device of Cardan needs no calibration."""

    def configure(self) -> None:
        """Do nothing: the configuration has all settings."""

    def get_action(self) -> dict[str, float]:
        """Return the operator's present action."""
        self._update()
        return self._actions.action()

    def get_teleop_events(self) -> dict[TeleopEvents, bool]:
        """Return whether the operator intervenes, and the episode's button events since the last
        call."""
        if not self._connected:
            return dict.fromkeys(
                (
                    TeleopEvents.IS_INTERVENTION,
                    TeleopEvents.TERMINATE_EPISODE,
                    TeleopEvents.SUCCESS,
                    TeleopEvents.RERECORD_EPISODE,
                ),
                False,
            )
        self._update()
        reported = self._actions.events()
        return {
            TeleopEvents.IS_INTERVENTION: reported.intervenes,
            TeleopEvents.TERMINATE_EPISODE: reported.ends,
            TeleopEvents.SUCCESS: reported.succeeded,
            TeleopEvents.RERECORD_EPISODE: reported.again,
        }

    def _update(self) -> None:
        self._require_connected()
        events = self._device.button_events()
        self._actions.update(self._device.state(), events, time.monotonic())
        if (advice := self._actions.advice()) != self._said:
            self._said = advice
            if advice:
                logger.info("%s: %s", self.name, advice)

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Send the feedback of `feedback_features` to the device. Raises Cardan's CommandError for
        feedback that the device does not support."""
        self._require_connected()
        rumble, led = feedback.get("rumble"), feedback.get("led")
        self._device.feedback(
            DeviceFeedback(
                led=None if led is None else float(led) >= 0.5,
                rumble=None if rumble is None else min(max(float(rumble), 0.0), 1.0),
            )
        )

    def disconnect(self) -> None:
        """Close the device."""
        self._require_connected()
        self._connected = False
        self._device.close()

    def _require_connected(self) -> None:
        if not self._connected:
            raise DeviceNotConnectedError(f"{self} is not connected: call connect() first.")
