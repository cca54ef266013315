"""The servers of the simulated controller: RTDE, primary interface and dashboard.

Sans-I/O: bytes come in with the time, pieces to write go out; a shell has the sockets.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

from cardan.protocols.ur import dashboard
from cardan.protocols.ur.primary import ModeData, state_package, version_message
from cardan.protocols.ur.rtde import packet
from cardan.protocols.ur.script import LARGEST
from cardan.protocols.ur.states import RobotMode, RuntimeState, SafetyMode
from cardan.sim_peers.base import TimedActs
from cardan.sim_peers.tcp_servers import Act, Connection, TcpServers
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
_UNKNOWN_TYPE = 0x58
_OTHER_PROGRAM = "def other():\n  while True:\n    sync()\n  end\nend\n"


@dataclass(eq=False)
class _Connection(Connection[PortKind]):
    rtde: RtdeClient | None = None
    lines: dashboard.LineReader = field(default_factory=dashboard.LineReader)
    program: bytearray = field(default_factory=bytearray)


class UrServers(TcpServers[PortKind, _Connection]):
    """The servers of a `UrController`."""

    kinds = PORT_KINDS
    state_period_s = STATE_PERIOD_S

    def __init__(self, controller: UrController, options: UrControllerOptions) -> None:
        super().__init__(controller.events, options.faults, options.seed)
        self.controller = controller
        self.options = options
        self.telemetry = Telemetry(controller)
        self._claims = Claims(options.faults.get("in-use", 0.0) > 0.0)

    def behave(self, faults: Mapping[str, float]) -> None:
        super().behave(faults)
        self._skip_share = faults.get("skip", 0.0)

    # -- connections and time ---------------------------------------------------------------------

    def _due(self) -> Iterator[float]:
        yield self.controller.next_s
        if not self._silent:
            yield self._next_state_s

    def _refuses(self, kind: PortKind) -> str:
        there = sum(each.kind == kind for each in self._connections.values())
        return f"{CLIENTS} are there" if there >= CLIENTS else ""

    def _met(self, kind: PortKind, number: int) -> _Connection:
        return _Connection(number, kind)

    def _greet(self, connection: _Connection) -> None:
        if connection.kind == "rtde":
            connection.rtde = RtdeClient(
                self.controller,
                self.telemetry,
                self._claims,
                lambda data: self._put(connection, data),
                self._note,
            )
        elif connection.kind == "dashboard":
            self._put(connection, dashboard.request(dashboard.GREETING))
        else:
            version = version_message(self.controller.time_s, self.options.version)
            self._put(connection, version)

    def _received(self, connection: _Connection, data: bytes) -> None:
        if connection.rtde is not None:
            connection.rtde.data(data)
            if connection.rtde.failure:
                self._drop(connection, connection.rtde.failure)
        elif connection.kind == "dashboard":
            self._dashboard(connection, data)
        else:
            self._primary(connection, data)
        self._send_messages()

    def _parted(self, connection: _Connection) -> None:
        if connection.rtde is not None:
            connection.rtde.gone()

    def _live(self) -> None:
        controller, now_s = self.controller, self._now_s
        while True:
            for _, act in self._timed.due(min(now_s, controller.next_s)):
                act()
            if not controller.advance(now_s):
                break
            self._publish()
        if self._state_due():
            self._publish_state()
        self._send_messages()

    # -- faults -----------------------------------------------------------------------------------

    def _plan(self) -> TimedActs[Act]:
        controller = self.controller
        acts: dict[str, Act] = {
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
            **self._network_acts(),
        }
        return TimedActs(self.options.faults, acts, start_s=self._now_s)

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
                if self._happens(self._skip_share):
                    continue
                if self._happens(self._garbage_share):
                    self._later(each, _junk(self._random))
                self._later(each, data)

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
