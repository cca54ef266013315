"""The driver's core with the compiled tick, in virtual time: no library and no thread."""

from cardan.common.haptics import Calibration
from cardan.types import ZERO3, DeviceLink, Vector3
from cardan_omni.driver.core import Identity, OmniCore
from cardan_omni.driver.options import OmniOptions
from cardan_omni.driver.tick import Tick
from cardan_omni.driver.values import StylusSample

TICK_S = 0.001
LOOK_S = 0.01

TOUCH = Identity(
    model="Touch",
    max_force_n=3.3,
    continuous_force_n=0.88,
    input_dof=6,
    output_dof=3,
    calibration_styles=4,
)


class Bench:
    """A stylus at a fixed position, ticked every 1 ms and read by the driver every 10 ms."""

    def __init__(self, options=None, identity=TOUCH):
        self.core = OmniCore(options or OmniOptions())
        self.tick = Tick((options or OmniOptions()).limits())
        self.now_s = 0.0
        self.position = ZERO3
        self.buttons = 0
        self.inkwell = False
        self.temperature = 0.0
        self.answer = Calibration.OK
        self.ticking = True
        self.every = 1
        """Period of the ticks, ms."""
        self.updates = 0
        self.core.on_opened(identity, self.now_s)

    def run(self, seconds):
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            if self.ticking and round(self.now_s / TICK_S) % self.every == 0:
                self.tick.step(
                    StylusSample(
                        self.now_s,
                        Vector3(*self.position),
                        buttons=self.buttons,
                        inkwell=self.inkwell,
                        temperature=self.temperature,
                        calibrated=self.answer is Calibration.OK,
                    )
                )
            if round(self.now_s / TICK_S) % round(LOOK_S / TICK_S) == 0:
                self.look()

    def look(self):
        snapshot = self.tick.snapshot()._replace(calibration=self.answer)
        self.core.on_snapshot(snapshot, self.now_s)
        self.updates += self.core.take_update()

    def live(self):
        self.run(0.3)
        assert self.state.link is DeviceLink.LIVE, self.state.reason
        return self

    def click(self, button, times=1):
        """Press and release a button as fast as the debounce allows, also during a reading."""
        for _ in range(times):
            self.buttons |= button
            self.run(0.027)
            self.buttons &= ~button
            self.run(0.027)

    @property
    def state(self):
        return self.core.state(self.now_s)
