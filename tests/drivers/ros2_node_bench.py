"""Drivers of ROS 2 device nodes joined to a simulated node in virtual time."""

from __future__ import annotations

from cardan.bus.node import Received
from cardan.drivers.ros2_nodes import JoyCore, Ros2JoyOptions, Ros2SpacenavOptions
from cardan.drivers.ros2_nodes.core import JOY_TYPE
from cardan.protocols.ros2.names import dds_type
from cardan.protocols.ros2.zenoh import Attachment
from cardan.sim_peers.ros2_device import SimulatedNode

KEY = f"0/joy/{dds_type(JOY_TYPE)}/RIHS01_0"


def received(data, sequence=1, sender=1, key=KEY):
    return Received(data, key, Attachment(sequence, 0, bytes([sender]) * 16))


class Bench:
    """Node whose messages reach the core every few milliseconds; `mangle` may corrupt them."""

    def __init__(self, node="spacenav", **options):
        kind = Ros2SpacenavOptions if node == "spacenav" else Ros2JoyOptions
        if node == "game_controller":
            options.setdefault("layout", node)
        self.core = JoyCore(kind(**options), "touch it once")
        self.device = SimulatedNode(node, {})
        self.now_s = 0.0
        self.sequence = 0
        self.mangle = lambda data: data
        self.core.on_opened(0.0)

    @property
    def state(self):
        return self.core.state(self.now_s)

    def run(self, seconds, axes=None):
        if axes is not None:
            self.device.set_axes(axes)
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            self.now_s += 0.002
            for data in self.device.reports(self.now_s):
                self.sequence += 1
                data = self.mangle(data)
                if data is not None:
                    self.core.on_received(received(data, self.sequence), self.now_s)

    def touch(self):
        """Deflect and release the device, which proves that it exists."""
        self.run(0.1, (0.0, 0.0, 0.5, 0.0, 0.0, 0.0))
        self.run(0.1, (0.0,) * 6)
