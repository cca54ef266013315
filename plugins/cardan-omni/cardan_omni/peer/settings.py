"""The settings of the simulated libHD before it starts, as a text.

A line a setting, a word and its values with one blank between; a text value is the rest of its
line. SI units, rad, axes of HDAPI (x right, y up, z to the operator)::

    clock real|virtual              CLOCK_MONOTONIC and a thread, or time that simStep makes
    seed N
    rate HZ                         of the scheduler until hdSetSchedulerRate
    powered calibrated|cold         cold: needs the inkwell before it knows where it is
    model "PHANTOM Omni"|"Touch"
    serial TEXT
    device NAME                     for hdInitDevice, beside the default ones
    mass KG                         of the mechanism, felt at the gimbal's center
    friction N                      Coulomb
    viscous N_S_M
    droop N                         down, while not gripped
    thermal S                       time constant of the motors
    gimbal S1 S2 S3 O1 O2 O3        scales of the gimbal angles and their offsets, rad
    gimbal_noise LSB                of the gimbal's potentiometers, peak to peak; 1 LSB: 0.0735°
    hand KG N_S_M N_M               the gripping hand: mass, damping, stiffness
    grip 0|1                        without waypoints
    waypoint T X Y Z RX RY RZ GRIP BUTTONS DOCKED PX PY PZ KX KY KZ
    loop T                          the waypoints start again
    fault NAME VALUE [FROM_S]
    log PATH                        true values as CSV, a line a tick, every 50 ms

A waypoint is the hand at T s after the scheduler was first started: where it holds the gimbal's
center (m) and the stylus (rad, about the fixed axes x, y, z in turn), three flags (BUTTONS are
bits), how it pushes beside its spring (N), and how stiff it is along each axis (N/m). Numbers are
linear between waypoints; flags hold until the next. Faults count from the same instant.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

from cardan.common.bounds import Range
from cardan.common.options import Options, require_each
from cardan.errors import ScriptError
from cardan.sim_peers.base import FaultSwitch, check_faults
from cardan.sim_peers.command import option
from cardan.types import ZERO3, Vector3

MODELS = {"omni": "PHANTOM Omni", "touch": "Touch"}
"""Values of HD_DEVICE_MODEL_TYPE, by the name of the option."""

GIMBAL_NOISE_LSB = {"omni": 5.0, "touch": 0.0}
"""Noise by model, peak to peak: the FireWire units are noisier."""

INKWELL_M = Vector3(0.0, -0.0655107, -0.0881142)
"""Position of the gimbal's center with the stylus docked, device frame."""


def _flag(name: str, help_: str) -> FaultSwitch:
    return FaultSwitch(name, help_, 1.0, 1.0, 1.0)


FAULTS = (
    _flag("comm-error", "the link fails: HD_COMM_ERROR, internal code -28; initializing fails too"),
    _flag("unplug", "the device is gone: HD_DEVICE_FAULT"),
    FaultSwitch("late-tick", "every 100th tick comes VALUE ms late", 5.0, 0.1, 1000.0),
    FaultSwitch("overrun", "something holds up every tick for VALUE ms", 3.0, 0.1, 1000.0),
    FaultSwitch(
        "warm-motors", "motors show a temperature of VALUE; from 1 on no force", 1.0, 0.01, 10.0
    ),
    FaultSwitch(
        "over-force",
        "the force limit trips VALUE times a second: off, then a ramp",
        1.0,
        0.01,
        100.0,
    ),
    _flag("uncalibrated", "the calibration is lost until the stylus is in the inkwell"),
    FaultSwitch("button-bounce", "every edge of a button bounces for VALUE ms", 5.0, 1.0, 1000.0),
    FaultSwitch("stuck-encoder", "the encoder of joint VALUE (1..3) stands still", 1.0, 1.0, 3.0),
    FaultSwitch("jitter", "ticks come up to VALUE µs late, at random", 200.0, 1.0, 1e5),
    FaultSwitch("slow-ticks", "ticks come VALUE times a second", 200.0, 1.0, 1000.0),
    FaultSwitch("init-fails", "initializing fails with the error code VALUE", 768.0, 256.0, 1536.0),
    _flag("no-license", "initializing fails with HD_INVALID_LICENSE"),
    _flag("dead-scheduler", "ticks stop without an error"),
)


class OmniFault(NamedTuple):
    """A fault of FAULTS, from `from_s` s after the scheduler's first start."""

    name: str
    value: float = 1.0
    from_s: float = 0.0


