"""URScript's functions of registers, inputs and outputs, messages, time and the watchdog.

Source: UR's script manual, modules internals and interfaces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from cardan.protocols.ur.variables import INPUTS, REGISTERS
from cardan.sim_peers.ur_controller.checks import number, truth, whole, words
from cardan.sim_peers.ur_controller.io import BITS, FLAGS, PLACES, Registers, RobotIo
from cardan.sim_peers.ur_controller.language import Action, Function, Pending, Sleep
from cardan.sim_peers.ur_controller.operators import struct, text
from cardan.sim_peers.ur_controller.popups import Popups
from cardan.sim_peers.ur_controller.watchdogs import ACTIONS, RtdeWatchdogs

_TOOL_VOLTAGES: Final = (0, 12, 24)
_DIGITAL: Final = 10
"""Inputs or outputs of the functions without a place: standard, then tool."""


def register_functions(registers: Registers) -> Mapping[str, Function]:
    """Return the functions by name."""
    found = {}
    for kind, suffix in (("integer", "int"), ("float", "double"), ("boolean", "bit")):
        for way in ("input", "output"):
            values = getattr(registers, f"{way}_{suffix}")
            found[f"read_{way}_{kind}_register"] = Function(
                ("address",), {}, _reader(registers, f"{way}_{suffix}", len(values))
            )
        found[f"write_output_{kind}_register"] = Function(
            ("address", "value"), {}, _writer(registers, f"output_{suffix}", kind)
        )
    return found


def _reader(registers: Registers, name: str, count: int) -> Callable[[Any], Any]:
    return lambda address: getattr(registers, name)[_address(address, count)]


def _writer(registers: Registers, name: str, kind: str) -> Callable[[Any, Any], None]:
    count = BITS if kind == "boolean" else REGISTERS

    def write(address: Any, value: Any) -> None:
        written: Any
        if kind == "integer":
            if isinstance(value, bool) or not isinstance(value, int):
                raise ValueError(f"{text(value)} is not a whole number")
            written = ((value + 2**31) % 2**32) - 2**31
        elif kind == "float":
            written = number("value", value)
        else:
            written = truth("value", value)
        getattr(registers, name)[_address(address, count)] = written

    return write


def _address(value: Any, count: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        raise ValueError(f"there is no register {text(value)}; there are 0 to {count - 1}")
    return value


def io_functions(io: RobotIo) -> Mapping[str, Function]:
    """Return the functions by name."""
    found = {}
    for place, (first, count) in PLACES.items():
        found[f"get_{place}_digital_in"] = _digital_in(io, first, count)
        found[f"get_{place}_digital_out"] = _digital_out(io, first, count)
        found[f"set_{place}_digital_out"] = _set_digital_out(io, first, count)

    def bit(n: Any) -> int:
        """Return the bit for one of the functions without a place."""
        at = whole("n", n, 0, _DIGITAL - 1)
        return at if at < PLACES["standard"][1] else at - PLACES["standard"][1] + PLACES["tool"][0]

    def set_digital(n: Any, b: Any) -> None:
        io.set_digital_output(bit(n), truth("b", b))

    def set_analog(n: Any, f: Any) -> None:
        io.analog_outputs[whole("n", n, 0, 1)] = min(max(number("f", f), 0.0), 1.0)

    def set_tool_voltage(voltage: Any) -> None:
        if voltage not in _TOOL_VOLTAGES:
            raise ValueError(f"{text(voltage)} V is not 0, 12 or 24 V")
        io.tool_voltage = int(voltage)

    def set_flag(n: Any, b: Any) -> None:
        io.flags[whole("n", n, 0, FLAGS - 1)] = truth("b", b)

    analog_in = Function(("n",), {}, lambda n: io.analog_inputs[whole("n", n, 0, 1)])
    analog_out = Function(("n",), {}, lambda n: io.analog_outputs[whole("n", n, 0, 1)])
    return {
        **found,
        "get_digital_in": Function(("n",), {}, lambda n: bool(io.digital_inputs >> bit(n) & 1)),
        "get_digital_out": Function(("n",), {}, lambda n: bool(io.digital_outputs >> bit(n) & 1)),
        "set_digital_out": Function(("n", "b"), {}, set_digital),
        "get_analog_in": analog_in,
        "get_standard_analog_in": analog_in,
        "get_tool_analog_in": Function(
            ("n",), {}, lambda n: io.tool_analog_inputs[whole("n", n, 0, 1)]
        ),
        "get_analog_out": analog_out,
        "get_standard_analog_out": analog_out,
        "set_analog_out": Function(("n", "f"), {}, set_analog),
        "set_standard_analog_out": Function(("n", "f"), {}, set_analog),
        "set_standard_analog_input_domain": _domains(io, "analog_input_domains"),
        "set_tool_analog_input_domain": _domains(io, "tool_analog_input_domains"),
        "set_analog_outputdomain": _domains(io, "analog_output_domains"),
        "set_tool_voltage": Function(("voltage",), {}, set_tool_voltage),
        "get_flag": Function(("n",), {}, lambda n: io.flags[whole("n", n, 0, FLAGS - 1)]),
        "set_flag": Function(("n", "b"), {}, set_flag),
    }


def _digital_in(io: RobotIo, first: int, count: int) -> Function:
    return Function(
        ("n",),
        {},
        lambda n: bool(io.digital_inputs >> first + whole("n", n, 0, count - 1) & 1),
    )


def _digital_out(io: RobotIo, first: int, count: int) -> Function:
    return Function(
        ("n",),
        {},
        lambda n: bool(io.digital_outputs >> first + whole("n", n, 0, count - 1) & 1),
    )


def _set_digital_out(io: RobotIo, first: int, count: int) -> Function:
    return Function(
        ("n", "b"),
        {},
        lambda n, b: io.set_digital_output(first + whole("n", n, 0, count - 1), truth("b", b)),
    )


def _domains(io: RobotIo, name: str) -> Function:
    def put(port: Any, domain: Any) -> None:
        getattr(io, name)[whole("port", port, 0, 1)] = whole("domain", domain, 0, 1)

    return Function(("port", "domain"), {}, put)


def message_functions(
    say: Callable[[str], None],
    popups: Popups,
    watchdogs: RtdeWatchdogs,
    period_s: float,
    time_s: Callable[[], float],
) -> Mapping[str, Function]:
    """Return the functions by name. `say` takes the output of a program."""

    def popup(s: Any, title: Any, warning: Any, error: Any, blocking: Any) -> Action | None:
        kind = (truth("warning", warning), truth("error", error), truth("blocking", blocking))
        number_of_it = popups.show(text(s), words("title", title), *kind)
        if not blocking:
            return None
        return Pending(lambda: True if popups.closed(number_of_it) else None)

    def time(mode: Any) -> Any:
        whole("mode", mode, 0, 1)
        now_s = time_s()
        return struct({"sec": int(now_s), "nanosec": int(now_s % 1.0 * 1e9)})

    def watch(variable: Any, frequency: Any, action: Any) -> None:
        if words("variable_name", variable) not in INPUTS:
            raise ValueError(f"RTDE has no input {variable}")
        if action not in ACTIONS:
            raise ValueError(f"{text(action)} is not one of {', '.join(ACTIONS)}")
        if number("min_frequency", frequency) <= 0.0:
            raise ValueError("min_frequency is not above 0")
        watchdogs.add(variable, 1.0 / frequency, action, time_s())

    return {
        "textmsg": Function(("s1", "s2"), {"s2": ""}, lambda s1, s2: say(text(s1) + text(s2))),
        "popup": Function(
            ("s", "title", "warning", "error", "blocking"),
            {"title": "Popup", "warning": False, "error": False, "blocking": False},
            popup,
            takes_time=True,
        ),
        "time": Function(("mode",), {"mode": 0}, time),
        "get_steptime": Function((), {}, lambda: period_s),
        "sleep": Function(("t",), {}, lambda t: Sleep(_time(t)), takes_time=True),
        "sync": Function((), {}, lambda: Sleep(period_s), takes_time=True),
        "rtde_set_watchdog": Function(
            ("variable_name", "min_frequency", "action"), {"action": "pause"}, watch
        ),
    }


def _time(value: Any) -> float:
    if number("t", value) < 0.0:
        raise ValueError(f"t is {text(value)}, which is below 0")
    return float(value)
