"""Simulated operator with a simulated device that follows the instructions of `cardan conform`."""

import math
import queue

from cardan.conform.hands import KEYS, PUSHES

AGAIN = "Push the cap once more."
STEPS = {how: name for name, how in (*PUSHES, *KEYS)}
STEPS[AGAIN] = "push"
RIGHT, CLOCKWISE = (0.0, -0.5, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, -1.0)
REST = (0.0,) * 6


class ScriptedOperator:
    """Operator that executes each instruction."""

    def __init__(self, more=()):
        """`more`: further instructions of a suite, each with its step and words."""
        self.instructions = queue.SimpleQueue()
        self._steps = STEPS | {how: name for name, how in more}

    @property
    def next_due_s(self):
        return math.inf if self.instructions.empty() else 0.0

    def advance(self, now_s, device):
        while not self.instructions.empty():
            what = self._steps.get(self.instructions.get(), "let-go")
            if what == "twist":
                device.set_axes(CLOCKWISE)
            elif what == "let-go":
                device.set_axes(REST)
            elif what not in ("press", "release"):
                device.set_axes(RIGHT)
            if what in ("press", "masked"):
                device.press(device.model.buttons[0])
            elif what in ("release", "let-go"):
                device.release(device.model.buttons[0])
