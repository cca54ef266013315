"""Drivers of ROS 2 device nodes joined to a simulated node in virtual time."""

from __future__ import annotations

import functools

from cardan.drivers.ros2_nodes import JoyCore, Ros2JoyOptions, Ros2SpacenavOptions
from cardan.drivers.ros2_nodes.core import JOY_TYPE
from cardan.sim_peers.ros2_device import SimulatedNode
from tests.drivers.bus_device_bench import BusDeviceBench, key_of, message

KEY = key_of("joy", JOY_TYPE)
received = functools.partial(message, key=KEY)


class Bench(BusDeviceBench):
    def __init__(self, node="spacenav", **options):
        kind = Ros2SpacenavOptions if node == "spacenav" else Ros2JoyOptions
        if node == "game_controller":
            options.setdefault("layout", node)
        core = JoyCore(kind(**options), "touch it once")
        super().__init__(core, SimulatedNode(node, {}), received)

    def touch(self):
        """Deflect and release the device, which proves that it exists."""
        self.run(0.1, (0.0, 0.0, 0.5, 0.0, 0.0, 0.0))
        self.run(0.1, (0.0,) * 6)
