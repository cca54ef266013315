"""Scenario for a Universal Robots controller: read states, send programs, turn a joint a little.

The program that follows registers is the one that our driver sends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any

from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Scenario, Script, Step, ask, close, mark, open_, send
from cardan.conform.streams import ChannelReaders
from cardan.conform.timeline import Kind, WireEvent
from cardan.conform.ur_rtde.decoded import (
    OLD,
    PRIMARY,
    REALTIME,
    REVERSE,
    RTDE,
    SECOND,
    SECONDARY,
)
from cardan.protocols.ur import dashboard, rtde
from cardan.protocols.ur.program import (
    JOINTS,
    ProgramCommand,
    ProgramStatus,
    Servoing,
    input_names,
    nobody,
    program,
    report_names,
)
from cardan.protocols.ur.states import MOVES_IN, RobotMode, RuntimeState, SafetyMode
from cardan.protocols.ur.variables import OUTPUT_VARIABLES

SERVOING = Servoing()
"""The driver's defaults: its registers, its program's watchdog."""
STATES = (
    "timestamp",
    "target_q",
    "target_qd",
    "actual_q",
    "actual_qd",
    "robot_mode",
    "safety_mode",
    "runtime_state",
    "speed_scaling",
    "target_speed_fraction",
)
"""Outputs that the driver requests."""
STATE_TIMEOUT_S = 0.1
"""The driver's default timeout, after which the link counts as lost."""
FIRST = SERVOING.first_register
INPUTS = input_names(FIRST)
TOKEN, REPORT, BEAT = report_names(FIRST)
LAST_JOINT = INPUTS[3 + JOINTS - 1]
"""Input of the last joint's target."""
OUTPUTS = (*STATES, "robot_status_bits", "safety_status_bits", TOKEN, REPORT, BEAT)

FUTURE_VERSION = 99
UNKNOWN = "cardan_has_no_such_variable"
SPARE_INPUT = "input_double_register_47"
"""A free input: another client takes it, disconnects, and connects again."""
SLOWER = 10
"""Divisor of the package rate of the other client."""
SAYS = "cardan conform"
LINE = "a line"
WRONG = "cardan_wrong"
RAISES, CALLS = "cardan_raises", "cardan_calls"
RAISES_AT = 4
"""Number of the line of that program that fails."""
ANSWER = "heard"
ASKING = (dashboard.ROBOT_MODE, dashboard.SAFETY_STATUS, dashboard.REMOTE_CONTROL)
WORDED = (
    "safetymode",
    "running",
    "programState",
    "get loaded program",
    "isProgramSaved",
    "PolyscopeVersion",
)
"""Requests sent once, for the words of the answers."""
OLD_OUTPUTS = ("timestamp", "actual_q")
RECIPE_NAMES = 64
"""Published variables per request."""
REVERSE_PORT = 50010
"""Port of the suite, to which a program opens a socket."""
NONSENSE = "cardan has no such request"

STEP_RAD = math.radians(0.2)
"""Step of the last joint, which only turns the flange."""
STEP_S = 0.4
DESERTED_RAD_S = math.radians(0.5)
DESERTED_S = 0.2

REPLY_S = 1.0
"""The driver's timeout of an answer."""
BEGIN_S = 2.0
END_S = 1.5
POWER_S = 40.0
HAND_S = 60.0
LINE_S = 0.3
CALL_S = 5.0
"""Programs wait for an answer for 2 s by default."""
SLEEP_S = 0.2

_Path = Callable[[float], tuple[float, float]]
"""The last joint's offset from its start, rad, and its speed, rad/s, at a time since then, s."""


def _there(by_rad: float) -> _Path:
    """Return a path of half a cosine by `by_rad`, from rest to rest."""

    def at(time_s: float) -> tuple[float, float]:
        phase = math.pi * min(max(time_s / STEP_S, 0.0), 1.0)
        speed = 0.5 * by_rad * math.pi / STEP_S * math.sin(phase)
        return 0.5 * by_rad * (1.0 - math.cos(phase)), speed

    return at


def _steady(speed_rad_s: float) -> _Path:
    return lambda time_s: (speed_rad_s * time_s, speed_rad_s)


def _program(name: str, token: int, *lines: str) -> str:
    """Return a program that first writes `token`, which shows that it runs."""
    begin = f"write_output_integer_register({FIRST}, {token})"
    return "\n  ".join((f"def {name}():", begin, *lines)) + "\nend\n"


def says(token: int) -> str:
    """Return a program that moves nothing: it sends a text message, and waits."""
    return _program("cardan_says", token, f'textmsg("{SAYS} ", {token})', f"sleep({SLEEP_S})")


