"""RTDE connection: its setup, and the robot's states."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from cardan.common.bounds import JOINT_POSITION, JOINT_VELOCITY, Range
from cardan.common.native import NativePartError
from cardan.drivers.missed_cycles import SIMULATED_TIME, AgreedTime
from cardan.drivers.robot_core import outside
from cardan.drivers.ur_rtde.compiled import CompiledStates
from cardan.drivers.ur_rtde.options import UrRtdeOptions
from cardan.errors import shown
from cardan.protocols.ur.program import JOINTS, input_names, report_names
from cardan.protocols.ur.rtde import (
    IN_USE,
    NOT_FOUND,
    Accepted,
    ControllerVersion,
    Data,
    MalformedPayload,
    PacketReader,
    PacketType,
    Recipe,
    SetupReply,
    TextLevel,
    TextMessage,
    ask_inputs,
    ask_outputs,
    ask_version,
    control_rate_hz,
    packet,
    read_reply,
)
from cardan.protocols.ur.states import RobotMode, RuntimeState
from cardan.protocols.ur.variables import OUTPUTS
from cardan.types import NEVER_S

_TIME_S: Final = Range(-1e10, 1e10, "s", "no controller was on for so long")
_SCALE: Final = Range(-10.0, 10.0, "", "no controller's time passes so fast")


class Package(NamedTuple):
    """Values of a data package: variables of these names, and the program's three registers."""

    timestamp: float
    target_q: tuple[float, ...]
    target_qd: tuple[float, ...]
    actual_q: tuple[float, ...]
    actual_qd: tuple[float, ...]
    robot_mode: int
    safety_mode: int
    runtime_state: int
    speed_scaling: float
    target_speed_fraction: float
    token: int
    report: int
    beat: int


STATES: Final = Package._fields[:-3]
INPUT_TYPES: Final = ("INT32",) * 3 + ("DOUBLE",) * (2 * JOINTS)
"""Types of `input_names`."""

NOTHING: Final = Package(
    math.nan, (), (), (), (), RobotMode.NO_CONTROLLER, 0, RuntimeState.STOPPED, 0.0, 0.0, 0, 0, 0
)
"""Initial values, before the first package."""

_new = tuple.__new__
"""Makes a named tuple in half the time of its constructor."""

IMPLAUSIBLE: Final = "implausible"
"""Reason for packages with implausible numbers."""


def _implausible(values: Package) -> str:
    """Describe the implausible numbers of a package; empty if there are none."""
    # The usual case by the norm, which a NaN does not pass.
    if (
        math.hypot(*values.actual_q, *values.target_q, *values.actual_qd, *values.target_qd)
        <= _USUAL
        and abs(values.speed_scaling) + abs(values.target_speed_fraction) <= _SCALES
        and abs(values.timestamp) <= _TIMES_S
    ):
        return ""
    return (
        outside("timestamp", (values.timestamp,), _TIME_S)
        or outside("actual_q", values.actual_q, JOINT_POSITION)
        or outside("target_q", values.target_q, JOINT_POSITION)
        or outside("actual_qd", values.actual_qd, JOINT_VELOCITY)
        or outside("target_qd", values.target_qd, JOINT_VELOCITY)
        or outside("speed_scaling", (values.speed_scaling,), _SCALE)
        or outside("target_speed_fraction", (values.target_speed_fraction,), _SCALE)
    )


_USUAL = min(JOINT_POSITION.highest, JOINT_VELOCITY.highest)
_SCALES, _TIMES_S = _SCALE.highest, _TIME_S.highest