def parse_omni_faults(words: Iterable[str]) -> tuple[OmniFault, ...]:
    """Read ``NAME[=VALUE][@SECONDS]``; Raises ScriptError, which lists the faults."""
    return tuple(parse_omni_fault(word) for word in words)


def parse_omni_fault(word: str) -> OmniFault:
    """One of the fault names of FAULTS."""
    what, at, from_s = word.partition("@")
    name, equals, value = what.partition("=")
    defaults = {switch.name: switch.default for switch in FAULTS}
    fault = OmniFault(
        name,
        _number_of(name, value) if equals else defaults.get(name, 1.0),
        _number_of(name, from_s) if at else 0.0,
    )
    _check_fault(fault)
    return fault


def _number_of(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ScriptError(f"fault {name}: {text!r} is not a number") from None


def _check_fault(fault: OmniFault) -> None:
    switch = next((each for each in FAULTS if each.name == fault.name), None)
    if switch is not None and switch.lowest == switch.highest != fault.value:
        raise ScriptError(
            f"fault {fault.name}: takes no value; {fault.name}@{fault.value:g} means from "
            f"{fault.value:g} s on"
        )
    check_faults({fault.name: fault.value}, FAULTS)
    if not 0.0 <= fault.from_s < math.inf:
        raise ScriptError(f"fault {fault.name}: cannot begin at {fault.from_s:g} s")


class Waypoint(NamedTuple):
    """Hand at an instant, device frame; numbers are linear between two of them."""

    time_s: float
    """Time since the scheduler was first started, s."""
    position_m: Vector3 = ZERO3
    """Position to which the hand pulls the gimbal's center."""
    turn_rad: Vector3 = ZERO3
    """Angles of the stylus about the fixed axes x, y, z in turn."""
    gripped: bool = True
    buttons: int = 0
    docked: bool = False
    push_n: Vector3 = ZERO3
    """Force in addition to the hand's spring."""
    stiffness_n_m: Vector3 = Vector3(200.0, 200.0, 200.0)
    """Stiffness of the spring along each axis."""


class HandMotion(NamedTuple):
    """Script in the form that the library plays."""

    waypoints: tuple[Waypoint, ...] = ()
    """Waypoints in the order of time; none: the hand stays at the origin, as in OmniSettings."""
    loop_s: float | None = None
    """Time when the script starts again; None: it does not."""


SEED = Range(0, 2**63 - 1, "", "63 bits")
RATE_HZ = Range(500, 2000, "Hz", "the real one's loop has no others")
MASS_KG = Range(0.01, 1.0, "kg", "the real mechanism has 45 g")
DRAG_N = Range(0.0, 5.0, "N", "no hand could move it")
VISCOUS_N_S_M = Range(0.0, 50.0, "N·s/m", "no hand could move it")
THERMAL_S = Range(0.1, 1e4, "s", "no motor warms more slowly")
NOISE_LSB = Range(0.0, 200.0, "LSB", "that is 15 degrees")
HAND_MASS_KG = Range(0.0, 10.0, "kg", "no hand has more")
HAND_DAMPING_N_S_M = Range(0.0, 100.0, "N·s/m", "no hand has more")
HAND_STIFFNESS_N_M = Range(0.0, 5000.0, "N/m", "no hand has more")

STILL = HandMotion()
UNSCALED = Vector3(1.0, 1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class OmniSettings(Options):
    """Simulated Omni. `text` is the input of simConfigure or of the file named by CARDAN_OMNI.

    Raises OptionError for a value out of range, ScriptError for a fault or a motion that is
    impossible; defaults are the real device's values where these are known.
    """

    virtual: bool = False
    """Whether time passes in simStep only; otherwise this computer's clock and a thread are
    used."""
    seed: Annotated[int, SEED] = 0
    rate_hz: Annotated[int, RATE_HZ] = 1000
    cold: bool = option(False, "It needs the inkwell before it knows where it is.")
    model: str = option("omni", "Model that the device reports.", metavar="|".join(MODELS))
    serial: str = "60907300123"
    device: str = ""
    """Name for hdInitDevice in addition to the default ones."""
    mass_kg: Annotated[float, MASS_KG] = 0.045
    friction_n: Annotated[float, DRAG_N] = 0.26
    viscous_n_s_m: Annotated[float, VISCOUS_N_S_M] = 0.1
    droop_n: Annotated[float, DRAG_N] = 0.3
    """Force that pulls an unheld stylus down; more than the friction: it falls."""
    thermal_s: Annotated[float, THERMAL_S] = 80.0
    gimbal_scale: Vector3 = UNSCALED
    gimbal_offset_rad: Vector3 = ZERO3
    gimbal_noise_lsb: Annotated[float, NOISE_LSB] | None = None
    """Noise of the gimbal angles, peak to peak, in steps of 0.0735°, uniform; None: that of the
    model."""
    hand_mass_kg: Annotated[float, HAND_MASS_KG] = 0.2
    hand_damping_n_s_m: Annotated[float, HAND_DAMPING_N_S_M] = 5.0
    hand_stiffness_n_m: Annotated[float, HAND_STIFFNESS_N_M] = 200.0
    """Grip without waypoints; waypoints have their own."""
    gripped: bool = True
    motion: HandMotion = STILL
    faults: tuple[OmniFault, ...] = option(
        (),
        "A fault to simulate (repeatable), from this time on; see --list-faults.",
        name="fault",
        metavar="NAME[=VALUE][@SECONDS]",
        read=parse_omni_fault,
        repeatable=True,
    )
    log: str = option("", "Write true values there as they come (CSV).", metavar="FILE")
    """Log file with a row for each tick, written at most 50 ms later."""

    def __post_init__(self) -> None:
        super().__post_init__()
        lines = (("serial", 63), ("device", 63), ("log", 4000))
        require_each(
            self,
            ("model", self.model in MODELS, f"one of {', '.join(MODELS)}"),
            *(
                (key, _is_line(getattr(self, key), most), f"a line of up to {most} bytes")
                for key, most in lines
            ),
        )
        for fault in self.faults:
            _check_fault(fault)
        times_s = [waypoint.time_s for waypoint in self.motion.waypoints]
        if any(b <= a for a, b in itertools.pairwise(times_s)):
            raise ScriptError("waypoints must be in the order of time")

    @property
    def _gimbal_noise_lsb(self) -> float:
        noise = self.gimbal_noise_lsb
        return GIMBAL_NOISE_LSB[self.model] if noise is None else noise

    @property
    def text(self) -> str:
        """Return the settings in the text form that the library reads."""
        lines = [
            f"clock {'virtual' if self.virtual else 'real'}",
            f"seed {self.seed}",
            f"rate {self.rate_hz}",
            f"powered {'cold' if self.cold else 'calibrated'}",
            f'model "{MODELS[self.model]}"',
            f"mass {_number(self.mass_kg)}",
            f"friction {_number(self.friction_n)}",
            f"viscous {_number(self.viscous_n_s_m)}",
            f"droop {_number(self.droop_n)}",
            f"thermal {_number(self.thermal_s)}",
            f"gimbal {_numbers(self.gimbal_scale)} {_numbers(self.gimbal_offset_rad)}",
            f"gimbal_noise {_number(self._gimbal_noise_lsb)}",
            f"hand {_number(self.hand_mass_kg)} {_number(self.hand_damping_n_s_m)} "
            f"{_number(self.hand_stiffness_n_m)}",
            f"grip {self.gripped:d}",
        ]
        lines += [_waypoint_line(waypoint) for waypoint in self.motion.waypoints]
        if self.motion.loop_s is not None:
            lines.append(f"loop {_number(self.motion.loop_s)}")
        for fault in self.faults:
            lines.append(f"fault {fault.name} {_number(fault.value)} {_number(fault.from_s)}")
        if self.serial:
            lines.append(f"serial {self.serial}")
        if self.device:
            lines.append(f"device {self.device}")
        if self.log:
            # The program that loads the library may have another working directory by then.
            lines.append(f"log {Path(self.log).absolute()}")
        return "\n".join(lines) + "\n"


def _is_line(text: str, most_bytes: int) -> bool:
    return text.isprintable() and len(text.encode()) <= most_bytes and text == text.strip()


def _waypoint_line(waypoint: Waypoint) -> str:
    numbers = (
        f"{_number(waypoint.time_s)} {_numbers(waypoint.position_m)} {_numbers(waypoint.turn_rad)}"
    )
    flags = f"{waypoint.gripped:d} {waypoint.buttons:d} {waypoint.docked:d}"
    pushes = f"{_numbers(waypoint.push_n)} {_numbers(waypoint.stiffness_n_m)}"
    return f"waypoint {numbers} {flags} {pushes}"


def _numbers(values: Iterable[float]) -> str:
    return " ".join(_number(value) for value in values)


def _number(value: float) -> str:
    return f"{value + 0.0:.9g}"
