"""Universal Robots: RTDE, the client interfaces, the dashboard, URScript, the session, the
simulated controller."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cache
from itertools import pairwise
from typing import Any

from cardan.drivers.ur_rtde.options import UrRtdeOptions
from cardan.drivers.ur_rtde.session import CHANNELS, UrSession
from cardan.protocols.ur import dashboard, primary, realtime, robot_state, rtde
from cardan.protocols.ur.framing import ScriptReader
from cardan.protocols.ur.program import Servoing, program
from cardan.protocols.ur.script import LARGEST, Program, parse
from cardan.protocols.ur.states import RobotMode, SafetyMode
from cardan.protocols.ur.variables import INPUTS, OUTPUTS
from cardan.sim_peers.ur_controller import UrController, UrControllerOptions, UrServers
from cardan.sim_peers.ur_controller.dashboard_server import Dashboard
from cardan.sim_peers.ur_controller.pendant import Pendant
from cardan.sim_peers.ur_controller.state_values import StateValues
from cardan.sim_peers.ur_controller.telemetry import Telemetry
from cardan.types import HoldCommand, RobotLink
from fuzz.target import Form, Packets, Target
from fuzz.targets.common import Clients, all_finite, joined_streams, kinds, text_of
from tests.drivers.ur_bench import SessionBench

_NAMES = ("timestamp", "actual_q")
_TYPES = ("DOUBLE", "VECTOR6D")
_OUTPUTS = tuple(name for name in OUTPUTS if "_register_" not in name)
"""Outputs that a controller computes."""
_WRITTEN = (
    "standard_digital_output_mask",
    "standard_digital_output",
    "standard_analog_output_mask",
    "standard_analog_output_type",
    "standard_analog_output_0",
    "input_bit_registers32_to_63",
    "input_bit_register_64",
    "external_force_torque",
)


def _rtde_feed() -> Callable[[bytes], Iterable[Any]]:
    reader = rtde.PacketReader()

    def feed(data: bytes) -> Iterator[Any]:
        reader.feed(data)
        while (found := reader.take()) is not None:
            for version in rtde.VERSIONS:
                yield rtde.read_reply(*found, version)
                yield rtde.read_request(*found, version)

    return feed


def _rtde(data: bytes) -> object:
    return kinds(joined_streams(_rtde_feed, data))


def _rtde_streams() -> Iterator[bytes]:
    yield rtde.ask_version() + rtde.packet(rtde.PacketType.CONTROLLER_VERSION)
    yield rtde.ask_outputs(500.0, _NAMES) + rtde.ask_inputs(["input_int_register_24"])
    yield rtde.reply_accepted(rtde.PacketType.START, True) + rtde.text("a", "b", 1)  # type: ignore[arg-type]
    yield rtde.reply_version(rtde.ControllerVersion(5, 12, 0, 0)) + rtde.reply_setup(
        rtde.SetupReply(rtde.PacketType.OUTPUTS, 1, _TYPES)
    )
    yield rtde.Recipe(1, _NAMES, _TYPES).pack([1.0, (0.0,) * 6])
    yield rtde.ask_version(1) + rtde.packet(rtde.PacketType.OUTPUTS, ",".join(_NAMES).encode())
    yield rtde.packet(rtde.PacketType.TEXT, b"\2words of version 1")
    yield rtde.ask_outputs(12.5, _OUTPUTS)


def _primary_feed() -> Callable[[bytes], Iterable[Any]]:
    reader = primary.PackageReader()

    def feed(data: bytes) -> Iterator[Any]:
        reader.feed(data)
        while (found := reader.take()) is not None:
            yield primary.read_message(found)
            yield primary.read_mode(found)
            yield robot_state.sub_packages(found)

    return feed


def _primary(data: bytes) -> object:
    return kinds(joined_streams(_primary_feed, data))


def _parts() -> bytes:
    """The sub-packages of a robot state."""
    controller = UrController()
    telemetry, pendant = Telemetry(controller), Pendant(controller, print, ())
    return robot_state.parts(StateValues(controller, telemetry, pendant), True)


def _primary_streams() -> Iterator[bytes]:
    modes = primary.ModeData(True, False, False, True, False, RobotMode.RUNNING, 1.0)
    state = primary.state_package(0.1, modes, _parts())
    yield primary.version_message(0.0, (5, 12, 0, 0)) + state
    yield primary.popup_message(1.0, 1, "a", "b") + primary.label_message(1.0, 2, "c")
    yield primary.safety_message(1.0, SafetyMode.NORMAL) + primary.error_message(
        1.0, 204, 0, primary.ReportLevel.VIOLATION, "d"
    )
    yield primary.key_message(1.0, "PROGRAM_XXX_STARTED", "a") + primary.text_message(1.0, "b")
    yield primary.exception_message(2.0, 3, "c")


_FORMS = tuple(
    realtime.RealtimeForm(version) for version in ((3, 2), (3, 5), (5, 0), (5, 4), (5, 9), (5, 10))
)


def _realtime_feed() -> Callable[[bytes], Iterable[Any]]:
    reader = realtime.RealtimeReader()

    def feed(data: bytes) -> Iterator[Any]:
        reader.feed(data)
        while (found := reader.take()) is not None:
            yield [form.read(found) for form in _FORMS]

    return feed


def _realtime(data: bytes) -> object:
    """A packet has what a version had, if it is not shorter than that."""
    packets = joined_streams(_realtime_feed, data)
    for found in packets:
        for older, newer in pairwise(found):
            assert newer is None or older is not None
    return tuple(sum(each is not None for each in found) for found in packets)


def _realtime_streams() -> Iterator[bytes]:
    controller = UrController()
    value = Telemetry(controller).value
    packets = [form.pack(value) for form in _FORMS]
    yield b"".join(packets)
    yield packets[-1][:-8] + packets[0]


def _dashboard_feed() -> Callable[[bytes], Iterable[Any]]:
    reader = dashboard.DashboardReader()

    def feed(data: bytes) -> Iterator[Any]:
        reader.feed(data)
        while (found := reader.take()) is not None:
            yield found

    return feed


def _dashboard(data: bytes) -> object:
    lines = joined_streams(_dashboard_feed, data)
    return tuple(dashboard.refusal(dashboard.POWER_ON, line) == "" for line in lines[:3])


def _framing_feed() -> Callable[[bytes], Iterable[Any]]:
    reader = ScriptReader(LARGEST)

    def feed(data: bytes) -> Iterator[Any]:
        reader.feed(data)
        while (found := reader.take()) is not None:
            yield found

    return feed


def _framing(data: bytes) -> object:
    """Programs and lines are the same in whatever pieces they come."""
    return len(joined_streams(_framing_feed, data))


def _framings() -> Iterator[bytes]:
    yield b'textmsg("one")\npower on\n# two\ndef a():\n  if True: sync() end\nend\nmovej([0])\n'
    yield _LIVELY.encode()


def _answers(data: bytes) -> object:
    """Each line has an answer of one line."""
    said: list[str] = []
    for robot in ("ur5e", "ur5"):
        controller = UrController(UrControllerOptions(robot=robot, running=True))  # type: ignore[arg-type]
        board = Dashboard(controller, Pendant(controller, said.append, ()))
        for line in text_of(data).split("\n")[:20]:
            answer = board.answer(line)
            assert answer
            dashboard.request(answer)
    return len(said), controller.mode


_LIVELY = """def lively():
  global n = 0
  q = get_target_joint_positions()
  while n < 5 and not False:
    q[0] = q[0] + 0.01 * (n - -1)
    if norm(q[0]) > 1 or n % 2 == 1:
      write_output_float_register(3, q[0])
    elif n == 4:
      break
    else:
      textmsg("n ", n)
    end
    servoj(q, 0, 0, t=0.008, lookahead_time=0.1, gain=300)
    n = n + 1
  end
  speedj([0.1, 0, 0, 0, 0, 0], 2.0, 0.05)
  stopj(4)
