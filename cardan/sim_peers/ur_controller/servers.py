"""The servers of the simulated controller: RTDE, primary interface and dashboard.

Sans-I/O: bytes come in with the time, pieces to write go out; a shell has the sockets.
"""

from __future__ import annotations

import heapq
import math
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Literal

from cardan.protocols.ur import dashboard
from cardan.protocols.ur.primary import ModeData, state_package, version_message
from cardan.protocols.ur.rtde import packet
from cardan.protocols.ur.script import LARGEST
from cardan.protocols.ur.states import RobotMode, RuntimeState, SafetyMode
from cardan.sim_peers.base import TimedActs
from cardan.sim_peers.ur_controller.controller import UrController
from cardan.sim_peers.ur_controller.dashboard_server import answer
from cardan.sim_peers.ur_controller.options import UrControllerOptions
from cardan.sim_peers.ur_controller.rtde_server import Claims, RtdeClient
from cardan.sim_peers.ur_controller.telemetry import Telemetry

PortKind = Literal["rtde", "primary", "dashboard"]
PORT_KINDS: tuple[PortKind, ...] = ("rtde", "primary", "dashboard")

CLIENTS: Final = 16
"""Each port serves at once."""
STATE_PERIOD_S: Final = 0.1
"""Of the primary interface."""
_SPLIT_S: Final = 0.001
"""Delay of the second piece of a packet that is written in two."""
_KEPT_EVENTS = 10_000
_UNKNOWN_TYPE = 0x58
_OTHER_PROGRAM = "def other():\n  while True:\n    sync()\n  end\nend\n"


@dataclass(eq=False)
class _Connection:
    number: int
    kind: PortKind
    out: deque[bytes] = field(default_factory=deque)
    late: list[tuple[float, int, bytes]] = field(default_factory=list)
    rtde: RtdeClient | None = None
    lines: dashboard.LineReader = field(default_factory=dashboard.LineReader)
    program: bytearray = field(default_factory=bytearray)