class RtdeFeed:
    """Successive RTDE connections. The sender takes messages from `out`."""

    def __init__(self, options: UrRtdeOptions) -> None:
        self.options = options
        self.out: list[bytes] = []
        self.ignored: Counter[str] = Counter()
        """Packets without effect, by reason."""
        self.version: ControllerVersion | None = None
        self._take_rate()
        self.packages = 0
        """Count of accepted data packages."""
        self.heard_s = NEVER_S
        self.values = NOTHING
        """Values of the newest package."""
        self.slider = 0.0
        """Rate of the controller's time then: its speed slider, and its own scaling."""
        self.obeys = False
        """True: nothing in the newest package ends motion but an unresponsive program, which the
        session detects; False: the session must check all of it."""
        self.clock = AgreedTime(
            self.period_s, option=SIMULATED_TIME, simulated=options.simulated_time
        )
        """Time between packages, by the controller's clock and ours."""
        self.skipped = 0
        """Count of packages that the controller omitted."""
        self.last_implausible = ""
        """Implausible value that caused the last package to be ignored."""
        self.said = ""
        """Last warning or error that the controller sent over RTDE."""
        self._disconnect()

    def _disconnect(self) -> None:
        self.failure = ""
        """Reason why this connection is unusable; empty if none is known."""
        self.streaming = False
        self.answered = False
        """True once any RTDE message came over this connection."""
        self.foreign = ""
        """Evidence that the server speaks another protocol, for messages."""
        self._reader = PacketReader()
        self._outputs: Recipe | None = None
        self._inputs: Recipe | None = None
        self._compiled: CompiledStates | None = None
        self.next_s = math.inf
        """Time of the next call of `advance`, s."""
        self._timestamp = math.nan
        self.clock.begin()
        self.out.clear()

    @property
    def control_rate_hz(self) -> float:
        """Rate of the controller's control loop; before it is known, an e-Series'."""
        return control_rate_hz(self.version)

    def _take_rate(self) -> None:
        self.rate_hz = min(self.options.rate_hz, self.control_rate_hz)
        """Rate of states and commands, Hz."""
        self.period_s = 1.0 / self.rate_hz
        """Period of states and commands, s."""

    def connected(self, now_s: float) -> None:
        """Start after the connection was established."""
        self._disconnect()
        self._ask(ask_version(), now_s)

    def disconnected(self) -> None:
        """Stop after the connection was lost."""
        self._disconnect()

    def advance(self, now_s: float) -> None:
        """Check whether an answer is overdue."""
        if now_s >= self.next_s:
            self.failure = f"it did not answer within {self.options.request_timeout_s:g} s"

    def received(self, data: bytes, now_s: float) -> None:
        """Process bytes from TCP."""
        reader, recipe, compiled = self._reader, self._outputs, self._compiled
        if recipe is not None and not (reader.pending_bytes or self.failure):
            if compiled is not None and (usual := compiled.take(data, now_s)) is not None:
                self.values, self.slider, self.obeys, self._timestamp = usual
                self.packages += 1
                self.heard_s = now_s
                return
            found = recipe.alone(data)
            if found is not None:
                self._take_values(found, now_s)
                return
        reader.feed(data)
        while not self.failure and (taken := reader.take()) is not None:
            self._take(*taken, now_s)
        self.failure = self.failure or reader.failure
        if not self.answered and (reader.foreign or reader.failure):
            self.failure = self.foreign = (
                f"{reader.failure or 'it does not speak RTDE'}; it says {shown(data[:40])}: is "
                "rtde_port the controller's (30004)?"
            )

    def write(self, values: Sequence[Any] | bytes) -> None:
        """Make the package that writes the registers of `input_names`; bytes are that package."""
        if self._inputs is not None and self.streaming:
            self.out.append(values if isinstance(values, bytes) else self._inputs.pack(values))

    @property
    def command_head(self) -> bytes:
        """First bytes of each command package, if the controller has the registers as documented;
        otherwise empty."""
        inputs = self._inputs
        return inputs.head if inputs is not None and inputs.types == INPUT_TYPES else b""

    def follow(self, token: int) -> None:
        """Set the token of the program to be obeyed."""
        if self._compiled is not None:
            self._compiled.follow(token)

    # -- setting up -------------------------------------------------------------------------------

    def _ask(self, request: bytes, now_s: float) -> None:
        self.out.append(request)
        self.next_s = now_s + self.options.request_timeout_s

    def _take(self, kind: int, payload: bytes, now_s: float) -> None:
        self.answered = True
        reply = read_reply(kind, payload)
        if isinstance(reply, Data):
            self._take_data(reply, now_s)
        elif isinstance(reply, MalformedPayload):
            self.ignored[reply.reason] += 1
        elif isinstance(reply, TextMessage):
            if reply.level <= TextLevel.WARNING:
                self.said = reply.text
        elif isinstance(reply, Accepted):
            self._take_accepted(reply, now_s)
        elif isinstance(reply, ControllerVersion):
            self.version = reply
            self._take_rate()
            self._ask(ask_outputs(self.rate_hz, (*STATES, *self._reports)), now_s)
        else:
            self._take_setup(reply, now_s)

    @property
    def _reports(self) -> tuple[str, str, str]:
        return report_names(self.options.first_register)

    def _take_accepted(self, reply: Accepted, now_s: float) -> None:
        if reply.kind is PacketType.PROTOCOL_VERSION:
            if reply.accepted:
                self._ask(packet(PacketType.CONTROLLER_VERSION), now_s)
            else:
                self.failure = "it has no RTDE of version 2: PolyScope 3.2 and later have"
        elif reply.kind is PacketType.START:
            self.next_s = math.inf
            self.streaming = reply.accepted
            self.clock.period_s = self.period_s
            self._compiled = self._states_compiled()
            if not reply.accepted:
                self.failure = f"it does not begin to send states{self._remark}"

    def _take_setup(self, reply: SetupReply, now_s: float) -> None:
        outputs = reply.kind is PacketType.OUTPUTS
        first = self.options.first_register
        names = (*STATES, *self._reports) if outputs else input_names(first)
        if not reply.recipe or len(reply.types) != len(names):
            self.failure = self._refused(names, reply.types)
            return
        try:
            recipe = Recipe(reply.recipe, names, reply.types)
        except ValueError:
            self.failure = self._refused(names, reply.types)
            return
        if outputs:
            wrong = [n for n, kind in zip(names, reply.types, strict=True) if kind != OUTPUTS[n]]
            if wrong:
                self.failure = f"its {', '.join(wrong)} are of another type than documented"
                return
            self._outputs = recipe
            self._ask(ask_inputs(input_names(first)), now_s)
        else:
            self._inputs = recipe
            self._ask(packet(PacketType.START), now_s)

    def _states_compiled(self) -> CompiledStates | None:
        if self._outputs is None:
            return None
        astray_rad = self.options.following_error_rad
        bounds = _TIME_S.highest, _SCALE.highest
        try:
            return CompiledStates(
                self._outputs.head, Package, self.clock, self.rate_hz, astray_rad, *bounds
            )
        except NativePartError:
            return None

    def _refused(self, names: Sequence[str], types: Sequence[str]) -> str:
        pairs = tuple(zip(names, types, strict=False))
        in_use = [name for name, kind in pairs if kind == IN_USE]
        unknown = [name for name, kind in pairs if kind == NOT_FOUND]
        if in_use:
            return (
                f"another program, or a fieldbus, has the registers {in_use[0]} to {in_use[-1]}: "
                'end it, or set registers = "lower" or "upper"'
            )
        if unknown:
            return (
                f"it does not know {', '.join(unknown)}: its software is too old, or set "
                'registers = "lower"'
            )
        return f"it refuses the requested states{self._remark}"

    @property
    def _remark(self) -> str:
        return f" ({self.said})" if self.said else ""

    # -- states -----------------------------------------------------------------------------------

    def _take_data(self, data: Data, now_s: float) -> None:
        recipe = self._outputs
        if recipe is None or data.recipe != recipe.number:
            self.ignored["a data package that was not asked for"] += 1
            return
        if len(data.values) != recipe.size:
            self.ignored[f"a data package of {len(data.values)} bytes, not {recipe.size}"] += 1
            return
        self._take_values(recipe.values(data.values), now_s)

    def _take_values(self, found: tuple[Any, ...], now_s: float) -> None:
        values = _new(Package, found)
        timestamp = values.timestamp
        if wrong := _implausible(values):
            self.ignored[IMPLAUSIBLE] += 1
            self.last_implausible = wrong
            return
        self.obeys = False
        periods = (timestamp - self._timestamp) * self.rate_hz
        if periods >= 1.5:
            self.skipped += round(periods) - 1
        self._timestamp = timestamp
        self.clock.passed(timestamp, now_s)
        self.values = values
        own, slider = values.speed_scaling, values.target_speed_fraction
        # The controller's own scaling is 0 while no program runs.
        self.slider = slider * own if 0.0 < own < 1.0 else slider
        self.packages += 1
        self.heard_s = now_s