end
"""


_WIDE = """def wide():
  global count = 0
  global found = [0, 0]
  def power(base, exponent=2):
    local left = exponent
    if left == 0:
      return 1
    end
    return base * power(base, left - 1)
  end
  thread reads(most):
    while count < most:
      enter_critical
      found = socket_read_binary_integer(1, "s", 0.01)
      text = socket_read_string("s", prefix="<", suffix=">", timeout=0.01)
      floats = socket_read_ascii_float(2, "s", 0.01)
      exit_critical
      count = count + 1
    end
  end
  opened = socket_open("127.0.0.1", 50001, "s")
  socket_send_line(str_cat("a", p[1, 2, 3, 4, 5, 6]), "s")
  handle = run reads(power(2))
  m = [[1, 2], [3, 4]]
  m[0, 1] = 5 % 3
  s = struct(x=m * [1, 2], y="abc")
  s.x[0] = s.x[1] / 2
  switch s.y:
    case "abc":
      textmsg(to_str(s.x), integer_to_binary_list(5))
    default:
      halt
  end
  rtde_set_watchdog("input_int_register_0", 100, "pause")
  set_digital_out(0, True xor False)
  popup("p", blocking=False)
  speedj([0.1, 0, 0, 0, 0, 0], 2.0, 0.01)
  ft_rtde_input_enable(True, 0.1, [0, 0, 0.05], [0, 0, 0])
  direct_torque([5, -5, 2, 0.1, 0, 0], friction_comp=False)
  join handle
  kill handle
  socket_close("s")
  stopj(4)