class UrServers:
    """The servers of a `UrController`; connections are small integers. They hold to
    :class:`cardan.sim_peers.tcp_peer.TcpServers`."""

    def __init__(self, controller: UrController, options: UrControllerOptions) -> None:
        self.controller = controller
        self.options = options
        self.telemetry = Telemetry(controller)
        self.events: deque[tuple[float, str]] = deque(maxlen=_KEPT_EVENTS)
        """(time_s, what happened), the newest of them."""
        self._connections: dict[int, _Connection] = {}
        self._count = self._order = 0
        self._closing: list[int] = []
        self._aborting: list[int] = []
        self._last_words: list[tuple[int, bytes]] = []
        self._started = self._silent = False
        self._now_s = 0.0
        self._next_state_s = math.inf
        self._random = random.Random(options.seed)
        faults = options.faults
        self._claims = Claims(faults.get("in-use", 0.0) > 0.0)
        self._skip = faults.get("skip", 0.0)
        self._garbage = faults.get("garbage", 0.0)
        self._late_s = 1e-3 * faults.get("late", 0.0)
        self._split = faults.get("split", 0.0) > 0.0
        self._timed: TimedActs[Callable[[], None]] = TimedActs({}, {})

    # -- what the shell calls ---------------------------------------------------------------------

    @property
    def silent(self) -> bool:
        return self._silent

    @property
    def next_s(self) -> float:
        times = [self.controller.next_s, self._timed.next_s]
        if not self._silent:
            times.append(self._next_state_s)
            for each in self._connections.values():
                if each.late:
                    times.append(each.late[0][0])
                if each.out:
                    times.append(self._now_s + _SPLIT_S)
        return min(times)

    def takes(self, connection: int) -> bool:
        return connection in self._connections and not self._silent

    def accepted(self, kind: PortKind, now_s: float) -> int | None:
        self.advance(now_s)
        if sum(each.kind == kind for each in self._connections.values()) >= CLIENTS:
            self._note(f"{kind}: a client is refused, {CLIENTS} are there")
            return None
        self._count += 1
        made = _Connection(self._count, kind)
        self._connections[self._count] = made
        self._note(f"{kind}: connection {self._count}")
        if kind == "rtde":
            made.rtde = RtdeClient(
                self.controller,
                self.telemetry,
                self._claims,
                lambda data: self._put(made, data),
                self._note,
            )
        elif kind == "dashboard":
            self._put(made, dashboard.request(dashboard.GREETING))
        else:
            version = version_message(self.controller.time_s, self.options.version)
            self._put(made, version)
        return self._count

    def data(self, connection: int, data: bytes, now_s: float) -> None:
        self.advance(now_s)
        found = self._connections.get(connection)
        if found is None or self._silent:
            return
        if found.rtde is not None:
            found.rtde.data(data)
            if found.rtde.failure:
                self._drop(found, found.rtde.failure)
        elif found.kind == "dashboard":
            self._dashboard(found, data)
        else:
            self._primary(found, data)
        self._send_messages()

    def eof(self, connection: int, now_s: float) -> None:
        self.lost(connection, now_s, "its client has gone")

    def lost(self, connection: int, now_s: float, reason: str) -> None:
        self.advance(now_s)
        found = self._connections.get(connection)
        if found is not None:
            self._drop(found, reason)

    def advance(self, now_s: float) -> None:
        self._now_s = now_s
        controller = self.controller
        if not self._started:
            self._started = True
            self._timed = self._plan(now_s)
            self._next_state_s = now_s + STATE_PERIOD_S
        while True:
            for _, act in self._timed.due(min(now_s, controller.next_s)):
                act()
            if not controller.advance(now_s):
                break
            self._publish()
        if now_s >= self._next_state_s:
            missed = math.floor((now_s - self._next_state_s) / STATE_PERIOD_S)
            self._next_state_s += (missed + 1) * STATE_PERIOD_S
            self._publish_state()
        self._send_messages()
        for each in self._connections.values():
            while each.late and each.late[0][0] <= now_s:
                self._put(each, heapq.heappop(each.late)[2])

    def outgoing(self) -> list[tuple[int, bytes]]:
        pieces, self._last_words = self._last_words, []
        for each in self._connections.values():
            out = each.out
            for _ in range(min(1, len(out)) if self._split else len(out)):
                pieces.append((each.number, out.popleft()))
        return [] if self._silent else pieces

    def closing(self) -> list[int]:
        numbers, self._closing = self._closing, []
        return numbers

    def aborting(self) -> list[int]:
        numbers, self._aborting = self._aborting, []
        return numbers

    # -- faults -----------------------------------------------------------------------------------

    def _plan(self, start_s: float) -> TimedActs[Callable[[], None]]:
        controller = self.controller
        acts: dict[str, Callable[[], None]] = {
            "protective-stop": lambda: controller.protective_stop("fault"),
            "unlock": self._unlock,
            "estop": controller.emergency_stop,
            "safeguard-stop": controller.safeguard_stop,
            "safeguard-reset": controller.safeguard_reset,
            "power-off": controller.power_off,
            "pause": self._pause,
            "resume": self._resume,
            "program-stop": self._stop_program,
            "other-program": lambda: controller.upload(_OTHER_PROGRAM),
            "local": self._local,
            "slider-zero": self._slider_zero,
            "silent": self._fall_silent,
            "cut": self._cut,
            "reset": self._reset,
        }
        return TimedActs(self.options.faults, acts, start_s=start_s)

    def _unlock(self) -> None:
        self.controller.unlock_protective_stop()

    def _pause(self) -> None:
        self.controller.pause()

    def _resume(self) -> None:
        self.controller.resume()

    def _stop_program(self) -> None:
        self.controller.stop_program()

    def _local(self) -> None:
        self.controller.remote = not self.options.e_series

    def _slider_zero(self) -> None:
        self.controller.slider = 0.0

    def _fall_silent(self) -> None:
        self._note("fault: silent from now on")
        self._silent = True

    def _cut(self) -> None:
        for each in tuple(self._connections.values()):
            if each.kind == "rtde":
                self._drop(each, "fault: cut")

    def _reset(self) -> None:
        for each in tuple(self._connections.values()):
            self._drop(each, "fault: reset", self._aborting)

    # -- what comes in ----------------------------------------------------------------------------

    def _dashboard(self, connection: _Connection, data: bytes) -> None:
        lines = connection.lines
        lines.feed(data)
        while (line := lines.take()) is not None:
            if line.strip().lower() == dashboard.QUIT:
                self._put(connection, dashboard.request("Disconnected"))
                self._drop(connection, "quit")
                return
            self._put(connection, dashboard.request(answer(self.controller, line)))
        if lines.failure:
            self._drop(connection, lines.failure)

    def _primary(self, connection: _Connection, data: bytes) -> None:
        """A program is whole with the line `end` that closes it, which here is one that is not
        indented."""
        program = connection.program
        program += data
        if len(program) > LARGEST:
            self._drop(connection, f"a program of more than {LARGEST} bytes")
            return
        while (whole := _whole_program(program)) is not None:
            self.controller.upload(whole.decode("utf-8", "replace"))

    # -- what goes out ----------------------------------------------------------------------------

    def _publish(self) -> None:
        if self._silent:
            return
        frame = self.controller.frames
        for each in self._connections.values():
            if each.rtde is None:
                continue
            for data in each.rtde.packages(frame):
                if self._skip and self._random.random() < self._skip:
                    continue
                if self._garbage and self._random.random() < self._garbage:
                    self._later(each, _junk(self._random))
                self._later(each, data)

    def _later(self, connection: _Connection, data: bytes) -> None:
        if not self._late_s:
            self._put(connection, data)
            return
        self._order += 1
        heapq.heappush(connection.late, (self._now_s + self._late_s, self._order, data))

    def _publish_state(self) -> None:
        controller = self.controller
        data = ModeData(
            power_on=controller.mode >= RobotMode.POWER_ON,
            emergency_stopped=controller.safety is SafetyMode.ROBOT_EMERGENCY_STOP,
            protective_stopped=controller.safety is SafetyMode.PROTECTIVE_STOP,
            program_running=controller.runtime is RuntimeState.PLAYING,
            program_paused=controller.runtime is RuntimeState.PAUSED,
            robot_mode=controller.mode,
            speed_fraction=controller.slider,
        )
        self._tell_primary(state_package(controller.time_s, data))

    def _send_messages(self) -> None:
        messages = self.controller.messages
        for data in messages:
            self._tell_primary(data)
        messages.clear()

    def _tell_primary(self, data: bytes) -> None:
        for each in self._connections.values():
            if each.kind == "primary":
                self._put(each, data)

    def _put(self, connection: _Connection, data: bytes) -> None:
        if self._split and len(data) > 1:
            cut = self._random.randrange(1, len(data))
            connection.out.append(data[:cut])
            connection.out.append(data[cut:])
        else:
            connection.out.append(data)

    def _drop(self, connection: _Connection, reason: str, into: list[int] | None = None) -> None:
        del self._connections[connection.number]
        if connection.rtde is not None:
            connection.rtde.gone()
        self._last_words += [(connection.number, piece) for piece in connection.out]
        (self._closing if into is None else into).append(connection.number)
        self._note(f"{connection.kind}: connection {connection.number} is closed: {reason}")

    def _note(self, text: str) -> None:
        self.events.append((self._now_s, text))


def _whole_program(data: bytearray) -> bytes | None:
    """The first program that has all come; it is taken out."""
    at = 0
    while (end := data.find(b"\n", at)) >= 0:
        if data[at:end].rstrip() == b"end":
            found = bytes(data[: end + 1])
            del data[: end + 1]
            return found
        at = end + 1
    return None


def _junk(chance: random.Random) -> bytes:
    return packet(_UNKNOWN_TYPE, chance.randbytes(chance.randrange(0, 40)))  # type: ignore[arg-type]
