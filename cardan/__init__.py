"""Teleoperation of robot arms from any hand-held device.

Drivers (:mod:`cardan.drivers`) can be used alone; :mod:`cardan.gateway` joins a device to a
robot; :mod:`cardan.sim_peers` stands in for every piece of hardware at the level of the wire.
"""

__version__ = "0.1.0"
