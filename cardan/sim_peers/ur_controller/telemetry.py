"""Values of the simulated controller over RTDE, by the names of the variables."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, Generic, NamedTuple, TypeVar

from cardan.protocols.ur.states import (
    MOVES_IN,
    RobotMode,
    RuntimeState,
    SafetyBit,
    SafetyMode,
    StatusBit,
)
from cardan.protocols.ur.variables import (
    BIT_REGISTERS,
    INPUT_VARIABLES,
    OUTPUT_VARIABLES,
    REGISTERS,
    UPPER_BIT_REGISTERS,
    of_series,
)
from cardan.sim_peers.kinematics import Frames, forward, jacobian
from cardan.sim_peers.ur_controller.checks import LARGEST
from cardan.sim_peers.ur_controller.controller import UrController
from cardan.sim_peers.ur_controller.dynamics import Effort
from cardan.sim_peers.ur_controller.kinematics import pose_of
from cardan.sim_peers.ur_controller.motion import HARDEST_N, ArmMotion
from cardan.spatial import add, compose, conjugate, cross, rotate, scale, subtract
from cardan.types import Pose as Frame, Vector3

Source = Callable[[], Any]

_NOTHING: Final[Mapping[str, Any]] = {
    "VECTOR6D": (0.0,) * 6,
    "VECTOR3D": (0.0,) * 3,
    "VECTOR6INT32": (0,) * 6,
    "DOUBLE": 0.0,
    "BOOL": False,
}
_RUNNING: Final = 253
_IDLE: Final = 255
_OFF: Final = 239
"""Mode of a joint, and of the tool."""

_NEWTON_METERS_PER_A: Final = (10.5, 10.5, 10.5, 8.4, 8.4, 8.4)
"""Torque constant of each joint, behind its gear."""
_WINDING_OHM: Final = 0.5
_IDLE_A: Final = 0.4
_BUS_V: Final = 48.0
_CURRENT_WINDOW_A: Final = (3.0, 3.0, 3.0, 1.5, 1.5, 1.5)
_FARTHEST_RAD: Final = 0.2
"""Distance from the target at `joint_position_deviation_ratio` 1."""
_JOINT_DEGREES: Final = 28.0
_TOOL_DEGREES: Final = 30.0
_EXECUTION_MS: Final = 0.4
_HIGHEST_V: Final = 10.0
_LOWEST_MA, _RANGE_MA = 4.0, 16.0

_SAFETY_BITS: Final[Mapping[SafetyMode, SafetyBit]] = {
    SafetyMode.NORMAL: SafetyBit.NORMAL,
    SafetyMode.REDUCED: SafetyBit.REDUCED,
    SafetyMode.PROTECTIVE_STOP: SafetyBit.PROTECTIVE_STOP,
    SafetyMode.SAFEGUARD_STOP: SafetyBit.SAFEGUARD_STOP,
    SafetyMode.ROBOT_EMERGENCY_STOP: SafetyBit.ROBOT_EMERGENCY_STOP | SafetyBit.EMERGENCY_STOP,
}

Value = TypeVar("Value")


class _Retained(Generic[Value]):
    """Value that is computed on demand, at most once per frame."""

    def __init__(self, motion: ArmMotion, compute: Callable[[], Value]) -> None:
        self._motion, self._compute = motion, compute
        self._of: tuple[int, Frame] | None = None
        self._value: Value

    def __call__(self) -> Value:
        now = (self._motion.steps, self._motion.tcp)
        if now != self._of:
            self._of, self._value = now, self._compute()
        return self._value


class _Place(NamedTuple):
    """The arm's frames, and its TCP."""

    frames: Frames
    tcp: Frame


