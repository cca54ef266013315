"""Drivers of handheld devices joined to a simulated page in virtual time."""

from __future__ import annotations

from cardan.bus.node import Received
from cardan.drivers.handheld import PhoneOptions, XrOptions
from cardan.drivers.handheld.core import FRAME_TYPE, PhoneCore, XrCore
from cardan.protocols.ros2.names import dds_type
from cardan.protocols.ros2.zenoh import Attachment
from cardan.sim_peers.handheld import SimulatedHandheld
from cardan.sim_peers.handheld.peer import wrapped

KEY = f"0/phone/{dds_type(FRAME_TYPE)}/RIHS01_0"
STEP_S = 0.002


def received(data, sequence=1, sender=1, key=KEY):
    return Received(data, key, Attachment(sequence, 0, bytes([sender]) * 16))


class Bench:
    """Page whose frames reach the core at once; `mangle` may corrupt them."""

    def __init__(self, kind="phone", faults=(), **options):
        self.core = (
            PhoneCore(PhoneOptions(**options)) if kind == "phone" else XrCore(XrOptions(**options))
        )
        self.device = SimulatedHandheld(kind, dict(faults))
        self.now_s = 0.0
        self.sequence = 0
        self.sender = 1
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
            self.now_s += STEP_S
            for frame in self.device.reports(self.now_s):
                self.sequence += 1
                data = self.mangle(wrapped(frame, self.device.age_s))
                if data is not None:
                    made = received(data, self.sequence, self.sender)
                    self.core.on_received(made, self.now_s)
        return self

    def live(self):
        """Run until the device is aligned, its dead-man released."""
        self.run(0.3)
        return self

    def held(self, axes=None):
        """Hold the dead-man, then deflect the axes."""
        self.live()
        self.device.press("hold")
        self.run(0.1)
        return self.run(0.1, axes)
