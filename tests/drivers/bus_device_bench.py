"""Cores of devices on the bus, joined to simulated ones in virtual time."""

from __future__ import annotations

from cardan.bus.node import Received
from cardan.protocols.ros2.names import dds_type
from cardan.protocols.ros2.zenoh import Attachment

STEP_S = 0.002


def key_of(topic, kind):
    """Return the key of a topic's messages of that type."""
    return f"0/{topic}/{dds_type(kind)}/RIHS01_0"


def message(data, sequence=1, sender=1, key=""):
    """Return a message in the bus's form."""
    return Received(data, key, Attachment(sequence, 0, bytes([sender]) * 16))


class BusDeviceBench:
    """Device whose messages reach the core every few milliseconds; `mangle` may corrupt them."""

    def __init__(self, core, device, received):
        self.core = core
        self.device = device
        self._received = received
        self.now_s = 0.0
        self.sequence = 0
        self.sender = 1
        self.mangle = lambda data: data
        self.core.on_opened(0.0)

    @property
    def state(self):
        return self.core.state(self.now_s)

    def packed(self, report):
        """Return a report of the device as the data of a message."""
        return report

    def run(self, seconds, axes=None):
        if axes is not None:
            self.device.set_axes(axes)
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            self.now_s += STEP_S
            for report in self.device.reports(self.now_s):
                self.sequence += 1
                data = self.mangle(self.packed(report))
                if data is not None:
                    made = self._received(data, self.sequence, self.sender)
                    self.core.on_received(made, self.now_s)
        return self
