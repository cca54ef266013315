"""Messages that a standard node publishes for its device, without I/O, in virtual time.

Sources: the nodes' code and documentation. spacenav_node publishes zeros at rest and without a
device; joy_node and game_controller_node repeat the newest state at autorepeat_rate while there is
a device, and nothing without one.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Literal

from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.sim_peers.base import FaultSwitch, TimedActions
from cardan.sim_peers.periodic import PERIODIC_FAULTS, HeldModel, HeldPeriodicDevice

StockNode = Literal["spacenav", "joy_node", "game_controller"]

FAULTS = (
    *PERIODIC_FAULTS,
    FaultSwitch("exit", "the node ends at VALUE s", 3.0),
    FaultSwitch("hang", "the node publishes nothing more from VALUE s on", 3.0),
    FaultSwitch.share("nan", "share of messages with an axis that is not a number"),
)

JOY = "sensor_msgs/msg/Joy"
TOPICS: Mapping[str, str] = {
    "spacenav": "/spacenav/joy",
    "joy_node": "/joy",
    "game_controller": "/joy",
}
PERIODS_S: Mapping[str, float] = {"spacenav": 0.016, "joy_node": 0.05, "game_controller": 0.05}
"""A SpaceMouse reports each 8 to 16 ms; joy_node's autorepeat_rate is 20 Hz."""
BUTTONS: Mapping[str, int] = {"spacenav": 2, "joy_node": 11, "game_controller": 21}

SPACENAV_FULL = 350.0 / 512.0
"""Value that spacenav_node publishes for a full deflection."""


class SimulatedNode(HeldPeriodicDevice[bytes]):
    """A node and its device, which is deflected (-1..1, robot frame)."""

    def __init__(self, node: StockNode, faults: Mapping[str, float], seed: int = 0) -> None:
        super().__init__(PERIODS_S[node], faults, FAULTS)
        self.node = node
        count = BUTTONS[node]
        self.model = HeldModel(node, {number: f"button-{number}" for number in range(count)})
        self.device_there = True
        self._random = random.Random(seed)
        self._nan = faults.get("nan", 0.0)
        self._nodes_faults = TimedActions(faults, {"exit": self.exit, "hang": self.fall_silent})

    # -- device states ----------------------------------------------------------------------------

    def unplug(self) -> None:
        """Remove the device; the node stays."""
        self.device_there = False

    def replug(self) -> None:
        """Plug the device in again."""
        self.device_there = True

    def exit(self) -> None:
        """End the node."""
        self.plugged = False

    # -- messages -------------------------------------------------------------------------------

    def reports(self, now_s: float) -> list[bytes]:
        """Return the messages published from the last call until `now_s`."""
        for _, action in self._nodes_faults.due(now_s):
            action()
        return [report for report in super().reports(now_s) if report]

    def report(self) -> bytes:
        """Return the message published now; empty: none."""
        if not self.device_there and self.node != "spacenav":
            return b""
        x, y, z, roll, pitch, yaw = self.axes if self.device_there else (0.0,) * 6
        if self.node == "spacenav":
            axes = [SPACENAV_FULL * each for each in (x, y, z, roll, pitch, yaw)]
        elif self.node == "joy_node":
            # Left stick, left trigger, right stick, right trigger, directions; triggers rest at 1.
            axes = [y, x, 1.0, yaw, z, 1.0, 0.0, 0.0]
        else:
            axes = [y, x, yaw, z, 0.0, 0.0]
        if self._random.random() < self._nan:
            axes[0] = float("nan")
        labels = self.model.buttons.values()
        message = default_message(JOY)
        message["axes"] = axes
        message["buttons"] = [int(label in self.held) for label in labels]
        return codec_of(JOY).encode(message)