class Telemetry:
    """Values of variables, readable and writable."""

    def __init__(self, controller: UrController) -> None:
        options = controller.options
        self._controller, self._motion, self._io = controller, controller.motion, controller.io
        self.outputs: Mapping[str, str] = of_series(OUTPUT_VARIABLES, options.version.major)
        """Types of the output variables, by name."""
        self.writable: Mapping[str, str] = of_series(INPUT_VARIABLES, options.version.major)
        """Types of the variables that clients may write, by name."""
        self._dynamics = controller.dynamics
        motion = self._motion
        self._actual = _Retained(motion, lambda: self._place(motion.actual_q))
        self._target = _Retained(motion, lambda: self._place(motion.target_q))
        self._actual_effort = _Retained(
            motion, lambda: self._effort(motion.actual_q, motion.actual_qd, motion.actual_qdd)
        )
        self._target_effort = _Retained(
            motion, lambda: self._effort(motion.target_q, motion.target_qd, motion.target_qdd)
        )
        self._actual_torques = _Retained(motion, self._measured_torques)
        sources = {
            **self._of_controller(),
            **self._of_motion(),
            **self._of_effort(),
            **self._of_io(),
            **self._of_registers(),
        }
        self._sources: dict[str, Source] = {
            name: sources.get(name) or _constant(_NOTHING.get(kind, 0))
            for name, kind in self.outputs.items()
        }
        self._written: dict[str, Any] = {}
        """Last written inputs that are not registers."""
        self._setters = self._register_setters()

    def value(self, name: str) -> Any:
        """Return the present value of a variable in `outputs`; 0 if this robot does not have it."""
        return self._sources[name]()

    # -- written by clients -----------------------------------------------------------------------

    def write(self, values: Mapping[str, Any]) -> None:
        """Write the values of a client's data package."""
        self._controller.watchdogs.fed(values, self._controller.time_s)
        others = False
        for name, value in values.items():
            setter = self._setters.get(name)
            if setter is not None:
                setter(value)
            else:
                self._written[name], others = value, True
        if others:
            self._apply(values)

    def _apply(self, values: Mapping[str, Any]) -> None:
        """Apply written inputs. They keep their values: a mask may arrive in another package."""
        written, io = self._written.get, self._io
        if _any_of(values, "speed_slider") and written("speed_slider_mask", 0) & 1:
            fraction = written("speed_slider_fraction")
            self._controller.slider = _share(fraction, self._controller.slider)
        for kind, shift in (("standard", 0), ("configurable", 8), ("tool", 16)):
            if _any_of(values, f"{kind}_digital_output"):
                mask = written(f"{kind}_digital_output_mask", 0) << shift
                wanted = written(f"{kind}_digital_output", 0) << shift
                io.digital_outputs = (io.digital_outputs & ~mask) | (wanted & mask)
        if _any_of(values, "standard_analog_output"):
            mask = written("standard_analog_output_mask", 0)
            domains = written("standard_analog_output_type", 0)
            for number in range(len(io.analog_outputs)):
                if mask >> number & 1:
                    ratio = written(f"standard_analog_output_{number}")
                    io.analog_outputs[number] = _share(ratio, io.analog_outputs[number])
                    io.analog_output_domains[number] = domains >> number & 1

        sensed = values.get("external_force_torque")
        if sensed is not None and all(abs(each) <= LARGEST for each in sensed):
            self._motion.sensed = tuple(sensed)

    def _register_setters(self) -> dict[str, Callable[[Any], None]]:
        registers = self._controller.registers

        def bits(first: int) -> Callable[[Any], None]:
            def put(value: int) -> None:
                registers.input_bit[first : first + 32] = [
                    bool(value >> number & 1) for number in range(32)
                ]

            return put

        return {
            **{
                f"input_{kind}_register_{number}": partial(
                    getattr(registers, f"input_{kind}").__setitem__, number
                )
                for kind, numbers in _NUMBERS.items()
                for number in numbers
            },
            **{name: bits(first) for name, first in _groups("input")},
        }

    # -- values -----------------------------------------------------------------------------------

    def _of_controller(self) -> dict[str, Source]:
        controller, motion = self._controller, self._motion

        def powered(value: float) -> Source:
            return lambda: value if controller.mode >= RobotMode.POWER_ON else 0.0

        playing = RuntimeState.PLAYING
        return {
            "timestamp": lambda: controller.time_s,
            "control_step": lambda: controller.frames,
            "actual_execution_time": _constant(_EXECUTION_MS),
            "target_execution_time": _constant(controller.period_s * 1e3),
            "robot_mode": lambda: controller.mode,
            "safety_mode": lambda: controller.safety,
            "safety_status": lambda: controller.safety,
            "runtime_state": self._runtime,
            "robot_status_bits": self._status_bits,
            "safety_status_bits": self._safety_bits,
            "joint_mode": self._joint_modes,
            "script_control_line": lambda: controller.script_line,
            "speed_scaling": lambda: 1.0 if controller.runtime is playing else 0.0,
            "time_scale_source": lambda: int(controller.runtime is playing),
            "target_speed_fraction": lambda: controller.slider,
            "actual_main_voltage": _constant(_BUS_V),
            "actual_robot_voltage": powered(_BUS_V),
            "actual_joint_voltage": lambda: (powered(_BUS_V)(),) * 6,
            "joint_temperatures": _constant((_JOINT_DEGREES,) * 6),
            "tool_temperature": _constant(_TOOL_DEGREES),
            "tool_mode": lambda: _RUNNING if controller.mode >= RobotMode.POWER_ON else _IDLE,
            "payload": lambda: motion.payload.mass,
            "payload_cog": lambda: motion.payload.cog,
            "payload_inertia": lambda: motion.payload.inertia,
            "tcp_offset": lambda: motion.tcp_offset,
            "target_gravity": lambda: motion.gravity,
        }

    def _of_motion(self) -> dict[str, Source]:
        motion, actual, target = self._motion, self._actual, self._target
        return {
            "target_q": lambda: motion.target_q,
            "target_qd": lambda: motion.target_qd,
            "target_qdd": lambda: motion.target_qdd,
            "actual_q": lambda: motion.actual_q,
            "actual_qd": lambda: motion.actual_qd,
            "actual_TCP_pose": lambda: pose_of(actual().tcp),
            "target_TCP_pose": lambda: pose_of(target().tcp),
            "actual_TCP_speed": lambda: _speed(actual(), motion.actual_qd),
            "target_TCP_speed": lambda: _speed(target(), motion.target_qd),
            "actual_TCP_acceleration": lambda: self._acceleration(
                actual().frames, self._actual_effort()
            ),
            "target_TCP_acceleration": lambda: self._acceleration(
                target().frames, self._target_effort()
            ),
            "elbow_position": lambda: actual().frames.origins[2],
            "elbow_velocity": self._elbow_velocity,
            "actual_TCP_force": motion.tcp_force,
            "wrench_calc_from_currents": motion.contact_force,
            "tcp_force_scalar": lambda: math.hypot(*motion.tcp_force()[:3]),
            "ft_raw_wrench": self._raw_wrench,
            "joint_position_deviation_ratio": self._deviation,
            "collision_detection_ratio": lambda: motion.pushed() / HARDEST_N,
        }

    def _of_effort(self) -> dict[str, Source]:
        torques = self._actual_torques
        currents = _Retained(self._motion, lambda: _currents(torques()))
        return {
            "target_moment": self._target_torques,
            "target_current": lambda: _currents(self._target_torques()),
            "actual_current": currents,
            "joint_control_output": currents,
            "actual_current_as_torque": torques,
            "actual_current_window": _constant(_CURRENT_WINDOW_A),
            "actual_robot_current": lambda: self._robot_current(currents()),
            "actual_momentum": lambda: self._actual_effort().momentum,
            "actual_tool_accelerometer": lambda: self._actual_effort().acceleration,
            "target_base_wrench": self._base_wrench,
        }

    def _of_io(self) -> dict[str, Source]:
        io = self._io

        def analog(kind: str, domain: str, number: int) -> Source:
            return lambda: _signal(getattr(io, kind)[number], getattr(io, domain)[number])

        return {
            "actual_digital_input_bits": lambda: io.digital_inputs,
            "actual_digital_output_bits": lambda: io.digital_outputs,
            "actual_configurable_digital_input_bits": lambda: io.digital_inputs >> 8 & 0xFF,
            "actual_configurable_digital_output_bits": lambda: io.digital_outputs >> 8 & 0xFF,
            "analog_io_types": lambda: _bits((*io.analog_input_domains, *io.analog_output_domains)),
            "tool_analog_input_types": lambda: _bits(io.tool_analog_input_domains),
            "tool_output_voltage": lambda: io.tool_voltage,
            **{
                f"{name}{number}": analog(f"{kind}s", f"{kind}_domains", number)
                for name, kind in (
                    ("standard_analog_input", "analog_input"),
                    ("standard_analog_output", "analog_output"),
                    ("tool_analog_input", "tool_analog_input"),
                )
                for number in (0, 1)
            },
        }

    def _of_registers(self) -> dict[str, Source]:
        registers = self._controller.registers

        def bits(values: list[bool], first: int) -> Source:
            return lambda: _bits(values[first : first + 32])

        found: dict[str, Source] = {}
        for way in ("input", "output"):
            for kind, numbers in _NUMBERS.items():
                value = getattr(registers, f"{way}_{kind}").__getitem__
                for number in numbers:
                    found[f"{way}_{kind}_register_{number}"] = partial(value, number)
            for name, first in _groups(way):
                found[name] = bits(getattr(registers, f"{way}_bit"), first)
        return found

    # -- the controller ---------------------------------------------------------------------------

    def _runtime(self) -> RuntimeState:
        """Return the program's runtime state; in transition while the arm brakes or speeds up."""
        runtime, motion = self._controller.runtime, self._motion
        if runtime is RuntimeState.STOPPED and motion.moving:
            return RuntimeState.STOPPING
        if runtime is RuntimeState.PAUSED and motion.moving:
            return RuntimeState.PAUSING
        if runtime is RuntimeState.PLAYING and motion.resuming:
            return RuntimeState.RESUMING
        return runtime

    def _status_bits(self) -> int:
        controller = self._controller
        found = StatusBit(0)
        if controller.mode >= RobotMode.POWER_ON:
            found |= StatusBit.POWER_ON
        if controller.runtime is RuntimeState.PLAYING:
            found |= StatusBit.PROGRAM_RUNNING
        return int(found)

    def _safety_bits(self) -> int:
        safety = self._controller.safety
        found = _SAFETY_BITS.get(safety, SafetyBit(0))
        if safety not in MOVES_IN:
            found |= SafetyBit.STOPPED_FOR_SAFETY
        return int(found)

    def _joint_modes(self) -> tuple[int, ...]:
        mode = self._controller.mode
        if mode is RobotMode.RUNNING:
            return (_RUNNING,) * 6
        return (_IDLE if mode >= RobotMode.POWER_ON else _OFF,) * 6

    # -- the arm ----------------------------------------------------------------------------------

    def _place(self, q: Sequence[float]) -> _Place:
        frames = forward(q, self._motion.kinematics.links)
        return _Place(frames, compose(frames.pose, self._motion.tcp))

    def _elbow_velocity(self) -> Vector3:
        frames, speeds = self._actual().frames, self._motion.actual_qd
        found = Vector3(0.0, 0.0, 0.0)
        for axis, origin, speed in zip(frames.axes[:2], frames.origins, speeds, strict=False):
            arm = subtract(Vector3(*frames.origins[2]), Vector3(*origin))
            found = add(found, scale(cross(Vector3(*axis), arm), speed))
        return found

    def _deviation(self) -> float:
        motion = self._motion
        return (
            max(abs(a - b) for a, b in zip(motion.target_q, motion.actual_q, strict=True))
            / _FARTHEST_RAD
        )

    def _effort(self, q: Sequence[float], qd: Sequence[float], qdd: Sequence[float]) -> Effort:
        x, y, z = self._motion.gravity
        # The model's base is turned by pi about z from the controller's.
        return self._dynamics.effort(q, qd, qdd, self._motion.load, (-x, -y, z))

    def _target_torques(self) -> tuple[float, ...]:
        return self._driven(self._target_effort().torques)

    def _measured_torques(self) -> tuple[float, ...]:
        """Return the torques of the joints, less those that a contact of the arm supports."""
        torques = self._actual_effort().torques
        if self._motion.pushed():
            held = self._motion.joint_torques()
            torques = tuple(a - b for a, b in zip(torques, held, strict=True))
        return self._driven(torques)

    def _driven(self, torques: tuple[float, ...]) -> tuple[float, ...]:
        """Return `torques`, or zeros while the brakes hold."""
        return torques if self._controller.mode is RobotMode.RUNNING else (0.0,) * 6

    def _robot_current(self, currents: Sequence[float]) -> float:
        if self._controller.mode < RobotMode.POWER_ON:
            return 0.0
        power_w = sum(
            max(torque * speed, 0.0) + _WINDING_OHM * current * current
            for torque, speed, current in zip(
                self._actual_torques(), self._motion.actual_qd, currents, strict=True
            )
        )
        return _IDLE_A + power_w / _BUS_V

    def _base_wrench(self) -> tuple[float, ...]:
        fx, fy, fz, tx, ty, tz = self._target_effort().base_wrench
        return (-fx, -fy, fz, -tx, -ty, tz)

    def _raw_wrench(self) -> tuple[float, ...]:
        """Return the wrench of load and contact on the flange, in its axes."""
        contact_force = rotate(
            conjugate(self._actual().frames.pose.orientation),
            Vector3(0.0, 0.0, self._motion.pushed()),
        )
        about = cross(self._motion.tcp.position, contact_force)
        load = self._actual_effort().load_wrench
        return tuple(a - b for a, b in zip((*contact_force, *about), load, strict=True))

    def _acceleration(self, frames: Frames, effort: Effort) -> tuple[float, ...]:
        turn = frames.pose.orientation
        linear = rotate(turn, Vector3(*effort.at(self._motion.tcp.position)))
        angular = rotate(turn, Vector3(*effort.turning))
        return (*subtract(linear, Vector3(*self._motion.gravity)), *angular)