def raises(token: int) -> str:
    """Return a program that starts, and fails shortly after."""
    lines = "local cardan_list = [1, 2]", f'textmsg("{SAYS} ", cardan_list[5])'
    return _program(RAISES, token, *lines)


def calls(token: int, host: str, port: int) -> str:
    """Return a program that reads a line from a socket to `host` into a text message."""
    return _program(
        CALLS,
        token,
        f'if socket_open("{host}", {port}, "cardan"):',
        f'  socket_send_line("{SAYS} {token}", "cardan")',
        f'  textmsg("{SAYS} {token} ", socket_read_line("cardan"))',
        '  socket_close("cardan")',
        "end",
    )


def published(version: rtde.ControllerVersion | None) -> tuple[str, ...]:
    """Return the output variables that a controller of that version has."""
    if version is None:
        return ()
    found = ((name, each.since(version.major)) for name, each in OUTPUT_VARIABLES.items())
    return tuple(name for name, since in found if since is not None and since <= version[:2])


_WRONG = f"def {WRONG}():\n  cardan_has_no_such_function(1)\nend\n"


class UrScenario(Scenario):
    """A client that has one request open at a time, and answers states as the driver does."""

    def __init__(self, level: Level, seconds: float, home: str = "127.0.0.1") -> None:
        """`home`: our address, as the controller reaches it."""
        self._level = level
        self._seconds = seconds
        self._home = home
        self._streams = ChannelReaders(lambda _: rtde.PacketReader(), lambda *_: None)
        self._reply: rtde.Reply | None = None
        self._said = dashboard.DashboardReader()
        self._lines = 0
        self._line = ""
        self._remote = self._local = False
        self._lost: set[str] = set()
        self._version: rtde.ControllerVersion | None = None
        self._outputs: rtde.Recipe | None = None
        self._inputs: rtde.Recipe | None = None
        self._values: dict[str, Any] = {}
        self._token = 1000
        self._beat = 0
        self._base: Sequence[float] = ()
        self._path: _Path | None = None
        self._path_s = 0.0

    # -- received data ----------------------------------------------------------------------------

    def answer(self, event: WireEvent) -> Iterator[Step]:
        channel = event.channel
        if event.kind is Kind.OPENED:
            self._streams.begin(channel)
            self._lost.discard(channel)
        elif event.kind in (Kind.CLOSED, Kind.REFUSED):
            self._lost.add(channel)
        elif event.kind is Kind.DATA and channel == "dashboard":
            self._said.feed(event.data)
            while (line := self._said.take()) is not None:
                self._lines, self._line = self._lines + 1, line.strip()
        elif event.kind is Kind.DATA and channel.startswith(RTDE):
            return self._packets(event)
        elif event.kind is Kind.DATA and channel.startswith(REVERSE):
            return iter((send(f"{ANSWER}\n".encode(), channel),))
        return iter(())

    def _packets(self, event: WireEvent) -> Iterator[Step]:
        channel, fresh = event.channel, False
        for _, (kind, payload) in self._streams.whole(0, event):
            reply = rtde.read_reply(kind, payload, 1 if channel == OLD else rtde.VERSION)
            if isinstance(reply, rtde.Data):
                fresh = self._state(channel, reply) or fresh
            elif not isinstance(reply, (rtde.MalformedPayload, rtde.TextMessage)):
                self._reply = reply
        if fresh and self._path is not None:
            yield from self._follow(*self._path(self.now_s - self._path_s))

    def _state(self, channel: str, data: rtde.Data) -> bool:
        recipe = self._outputs
        if channel != RTDE or recipe is None or data.recipe != recipe.number:
            return False
        values = recipe.unpack(data.values)
        if values is not None:
            self._values = values
        return values is not None

    def _follow(self, shift: float, speed: float) -> Iterator[Step]:
        still = [0.0] * (JOINTS - 1)
        goal = [*self._base[:-1], self._base[-1] + shift]
        yield from self._write(ProgramCommand.FOLLOW, goal, [*still, speed])

    def _write(
        self, order: ProgramCommand, goal: Sequence[float], speeds: Sequence[float]
    ) -> Iterator[Step]:
        if self._inputs is not None:
            self._beat += 1
            values = [self._token, self._beat, int(order), *goal, *speeds]
            yield send(self._inputs.pack(values), RTDE)

    # -- requests ---------------------------------------------------------------------------------

    def script(self) -> Script:
        yield from self._listening()
        if self._level < Level.HOLD:
            return
        yield from self._setting_up()
        yield from self._powering()
        yield from self._programs()
        if self._level >= Level.MOVE:
            yield from self._moving()
        if self._level >= Level.BY_HAND:
            yield from self._by_hand()
        yield mark("leave")
        yield from self._reported_lines()
        if self._inputs is not None:
            yield send(self._inputs.pack(nobody(self._beat + 1)), RTDE)
            yield Pause(0.05)

    def _listening(self) -> Script:
        yield open_(RTDE)
        yield mark("greet")
        yield from self._asked(rtde.ask_version())
        yield from self._asked(rtde.packet(rtde.PacketType.CONTROLLER_VERSION))
        if isinstance(self._reply, rtde.ControllerVersion):
            self._version = self._reply
        rate_hz = rtde.control_rate_hz(self._version)
        self._outputs = yield from self._recipe(rtde.ask_outputs(rate_hz, OUTPUTS), OUTPUTS)
        yield mark("listen")
        yield from self._asked(rtde.packet(rtde.PacketType.START))
        yield Pause(self._seconds / 3.0)
        yield mark("pause")
        yield from self._asked(rtde.packet(rtde.PacketType.PAUSE))
        yield Pause(0.1)
        yield mark("go on")
        yield from self._asked(rtde.packet(rtde.PacketType.START))
        yield Pause(0.1)
        yield mark("other")
        yield open_(SECOND)
        yield from self._asked(rtde.ask_version(FUTURE_VERSION), SECOND)
        yield from self._asked(rtde.ask_version(), SECOND)
        yield from self._asked(rtde.ask_outputs(1.0, ("timestamp", UNKNOWN)), SECOND)
        yield from self._asked(rtde.ask_outputs(rate_hz / SLOWER, ("timestamp",)), SECOND)
        yield from self._asked(rtde.packet(rtde.PacketType.START), SECOND)
        yield Pause(0.4)
        yield close(SECOND)
        yield from self._published()
        yield from self._version_1()
        yield mark(PRIMARY)
        yield open_(PRIMARY)
        yield open_(SECONDARY)
        yield open_(REALTIME)
        yield Pause(0.5)
        yield close(REALTIME)
        yield close(SECONDARY)
        yield mark("dashboard")
        yield open_("dashboard")
        yield Pause(REPLY_S, lambda: self._lines > 0 or "dashboard" in self._lost)
        yield from self._reported_lines()
        for words in WORDED:
            yield from self._requested(words)

    def _published(self) -> Script:
        yield mark("published")
        yield from self._other_client()
        names = published(self._version)
        for at in range(0, len(names), RECIPE_NAMES):
            yield from self._asked(rtde.ask_outputs(1.0, names[at : at + RECIPE_NAMES]), SECOND)
        yield close(SECOND)

    def _version_1(self) -> Script:
        yield mark("version 1")
        yield open_(OLD)
        yield from self._asked(rtde.ask_version(1), OLD)
        if isinstance(self._reply, rtde.Accepted) and self._reply.accepted:
            names = ",".join(OLD_OUTPUTS).encode()
            yield from self._asked(rtde.packet(rtde.PacketType.OUTPUTS, names), OLD)
            yield from self._asked(rtde.packet(rtde.PacketType.START), OLD)
            yield Pause(0.3)
        yield close(OLD)

    def _reported_lines(self) -> Script:
        for words in ASKING:
            yield from self._requested(words)
        # A CB3 has no remote control, and does not understand the question.
        self._remote = self._line.lower() == "true"
        self._local = self._line.lower() == "false"

    def _setting_up(self) -> Script:
        yield mark("inputs")
        self._inputs = yield from self._recipe(rtde.ask_inputs(INPUTS), INPUTS)
        data = rtde.packet(rtde.PacketType.CONTROLLER_VERSION)
        self._reply = None
        yield mark("pieces")
        yield send(data[:1], RTDE)
        yield Pause(0.03)
        yield send(data[1:], RTDE)
        yield Pause(REPLY_S, self._answered(RTDE))
        yield mark("taken")
        yield from self._other_client()
        yield from self._asked(rtde.ask_inputs(INPUTS), SECOND)
        yield from self._asked(rtde.ask_inputs((UNKNOWN,)), SECOND)
        yield from self._asked(rtde.ask_inputs((SPARE_INPUT,)), SECOND)
        yield close(SECOND)
        yield Pause(0.2)
        yield mark("free")
        yield from self._other_client()
        yield from self._asked(rtde.ask_inputs((SPARE_INPUT,)), SECOND)
        yield close(SECOND)
        yield mark("nonsense")
        yield from self._requested(NONSENSE)

    def _other_client(self) -> Script:
        yield open_(SECOND)
        yield from self._asked(rtde.ask_version(rtde.VERSION), SECOND)

    def _powering(self) -> Script:
        yield mark("power")
        if self._values.get("safety_mode") not in MOVES_IN:
            return
        for mode, words in (
            (RobotMode.POWER_OFF, dashboard.POWER_ON),
            (RobotMode.IDLE, dashboard.BRAKE_RELEASE),
        ):
            if self._mode == mode:
                yield from self._requested(words)
                if not dashboard.refusal(words, self._line):
                    yield Pause(POWER_S, self._farther(mode))
        yield Pause(0.05)

    def _farther(self, mode: RobotMode) -> Callable[[], bool]:
        steady = {RobotMode.POWER_OFF, RobotMode.IDLE, RobotMode.RUNNING} - {mode}
        return lambda: self._mode in steady or RTDE in self._lost

    def _programs(self) -> Script:
        yield mark("say")
        yield from self._saying()
        yield mark("wrong")
        if self._may_begin():
            yield send(_WRONG.encode(), PRIMARY)
            yield Pause(0.5)
        yield mark("begin")
        yield from self._begun()
        yield mark("hold")
        yield from self._followed(_steady(0.0), self._seconds)
        yield mark("silence")
        yield from self._deserted()
        yield mark("again")
        yield from self._begun()
        yield from self._followed(_steady(0.0), 0.2)
        yield mark("order")
        self._path = None
        if self._follows():
            yield from self._write(ProgramCommand.END, self._base, [0.0] * JOINTS)
            yield Pause(END_S, self._stopped)
        yield mark("replace")
        yield from self._begun()
        yield from self._followed(_steady(0.0), 0.1)
        yield mark("replaced")
        self._path = None
        if self._follows():
            yield from self._saying(always=True)
        yield mark("lines")
        if self._may_begin():
            for line in (f'textmsg("{SAYS} {LINE}")', "# cardan", "stop program"):
                yield send(f"{line}\n".encode(), PRIMARY)
                yield Pause(LINE_S)
            yield from self._saying(always=True)
        yield mark("raise")
        if self._may_begin():
            yield from self._run(raises)
        yield mark("call")
        yield from self._called()
        yield mark("elsewhere")
        for channel in (SECONDARY, REALTIME):
            yield open_(channel)
            yield Pause(0.05)
            yield from self._saying(channel=channel)
            yield close(channel)

    def _called(self) -> Script:
        if not self._may_begin():
            return
        yield open_(REVERSE)
        if REVERSE in self._lost:
            return
        yield from self._run(lambda token: calls(token, self._home, REVERSE_PORT), end_s=CALL_S)
        yield close(REVERSE)

    def _moving(self) -> Script:
        yield mark("ready")
        yield from self._begun()
        if not self._follows():
            return
        start = self._base[-1]
        yield mark("out")
        yield from self._followed(_there(STEP_RAD), STEP_S + 0.5)
        yield mark("steady")
        self._base = [*self._base[:-1], start + STEP_RAD]
        yield from self._followed(_steady(-DESERTED_RAD_S), DESERTED_S)
        yield mark("deserted")
        yield from self._deserted()
        yield Pause(0.3)
        yield mark("return")
        yield from self._begun()
        yield mark("back")
        yield from self._followed(_there(start - self._base[-1]), STEP_S + 0.5)
        yield mark("rest")
        yield from self._deserted()

    def _by_hand(self) -> Script:
        for name, how, there in (
            ("slider-half", "Move the speed slider to about 50 %.", self._slider(0.3, 0.7)),
            ("slider-full", "Move the speed slider back to 100 %.", self._slider(0.95, 1.05)),
        ):
            yield mark(name)
            yield ask(name, how)
            yield Pause(HAND_S, there)
            yield Pause(0.2)
        if self._remote:
            yield mark("local")
            yield ask("local", "Choose local control at the pendant.")
            yield from self._polled(dashboard.REMOTE_CONTROL, "false")
            yield from self._saying()
            yield mark("remote")
            yield ask("remote", "Choose remote control again.")
            yield from self._polled(dashboard.REMOTE_CONTROL, "true")
        yield mark("before")
        yield from self._begun()
        yield from self._followed(_steady(0.0), 0.2)
        yield mark("estop")
        yield ask("estop", "Press the emergency stop.")
        yield Pause(HAND_S, self._stopped_by_hand)
        yield Pause(1.0)
        self._path = None
        yield from self._reported_lines()
        yield mark("release")
        yield ask("release", "Release the emergency stop.")
        yield Pause(HAND_S, lambda: not self._stopped_by_hand())
        yield Pause(0.5)

    # -- single requests --------------------------------------------------------------------------

    @property
    def _mode(self) -> int:
        return int(self._values.get("robot_mode", RobotMode.NO_CONTROLLER))

    def _answered(self, channel: str) -> Callable[[], bool]:
        return lambda: self._reply is not None or channel in self._lost

    def _asked(self, data: bytes, channel: str = RTDE) -> Script:
        self._reply = None
        if channel not in self._lost:
            yield send(data, channel)
            yield Pause(REPLY_S, self._answered(channel))

    def _recipe(
        self, data: bytes, names: Sequence[str]
    ) -> Generator[Step | Pause, None, rtde.Recipe | None]:
        """Send a setup on the tested connection; return its recipe, None if there is none."""
        yield from self._asked(data)
        reply = self._reply
        if not isinstance(reply, rtde.SetupReply) or not reply.recipe:
            return None
        try:
            return rtde.Recipe(reply.recipe, names, reply.types)
        except ValueError:
            return None

    def _requested(self, words: str) -> Script:
        """Send a request to the dashboard server; its answer is in `_line`."""
        before, self._line = self._lines, ""
        if "dashboard" not in self._lost:
            yield send(dashboard.request(words), "dashboard")
            yield Pause(REPLY_S, lambda: self._lines > before or "dashboard" in self._lost)

    def _polled(self, words: str, until: str) -> Script:
        end_s = self.now_s + HAND_S
        self._line = ""
        while self.now_s < end_s and self._line.lower() != until:
            yield from self._requested(words)
            yield Pause(0.2)

    def _stopped(self) -> bool:
        stopped = self._values.get("runtime_state") == RuntimeState.STOPPED
        return stopped or RTDE in self._lost

    def _follows(self) -> bool:
        values = self._values
        return (
            values.get("runtime_state") == RuntimeState.PLAYING
            and values.get(TOKEN) == self._token
            and values.get(REPORT) == ProgramStatus.FOLLOWS
        )

    def _may_begin(self) -> bool:
        """True if a program of ours can start without stopping another client's."""
        values = self._values
        return (
            not self._lost & {RTDE, PRIMARY}
            and not self._local
            and self._inputs is not None
            and values.get("runtime_state") == RuntimeState.STOPPED
            and self._mode == RobotMode.RUNNING
            and values.get("safety_mode") in MOVES_IN
        )

    def _next_token(self) -> None:
        """Advance the token past the register's value, which may be an earlier run's."""
        self._token = max(self._token, int(self._values.get(TOKEN, 0)) % (1 << 30)) + 1

    def _saying(self, always: bool = False, channel: str = PRIMARY) -> Script:
        """Run the program that sends a text message if no program runs, or `always`."""
        if (always or self._may_begin()) and channel not in self._lost:
            yield from self._run(says, channel, rest_s=0.05)

    def _run(
        self,
        made: Callable[[int], str],
        channel: str = PRIMARY,
        end_s: float = END_S,
        rest_s: float = 0.1,
    ) -> Script:
        """Run a program that ends by itself."""
        self._next_token()
        yield send(made(self._token).encode(), channel)
        yield Pause(BEGIN_S, lambda: RTDE in self._lost or self._values.get(TOKEN) == self._token)
        yield Pause(end_s, self._stopped)
        yield Pause(rest_s)

    def _begun(self) -> Script:
        """Start the driver's program, and wait until it follows."""
        self._path = None
        if not self._may_begin():
            return
        assert self._inputs is not None
        self._next_token()
        self._beat += 1
        yield send(self._inputs.pack(nobody(self._beat)), RTDE)
        yield Pause(0.02)
        period_s = 1.0 / rtde.control_rate_hz(self._version)
        yield send(program(SERVOING, self._token, period_s).encode(), PRIMARY)
        yield Pause(BEGIN_S, lambda: self._follows() or RTDE in self._lost)
        if self._values:
            self._base = self._values["target_q"]

    def _followed(self, path: _Path, seconds: float) -> Script:
        """Wait for `seconds` while states are answered along `path`, until `_path` is None."""
        if self._follows():
            self._path, self._path_s = path, self.now_s
            yield Pause(seconds, lambda: RTDE in self._lost)

    def _deserted(self) -> Script:
        self._path = None
        yield Pause(END_S, self._stopped)
        yield Pause(0.1)

    def _slider(self, low: float, high: float) -> Callable[[], bool]:
        return lambda: low < self._values.get("target_speed_fraction", 0.0) < high

    def _stopped_by_hand(self) -> bool:
        stops = (SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.SYSTEM_EMERGENCY_STOP)
        return self._values.get("safety_mode") in stops
