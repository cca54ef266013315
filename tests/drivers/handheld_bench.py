"""Drivers of handheld devices joined to a simulated page in virtual time."""

from __future__ import annotations

import functools

from cardan.drivers.handheld import PhoneOptions, XrOptions
from cardan.drivers.handheld.core import FRAME_TYPE, PhoneCore, XrCore
from cardan.sim_peers.handheld import SimulatedHandheld
from cardan.sim_peers.handheld.peer import wrapped
from tests.drivers.bus_device_bench import BusDeviceBench, key_of, message

KEY = key_of("phone", FRAME_TYPE)
received = functools.partial(message, key=KEY)


class Bench(BusDeviceBench):
    """Page whose frames reach the core at once."""

    def __init__(self, kind="phone", faults=(), **options):
        core = (
            PhoneCore(PhoneOptions(**options)) if kind == "phone" else XrCore(XrOptions(**options))
        )
        super().__init__(core, SimulatedHandheld(kind, dict(faults)), received)

    def packed(self, report):
        return wrapped(report, self.device.age_s)

    def live(self):
        """Run until the device is aligned, its dead-man released."""
        return self.run(0.3)

    def held(self, axes=None):
        """Hold the dead-man, then deflect the axes."""
        self.live()
        self.device.press("hold")
        self.run(0.1)
        return self.run(0.1, axes)
