"""The URScript functions that the simulated controller has."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from cardan.protocols.ur.variables import REGISTERS
from cardan.sim_peers.ur_controller.actions import Wait
from cardan.sim_peers.ur_controller.interpreter import Function
from cardan.sim_peers.ur_controller.io import Registers


def functions(
    registers: Registers, period_s: float, say: Callable[[str], None]
) -> Mapping[str, Function]:
    """By name. `say` takes what a program prints."""

    def write_int(address: Any, value: Any) -> None:
        if isinstance(value, bool) or not isinstance(value, int):
            raise ValueError(f"{value!r} is not a whole number")
        registers.output_int[_address(address)] = ((value + 2**31) % 2**32) - 2**31

    def write_float(address: Any, value: Any) -> None:
        registers.output_double[_address(address)] = _number("value", value)

    def printed(*values: Any) -> None:
        say("".join(str(value) for value in values if value != ""))

    return {
        "read_input_integer_register": Function(
            ("address",), {}, lambda address: registers.input_int[_address(address)]
        ),
        "read_input_float_register": Function(
            ("address",), {}, lambda address: registers.input_double[_address(address)]
        ),
        "write_output_integer_register": Function(("address", "value"), {}, write_int),
        "write_output_float_register": Function(("address", "value"), {}, write_float),
        "get_steptime": Function((), {}, lambda: period_s),
        "norm": Function(("a",), {}, _norm),
        "textmsg": Function(("s1", "s2"), {"s2": ""}, printed),
        "sleep": Function(("t",), {}, lambda t: Wait(_time(t)), takes_time=True),
        "sync": Function((), {}, lambda: Wait(period_s), takes_time=True),
    }


def _address(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < REGISTERS:
        raise ValueError(f"there is no register {value!r}; there are 0 to {REGISTERS - 1}")
    return value


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError(f"{name} is {value!r}, which is no number")
    return float(value)


def _time(value: Any) -> float:
    if _number("t", value) < 0.0:
        raise ValueError(f"t is {value!r}, which is below 0")
    return float(value)


def _norm(value: Any) -> float:
    if isinstance(value, list):
        return math.hypot(*(_number("a", each) for each in value))
    return abs(_number("a", value))
