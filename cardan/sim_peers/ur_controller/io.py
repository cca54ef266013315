"""Inputs, outputs and registers of the simulated controller."""

from __future__ import annotations

from typing import Final

from cardan.protocols.ur.variables import REGISTERS

BITS: Final = 128
"""Boolean registers."""
FLAGS: Final = 33
PLACES: Final = {"standard": (0, 8), "configurable": (8, 8), "tool": (16, 2)}
"""Bits of digital inputs and outputs: first bit and count."""


class Registers:
    """The registers between RTDE and programs."""

    def __init__(self) -> None:
        self.input_int = [0] * REGISTERS
        self.input_double = [0.0] * REGISTERS
        self.input_bit = [False] * BITS
        self.output_int = [0] * REGISTERS
        self.output_double = [0.0] * REGISTERS
        self.output_bit = [False] * BITS


class RobotIo:
    """Digital inputs and outputs as bits: standard 0 to 7, configurable 8 to 15, tool 16, 17."""

    def __init__(self) -> None:
        self.digital_inputs = 0
        self.digital_outputs = 0
        self.analog_inputs = [0.0, 0.0]
        """Fractions of the ranges, like all analog values."""
        self.tool_analog_inputs = [0.0, 0.0]
        self.analog_outputs = [0.0, 0.0]
        self.analog_input_domains = [0, 0]
        """0: current, 1: voltage."""
        self.tool_analog_input_domains = [0, 0]
        self.analog_output_domains = [0, 0]
        self.tool_voltage = 0
        self.flags = [False] * FLAGS

    def set_digital_output(self, place: int, on: bool) -> None:
        """Set a bit of the outputs."""
        self.digital_outputs = (self.digital_outputs & ~(1 << place)) | (int(on) << place)