end
"""
_READS = b"\0\0\0\7<text>(1.5, -2)"


def _script(data: bytes) -> object:
    """Run a program for a while; whatever it does, the controller must accept the next program."""
    found = parse(text_of(data))
    controller = UrController(UrControllerOptions(running=True, program_start_s=0.0))
    now_s = 0.0
    controller.advance(now_s)
    controller.upload(text_of(data))
    for _ in range(20):
        now_s += controller.period_s
        controller.advance(now_s)
        for opening in controller.sockets.openings():
            controller.sockets.opened(opening.number)
            controller.sockets.data(opening.number, _READS)
        controller.sockets.outgoing()
        controller.sockets.closings()
    controller.upload("sec beside():\n  set_digital_out(0, True)\nend\n")
    all_finite(controller.motion.target_q)
    all_finite(controller.registers.output_double)
    return isinstance(found, Program), controller.runtime, controller.safety


def _scripts() -> Iterator[bytes]:
    yield _LIVELY.encode()
    yield _WIDE.encode()
    yield program(Servoing(), 77, 0.002).encode()


def _session(packets: Packets) -> object:
    """A session drops what it cannot trust, connects again, and hears a good controller."""
    now_s = 100.0
    session = UrSession(UrRtdeOptions(), iter(range(1, 1000)).__next__)

    def step() -> None:
        session.advance(now_s)
        session.closing()
        session.outgoing()
        for channel in CHANNELS:
            if session.wants(channel, now_s):
                session.connected(channel, now_s)
        if (state := session.due_state(now_s)) is not None:
            all_finite(state.joints)
            session.command(HoldCommand(), now_s)
            assert state.link in RobotLink

    step()
    for number, packet in enumerate(packets):
        now_s += 0.002
        step()
        if number in (3, 9):
            session.ask("enable" if number == 3 else "unlock", now_s)
        if packet:
            session.received(CHANNELS[packet[0] % 3], packet[1:], now_s)
    diagnosis = session.diagnosis(now_s)
    session.metrics()
    now_s += 30.0
    session.disconnected("rtde", "closed", now_s)
    for _ in range(3):
        now_s += 5.0
        step()
    for data in _greeting():
        now_s += 0.002
        session.received("rtde", data, now_s)
        step()
    assert session.phase != "down", session.diagnosis(now_s)
    return tuple(diagnosis)


@cache
def _recorded() -> tuple[Packets, Packets]:
    """Packets of the simulated controller to a session from its beginning on, and the first ones
    of RTDE alone."""
    bench = SessionBench()
    said: list[bytes] = []
    greeting: list[bytes] = []
    taken = bench.session.received

    def received(channel: Any, data: bytes, now_s: float) -> None:
        if len(said) < 60:
            said.append(bytes([CHANNELS.index(channel)]) + data)
        if channel == "rtde" and len(greeting) < 8:
            greeting.append(data)
        taken(channel, data, now_s)

    bench.session.received = received  # type: ignore[method-assign]
    bench.run(0.03)
    bench.session.ask("enable", bench.now_s)
    bench.run(0.2)
    return tuple(said), tuple(greeting)


def _greeting() -> Packets:
    return _recorded()[1]


def _session_packets() -> Iterator[Packets]:
    yield _recorded()[0]


def _controller(packets: Packets) -> object:
    """Each packet after a byte for its port; afterwards a client is answered."""
    options = UrControllerOptions(running=True)
    controller = UrController(options)
    servers = UrServers(controller, options)
    clients = Clients(servers, 0.002)
    clients.feed(packets)
    all_finite(controller.motion.target_q)
    now_s = clients.now_s + 0.002
    fresh = servers.accepted("rtde", now_s)
    if fresh is None:
        assert any("shut down" in text for _, text in servers.events)
        return None
    servers.data(fresh, rtde.ask_version(), now_s)
    assert rtde.reply_accepted(rtde.PacketType.PROTOCOL_VERSION, True) in clients.heard()
    return controller.mode, controller.safety, controller.runtime


def _controller_packets() -> Iterator[Packets]:
    inputs = ["input_int_register_24", "input_double_register_24", "speed_slider_mask"]
    setup = rtde.ask_version() + rtde.ask_outputs(500.0, _NAMES) + rtde.ask_inputs(inputs)
    write = rtde.Recipe(1, inputs, ["INT32", "DOUBLE", "UINT32"]).pack([1, 0.5, 1])
    yield (
        b"\0" + setup,
        b"\0" + rtde.packet(rtde.PacketType.START),
        b"\1" + _LIVELY.encode(),
        b"\0" + write,
        b"\2power off\nrobotmode\n",
        b"\2power on\nunlock protective stop\nquit\n",
        b"\3stopj(2)\n# a\npower off\n",
        b"\4def a():\n  sync()\n",
        b"\5\n",
        b"\2shutdown\n",
        b"\0" + rtde.packet(rtde.PacketType.PAUSE),
    )
    written = rtde.Recipe(1, _WRITTEN, [INPUTS[name] for name in _WRITTEN])
    yield (
        b"\0" + rtde.ask_version() + rtde.ask_outputs(500.0, _OUTPUTS) + rtde.ask_inputs(_WRITTEN),
        b"\0" + rtde.packet(rtde.PacketType.START),
        b"\1" + _LIVELY.encode(),
        b"\0" + written.pack([1, 1, 3, 2, 0.5, 1 << 31, True, (1.0,) * 6]),
    )
    yield (
        b"\0" + rtde.ask_version(1),
        b"\0" + rtde.packet(rtde.PacketType.OUTPUTS, ",".join(_OUTPUTS).encode()),
        b"\0" + rtde.packet(rtde.PacketType.START),
        b"\1" + _LIVELY.encode(),
    )


TARGETS = (
    Target("ur.rtde", Form.BYTES, _rtde, _rtde_streams),
    Target("ur.primary", Form.BYTES, _primary, _primary_streams),
    Target("ur.realtime", Form.BYTES, _realtime, _realtime_streams),
    Target(
        "ur.dashboard",
        Form.TEXT,
        _dashboard,
        lambda: (b"Connected: Universal Robots Dashboard Server\nPowering on\ntrue\n",),
    ),
    Target(
        "ur.answers",
        Form.TEXT,
        _answers,
        lambda: (b"load a.urp\nset operational mode manual\nsetUserRole none\nsaveLog\nhelp\n",),
    ),
    Target("ur.framing", Form.TEXT, _framing, _framings),
    Target("ur.script", Form.TEXT, _script, _scripts, slow_s=0.3),
    Target("ur_rtde.session", Form.PACKETS, _session, _session_packets, slow_s=0.3),
    Target("ur_controller", Form.PACKETS, _controller, _controller_packets, slow_s=0.3),
)
