"""A JR3 driver's core and a simulated sensor on an ideal bus, in virtual time."""

from __future__ import annotations

from collections.abc import Callable

from cardan.types import DeviceState
from cardan_jr3.driver import Jr3Core, Jr3Options
from cardan_jr3.peer import SimulatedJr3
from cardan_jr3.protocol import TEO_SENSORS, CanFrame

NODE_ID = 33
SCALES = TEO_SENSORS["right-hand"]
STEP_S = 0.001


class Bench:
    """Driver core and board. Times are s from power-on; `run` advances in steps of 1 ms."""

    def __init__(
        self, options: Jr3Options | None = None, *, faults: dict[str, float] | None = None, **board
    ) -> None:
        board.setdefault("boot_s", 0.0)
        self.board = SimulatedJr3(NODE_ID, SCALES, faults=faults, **board)
        self.core = Jr3Core(options or Jr3Options())
        self.now_s = 0.0
        self.sent: list[CanFrame] = []
        """Frames sent by the driver."""
        self.states: list[DeviceState] = []
        self.each: Callable[[], None] = lambda: None
        self.mangle: Callable[[CanFrame], CanFrame | None] = lambda frame: frame
        """Modification of the board's frames on the bus; returns None to lose one."""
        self.master_period_s = 0.0
        """Period of a bus master's SYNC; 0: no master."""

    def open(self) -> None:
        self.core.on_opened(self.now_s)

    def run(self, seconds: float) -> DeviceState:
        """Run for `seconds`; return the last state. All are in `states`."""
        self.states.clear()
        for _ in range(round(seconds / STEP_S)):
            self.step()
        return self.states[-1]

    def step(self) -> None:
        self.now_s += STEP_S
        self.each()
        if self.master_period_s:
            every = round(self.master_period_s / STEP_S)
            if round(self.now_s / STEP_S) % every == 0:
                self.board.receive(0x080, b"", self.now_s)
        for frame in self.board.reports(self.now_s):
            arrived = self.mangle(frame)
            if arrived is not None:
                self.core.on_frame(*arrived, self.now_s)
        for frame in self.core.poll(self.now_s):
            self.sent.append(frame)
            self.board.receive(*frame, self.now_s)
        self.states.append(self.core.state(self.now_s))

    def live(self) -> DeviceState:
        """Open the sensor and wait until it is live."""
        self.open()
        return self.run(1.5)
