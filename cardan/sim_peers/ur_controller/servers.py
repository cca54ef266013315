"""The servers of the simulated controller: RTDE, the client interfaces and the dashboard.

Sans-I/O: input is bytes with their time, output is pieces to write; a shell has the sockets.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, get_args

from cardan.protocols.ur import dashboard
from cardan.protocols.ur.framing import UNFINISHED_S, ScriptReader
from cardan.protocols.ur.primary import safety_message, state_package, version_message
from cardan.protocols.ur.realtime import RealtimeForm
from cardan.protocols.ur.robot_state import parts
from cardan.protocols.ur.rtde import packet
from cardan.protocols.ur.script import LARGEST
from cardan.sim_peers.base import TimedActions
from cardan.sim_peers.tcp_servers import ServerConnection, TcpServers, TimedAction
from cardan.sim_peers.ur_controller import scripts
from cardan.sim_peers.ur_controller.controller import UrController
from cardan.sim_peers.ur_controller.dashboard_server import Dashboard
from cardan.sim_peers.ur_controller.options import UrControllerOptions
from cardan.sim_peers.ur_controller.pendant import Pendant
from cardan.sim_peers.ur_controller.rtde_server import Claims, RtdeClient
from cardan.sim_peers.ur_controller.state_values import StateValues
from cardan.sim_peers.ur_controller.telemetry import Telemetry

PortKind = Literal[
    "rtde",
    "primary",
    "dashboard",
    "secondary",
    "realtime",
    "primary-read",
    "secondary-read",
    "realtime-read",
]
PORT_KINDS: tuple[PortKind, ...] = get_args(PortKind)

_SCRIPTED: Final = frozenset(("primary", "secondary", "realtime"))
"""Interfaces that take scripts."""
_PRIMARY: Final = frozenset(("primary", "primary-read"))
_STATES: Final = _PRIMARY | {"secondary", "secondary-read"}
_REALTIME: Final = frozenset(("realtime", "realtime-read"))

CLIENTS: Final = 16
"""Simultaneous clients of each port."""
STATE_PERIOD_S: Final = 0.1
"""Period of the primary and the secondary interface."""
_UNKNOWN_TYPE = 0x58
_HEAD = 5
"""Bytes of size and type."""
_OTHER_PROGRAM = "def other():\n  while True:\n    sync()\n  end\nend\n"


@dataclass(eq=False)
class _Connection(ServerConnection[PortKind]):
    rtde: RtdeClient | None = None
    lines: dashboard.DashboardReader = field(default_factory=dashboard.DashboardReader)
    scripts: ScriptReader = field(default_factory=lambda: ScriptReader(LARGEST))
    heard_s: float = 0.0


class UrServers(TcpServers[PortKind, _Connection]):
    """The servers of a `UrController`."""

    kinds = PORT_KINDS
    leaves_out = _STATES | _REALTIME  # ur_rtde sends its script to 30003 and never reads there.
    state_period_s = STATE_PERIOD_S

    def __init__(self, controller: UrController, options: UrControllerOptions) -> None:
        super().__init__(controller.events, options.faults, options.seed)
        self.controller = controller
        self.options = options
        self.telemetry = Telemetry(controller)
        self.pendant = Pendant(controller, self._note, self.histories)
        self._dashboard = Dashboard(controller, self.pendant)
        self._state_values = StateValues(controller, self.telemetry, self.pendant)
        self._realtime = RealtimeForm(options.version[:2])
        self._safety_reported = controller.safety
        self._off = False
        self._frame_due = False
        self._claims = Claims(options.faults)
        self._lines = ""
        """Lines delayed by a fault."""

    def behave(self, faults: Mapping[str, float]) -> None:
        super().behave(faults)
        self._skip_share = faults.get("skip", 0.0)
        self._interfaces_silent = faults.get("interfaces-silent", 0.0) > 0.0
        self._interfaces_close = faults.get("interfaces-close", 0.0) > 0.0
        self._cut_share = faults.get("interfaces-cut", 0.0)
        self._random_share = faults.get("interfaces-garbage", 0.0)
        self._lines_wait = faults.get("lines-wait", 0.0) > 0.0

    # -- connections and time ---------------------------------------------------------------------

    def advance(self, now_s: float) -> None:
        """Run one frame if one is due, and serve the sockets."""
        self._frame_due = True
        super().advance(now_s)

    def takes(self, connection: int) -> bool:
        found = self._connections.get(connection)
        if found is not None and found.kind in _SCRIPTED and self.controller.is_full:
            return False
        return super().takes(connection)

    def _due(self) -> Iterator[float]:
        yield self.controller.next_s
        if not self._silent:
            yield self._next_state_s
        for each in self._connections.values():
            if each.scripts.open:
                yield each.heard_s + UNFINISHED_S

    def _refuses(self, kind: PortKind) -> str:
        if self._off:
            return "the controller is shut down"
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
        elif connection.kind in _STATES:
            version = version_message(self.controller.time_s, self.options.version)
            self._tell(connection, version)
        if self._interfaces_close and connection.kind in _STATES | _REALTIME:
            self._drop(connection, "fault: closed at once")

    def _received(self, connection: _Connection, data: bytes) -> None:
        if connection.rtde is not None:
            connection.rtde.data(data)
            if connection.rtde.failure:
                self._drop(connection, connection.rtde.failure)
        elif connection.kind == "dashboard":
            self._ask(connection, data)
        elif connection.kind in _SCRIPTED:
            connection.heard_s = self._now_s
            connection.scripts.feed(data)
            self._take_scripts(connection)
        self._send_messages()

    def eof(self, connection: int, now_s: float) -> None:
        self._go(now_s)
        found = self._connections.get(connection)
        if found is not None and found.kind in _SCRIPTED and not self._silent:
            self._end_scripts(found)
        super().eof(connection, now_s)

    def _parted(self, connection: _Connection) -> None:
        if connection.rtde is not None:
            connection.rtde.gone()

    def _live(self) -> None:
        controller, now_s = self.controller, self._now_s
        for _, action in self._timed.due(min(now_s, controller.next_s)):
            action()
        if self._frame_due:
            self._frame_due = False
            if controller.advance(now_s):
                self._publish()
        for each in self._connections.values():
            if each.scripts.open and now_s >= each.heard_s + UNFINISHED_S - 1e-9:
                self._end_scripts(each)
        if self._state_due():
            self._publish_state()
        self._send_messages()

    # -- faults -----------------------------------------------------------------------------------

    def _plan(self) -> TimedActions[TimedAction]:
        controller = self.controller
        actions: dict[str, TimedAction] = {
            "protective-stop": lambda: controller.protective_stop("fault"),
            "unlock": controller.unlock_protective_stop,
            "estop": controller.emergency_stop,
            "safeguard-stop": controller.safeguard_stop,
            "safeguard-reset": controller.safeguard_reset,
            "power-off": controller.power_off,
            "pause": controller.pause,
            "resume": controller.resume,
            "program-stop": controller.stop_program,
            "other-program": lambda: controller.upload(_OTHER_PROGRAM),
            "local": self._local,
            "slider-zero": self._slider_zero,
            **self._network_actions(),
        }
        return TimedActions(self.options.faults, actions, start_s=self._now_s)

    def _local(self) -> None:
        self.controller.remote = not self.options.e_series

    def _slider_zero(self) -> None:
        self.controller.slider = 0.0

    # -- received data ----------------------------------------------------------------------------

    def _ask(self, connection: _Connection, data: bytes) -> None:
        lines = connection.lines
        lines.feed(data)
        while (line := lines.take()) is not None or lines.failure:
            if line is None:
                why = f"could not understand: a line of more than {dashboard.LONGEST_LINE} bytes"
                self._put(connection, dashboard.request(why))
                lines.skip()
                continue
            words = line.strip().lower()
            if words == dashboard.QUIT:
                self._put(connection, dashboard.request("Disconnected"))
                self._drop(connection, "quit")
                return
            said = self._dashboard.answer(line)
            self._put(connection, dashboard.request(said))
            if said == dashboard.GRANTED[dashboard.SHUTDOWN]:
                self._shut_down()
                return

    def _shut_down(self) -> None:
        self._off = True
        for each in tuple(self._connections.values()):
            self._drop(each, "the controller is shut down")

    def _take_scripts(self, connection: _Connection) -> None:
        while (text := connection.scripts.take()) is not None:
            if self._lines_wait:
                self._lines += text
                if not scripts.is_program(text):
                    continue
                text, self._lines = self._lines, ""
            scripts.take(self.controller, text)
        if connection.scripts.refused:
            connection.scripts.refused = 0
            self.controller.refuse(f"a program has more than {LARGEST} bytes")

    def _end_scripts(self, connection: _Connection) -> None:
        """Process the rest of the received text: no more data arrive."""
        connection.scripts.end()
        self._take_scripts(connection)

    # -- sent data --------------------------------------------------------------------------------

    def _publish(self) -> None:
        if self._silent:
            return
        frame = self.controller.frames
        realtime: bytes | None = None
        for each in self._connections.values():
            if each.kind in _REALTIME:
                if realtime is None:
                    realtime = self._realtime.pack(self.telemetry.value)
                self._tell(each, realtime)
            if each.rtde is None:
                continue
            for data in each.rtde.packages(frame):
                if self._happens(self._skip_share):
                    continue
                if self._happens(self._garbage_share):
                    self._later(each, _junk(self._random))
                self._later(each, data)

    def _publish_state(self) -> None:
        there = [each for each in self._connections.values() if each.kind in _STATES]
        if not there:
            return
        values = self._state_values
        options = self.options
        data = state_package(
            self.controller.time_s,
            values.modes(),
            parts(values, options.e_series),
            before_3_5=options.version < (3, 5),
        )
        for each in there:
            self._tell(each, data)

    def _send_messages(self) -> None:
        controller = self.controller
        if controller.safety is not self._safety_reported:
            self._safety_reported = controller.safety
            controller.messages.append(safety_message(controller.time_s, controller.safety))
        for each in self._connections.values():
            if each.kind in _PRIMARY:
                for data in controller.messages:
                    self._tell(each, data)
        controller.messages.clear()

    def _tell(self, connection: _Connection, data: bytes) -> None:
        """Send a packet of a client interface."""
        if self._interfaces_silent:
            return
        if self._happens(self._cut_share):
            data = data[: len(data) // 2]
        if self._happens(self._random_share):
            data = data[:_HEAD] + self._random.randbytes(len(data) - _HEAD)
        self._put(connection, data)


def _junk(chance: random.Random) -> bytes:
    return packet(_UNKNOWN_TYPE, chance.randbytes(chance.randrange(0, 40)))  # type: ignore[arg-type]