_NUMBERS: Final[Mapping[str, range]] = {
    "bit": range(UPPER_BIT_REGISTERS, BIT_REGISTERS),
    "int": range(REGISTERS),
    "double": range(REGISTERS),
}
"""Numbers of the registers with individual names."""


def _groups(way: str) -> list[tuple[str, int]]:
    """Return the names of groups of 32 bits, each with its first bit."""
    return [
        (f"{way}_bit_registers{first}_to_{first + 31}", first)
        for first in range(0, UPPER_BIT_REGISTERS, 32)
    ]


def _speed(place: _Place, qd: Sequence[float]) -> tuple[float, ...]:
    """Return the speed of the TCP, m/s over rad/s."""
    columns = jacobian(place.frames._replace(pose=place.tcp))
    return tuple(
        sum(part * v for part, v in zip(row, qd, strict=True)) for row in zip(*columns, strict=True)
    )


def _constant(value: Any) -> Source:
    return lambda: value


def _share(value: float | None, now: float) -> float:
    """Clamp to 0 to 1; the value `now` if none, or NaN, was written."""
    return now if value is None or math.isnan(value) else min(max(value, 0.0), 1.0)


def _any_of(values: Mapping[str, Any], beginning: str) -> bool:
    return any(name.startswith(beginning) for name in values)


def _bits(values: Sequence[Any]) -> int:
    return sum(1 << number for number, value in enumerate(values) if value)


def _signal(fraction: float, domain: int) -> float:
    """Return the signal, V or mA."""
    return _HIGHEST_V * fraction if domain else _LOWEST_MA + _RANGE_MA * fraction


def _currents(torques: Sequence[float]) -> tuple[float, ...]:
    return tuple(a / b for a, b in zip(torques, _NEWTON_METERS_PER_A, strict=True))
