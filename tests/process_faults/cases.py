"""Faults while the arm moves: the declared cases, and the required outcome of each."""

from __future__ import annotations

import base64
import contextlib
import enum
import functools
import json
import os
import resource
import signal
import socket
import struct
import threading
from collections.abc import Callable
from typing import NamedTuple

from cardan.common.signals import ENDING_SIGNALS, signal_name
from cardan.errors import CardanError
from cardan.gateway.daemon.client import daemon_arm
from cardan.gateway.daemon.control import Ask, encode_ask
from tests.process_faults.lab import (
    GOFA,
    GP8,
    PAIRS,
    ROS2,
    SPNAV,
    UR5,
    Child,
    Lab,
    Pair,
    descendants_of,
    toml,
    wait,
    words_of,
)

BEAT_S = 0.6
"""Longest time from the supervisor's silence until a session brakes, including the period of its
heartbeat."""
GONE_S = 0.1
"""Time until a session notices that its supervisor has ended: the period of its snapshots."""
STALE_S = 0.3
"""Silence after which a device counts as lost: the longest of the devices here."""
LATE_S = 0.5
"""Tolerance in all bounds for a computer with other work."""

WATCH_S = 2.0
GOES_ON_S = 1.0
BACK_S = 25.0
"""Longest wait for a session that restarts by itself."""


class Outcome(enum.Enum):
    """Required reaction of the arm."""

    STOPS = "stops"
    GOES_ON = "goes on"
    EITHER = "either"
    """Allowed for stalls of a few milliseconds, whose effect depends on where they begin."""


Act = Callable[[Lab, contextlib.ExitStack], None]
"""Causes the fault; cleanups on the stack run after the arm was watched."""

Within = Callable[[Pair], float]


class Case(NamedTuple):
    """A fault, for a pair of device and robot."""

    name: str
    group: str
    pair: str
    act: Act
    outcome: Outcome
    within: Within = lambda _: 0.0
    """Longest time to rest, s."""
    watch_s: float = WATCH_S
    dies: bool = False
    """The session's process ends, and must restart by itself with its arm disarmed."""
    run: bool = False
    """The case uses ``cardan run`` instead of the daemon."""
    loses: bool = False
    """Events cannot be written during the fault."""
    long: bool = False

    @property
    def ends(self) -> bool:
        """True if a process ends."""
        return self.outcome is Outcome.STOPS and "stands still" not in self.name

    @property
    def key(self) -> str:
        return f"{self.group}: {self.name} ({self.pair})"


def dies(pair: Pair) -> float:
    return pair.dies_s


def brakes(pair: Pair) -> float:
    return pair.brakes_s


def after(seconds: float, then: Within) -> Within:
    """Add a delay to the time of `then`."""
    return lambda pair: seconds + then(pair)


def either(*several: Within) -> Within:
    return lambda pair: max(each(pair) for each in several)


# -- actions --------------------------------------------------------------------------------------

Pid = Callable[[Lab], int]


def session(lab: Lab) -> int:
    return lab.session_pid


def daemon(lab: Lab) -> int:
    assert lab.daemon is not None
    return lab.daemon.pid


def gateway_server(lab: Lab) -> int:
    return lab.server_pid


def router(lab: Lab) -> int:
    return lab.router_pid


def robot(lab: Lab) -> int:
    assert lab.robot is not None
    return lab.robot.pid


def device(lab: Lab) -> int:
    assert lab.hand is not None
    return lab.hand.pid


def server(lab: Lab) -> int:
    assert lab.server is not None
    return lab.server.pid


def send(pid: Pid, number: int) -> Act:

    def act(lab: Lab, _: contextlib.ExitStack) -> None:
        found = pid(lab)
        lab.hit()
        os.kill(found, number)

    return act


def stop(pid: Pid, seconds: float) -> Act:
    """Stop the process for this time (SIGSTOP)."""

    def act(lab: Lab, _: contextlib.ExitStack) -> None:
        found = pid(lab)
        lab.hit()
        os.kill(found, signal.SIGSTOP)
        lab.pause(seconds)
        with contextlib.suppress(ProcessLookupError):
            os.kill(found, signal.SIGCONT)

    return act


def limit(pid: Pid, what: int, value: Callable[[int], int], then: Act | None = None) -> Act:
    """Lower a resource limit of the process; restore it afterwards."""

    def act(lab: Lab, stack: contextlib.ExitStack) -> None:
        found = pid(lab)
        _, hard = old = resource.prlimit(found, what)
        lab.hit()
        resource.prlimit(found, what, (value(found), hard))

        def undo() -> None:
            with contextlib.suppress(ProcessLookupError):
                resource.prlimit(found, what, old)

        stack.callback(undo)
        if then is not None:
            then(lab, stack)

    return act


def descriptors(pid: int) -> int:
    """Number of file descriptors that the process has open."""
    return max(int(name) for name in os.listdir(f"/proc/{pid}/fd")) + 1


def no_descriptors(pid: Pid, then: Act | None = None) -> Act:
    return limit(pid, resource.RLIMIT_NOFILE, descriptors, then)


def refused(lab: Lab) -> None:
    """A program requests a motion of the arm while the operator device has it, which causes an
    event."""
    with contextlib.suppress(CardanError), daemon_arm("arm", path=lab.socket) as arm:
        arm.movl([0.4, 0.1, 0.4, 3.14, 0.0, 0.0])


def disk_full(lab: Lab, stack: contextlib.ExitStack) -> None:
    """No file of the daemon can grow any more, including its event log and its own log."""
    limit(daemon, resource.RLIMIT_FSIZE, lambda _: 1)(lab, stack)
    asking = threading.Thread(target=refused, args=(lab,))
    asking.start()
    lab.swing(lambda: not asking.is_alive())


def clients(lab: Lab, stack: contextlib.ExitStack, web: bool = False) -> None:
    """Programs connect to the daemon, or to rosbridge."""
    for _ in range(20):
        sock = socket.socket() if web else socket.socket(socket.AF_UNIX)
        stack.callback(sock.close)
        sock.settimeout(1.0)
        sock.connect(("127.0.0.1", lab.server_port) if web else lab.socket)


web_clients = functools.partial(clients, web=True)


def reader_that_stops(*asks: Ask) -> Act:
    """A client that sends the daemon every request and reads no reply."""

    def act(lab: Lab, stack: contextlib.ExitStack) -> None:
        sock = socket.socket(socket.AF_UNIX)
        stack.callback(sock.close)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        sock.settimeout(0.2)
        sock.connect(lab.socket)
        with contextlib.suppress(OSError):
            for _ in range(500):
                for ask in asks:
                    sock.sendall(encode_ask(ask))

    return act


def web_client(lab: Lab, stack: contextlib.ExitStack) -> None:
    """A rosbridge client that subscribes to the arm's topics and never reads."""
    sock = socket.create_connection(("127.0.0.1", lab.server_port), 5.0)
    stack.callback(sock.close)
    key = base64.b64encode(os.urandom(16)).decode()
    sock.sendall(
        f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{lab.server_port}\r\nUpgrade: websocket\r\n"
        f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\n"
        "Sec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    assert sock.recv(4096).startswith(b"HTTP/1.1 101")
    for topic in ("/joint_states", "/arm/state/pose", "/tf", "/arm/state/target"):
        data = json.dumps({"op": "subscribe", "topic": topic}).encode()
        sock.sendall(struct.pack("!BB4s", 0x81, 0x80 | len(data), bytes(4)) + data)


def second_daemon(lab: Lab, _: contextlib.ExitStack) -> None:
    """Start another daemon at the same socket."""
    child = Child(
        ("cardan", "daemon", "run", str(lab.folder / "lab.toml")), lab.folder / "second.log"
    )
    lab.swing(lambda: not child.alive)
    assert child.process.returncode == 3, child.said()
    assert "is a daemon running already?" in child.said()
    child.end()


def second_session(lab: Lab, stack: contextlib.ExitStack) -> None:
    """Start another session for the same robot with ``cardan run``."""
    tables = lab.pair.configured(lab)
    mine = {"robot": tables["robot"], "arm": {"model": lab.pair.arm}}
    file = lab.folder / "second.toml"
    file.write_text("".join(f"{name} = {toml(of)}\n" for name, of in mine.items()))
    child = Child(("cardan", "run", str(file), "--seconds", "2"), lab.folder / "second.log")
    stack.callback(child.end)
    lab.swing(lambda: not child.alive)


def broken_reload(lab: Lab, stack: contextlib.ExitStack) -> None:
    """Write invalid files, and tell the daemon to reload them."""
    file = lab.folder / "lab.toml"
    text = file.read_text()
    stack.callback(file.write_text, text)
    file.write_text(text.replace("[[sessions]]", "[[sessions"))
    os.kill(daemon(lab), signal.SIGHUP)


def robot_restarts(after_s: float) -> Act:
    """Kill the robot's process, and start a new one after a while."""

    def act(lab: Lab, _: contextlib.ExitStack) -> None:
        assert lab.robot is not None
        lab.hit()
        lab.robot.end()
        lab.pause(after_s)
        lab.start_robot()
        lab.robot.wait_for("^READY")

    return act


def device_again(lab: Lab, _: contextlib.ExitStack) -> None:
    """Unplug the device, and plug in another one of the same model, deflected in the same way."""
    assert lab.hand is not None
    lab.hit()
    lab.hand.end()
    lab.start_hand(lab.pair.push[0])
    lab.hand.wait_for("^READY")


def server_again(lab: Lab, _: contextlib.ExitStack) -> None:
    """Kill and restart spacenavd while the device is deflected."""
    assert lab.server is not None
    lab.hit()
    lab.server.end()
    lab.start_server()
    lab.server.wait_for("^READY")


def port_taken(lab: Lab, stack: contextlib.ExitStack) -> None:
    """Kill the session, and let another program take the robot's port before it restarts."""
    send(session, signal.SIGKILL)(lab, stack)
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    stack.callback(sock.close)

    def bound() -> bool:
        with contextlib.suppress(OSError):
            sock.bind(("127.0.0.1", lab.port))
            return True
        return False

    wait(bound, "the port", 5.0, 0.001)
    wait(lambda: "is in use by" in lab.row()["reason"], "the reason")


# -- with ``cardan run`` --


def supervisor(lab: Lab) -> int:
    return daemon(lab)


def recorder(lab: Lab) -> int:
    assert lab.daemon is not None
    return next(pid for pid in descendants_of(lab.daemon.pid) if " record " in f"{words_of(pid)} ")


# -- the table ------------------------------------------------------------------------------------

STANDSTILLS_MS = (20, 40, 60, 100, 200, 500, 1000, 2000, 5000)
LONG_S = 60.0

_NOTHING = {
    signal.SIGCHLD, signal.SIGCONT, signal.SIGURG, signal.SIGWINCH, signal.SIGPIPE, signal.SIGXFSZ
}  # fmt: skip
_STOPPING = {signal.SIGSTOP, signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU}
_DEADLY = {
    signal.SIGKILL, signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGTRAP,
    signal.SIGSYS,
}  # fmt: skip

SIGNALS = sorted(
    {each for each in signal.valid_signals() if each <= signal.SIGSYS} - _STOPPING
    | {signal.SIGRTMIN, signal.SIGRTMAX}
)
"""All signals except those that stop a process, whose cases below have durations."""

ORDER = tuple(PAIRS)


def _turn(index: int) -> str:
    return ORDER[index % len(ORDER)]


def _seconds(ms: float) -> str:
    return f"{ms:g} ms" if ms < 1000 else f"{ms / 1000:g} s"


def _signals() -> list[Case]:
    found = []
    for index, number in enumerate(SIGNALS):
        name = signal_name(number)
        ends, deadly = number in ENDING_SIGNALS, number in _DEADLY
        goes = Outcome.STOPS if ends or deadly else Outcome.GOES_ON
        watch_s = WATCH_S if ends or deadly else GOES_ON_S
        found.append(
            Case(
                name, "session", _turn(index), send(session, number), goes,
                dies if deadly else brakes, watch_s, deadly,
            )
        )  # fmt: skip
        hup = number == signal.SIGHUP
        found.append(
            Case(
                name, "daemon", _turn(index + 1), send(daemon, number),
                Outcome.GOES_ON if hup else goes, after(GONE_S, brakes), watch_s,
            )
        )  # fmt: skip
        found.append(
            Case(
                name,
                "server",
                GOFA,
                send(gateway_server, number),
                Outcome.GOES_ON,
                watch_s=GOES_ON_S,
            )
        )
    return found


def _standstills() -> list[Case]:
    found = []
    for index, ms in enumerate((*STANDSTILLS_MS, 1000.0 * LONG_S)):
        seconds = 1e-3 * ms
        long = seconds >= LONG_S
        name = f"stands still for {_seconds(ms)}"
        pairs = (_turn(index),) if long else (_turn(index), _turn(index + 2))
        found += [
            Case(
                name, "session", pair, stop(session, seconds),
                Outcome.STOPS if ms >= 500 else Outcome.EITHER,
                either(dies, after(seconds, brakes)), long=long,
            )
            for pair in pairs
        ]  # fmt: skip
        found.append(
            Case(
                name, "daemon", _turn(index + 1), stop(daemon, seconds),
                Outcome.STOPS if ms >= 1000 else Outcome.EITHER if ms >= 500 else Outcome.GOES_ON,
                after(BEAT_S, brakes), WATCH_S if ms >= 500 else GOES_ON_S, long=long,
            )
        )  # fmt: skip
        found.append(
            Case(
                name, "robot", _turn(index + 3), stop(robot, seconds),
                Outcome.STOPS if ms >= 1000 else Outcome.EITHER,
                after(seconds, either(dies, brakes)), long=long,
            )
        )  # fmt: skip
        found.append(
            Case(
                name, "device", _turn(index + 4), stop(device, seconds),
                Outcome.STOPS if ms >= 500 else Outcome.EITHER,
                after(STALE_S, brakes), long=long,
            )
        )  # fmt: skip
    return found


def _each_pair() -> list[Case]:
    stops, goes = Outcome.STOPS, Outcome.GOES_ON
    gone = after(STALE_S, brakes)
    found = []
    for index, pair in enumerate(PAIRS):
        found += [
            Case("SIGKILL", "session", pair, send(session, signal.SIGKILL), stops, dies, dies=True),
            Case("SIGKILL", "daemon", pair, send(daemon, signal.SIGKILL), stops,
                 after(GONE_S, brakes)),
            Case("killed: unplugged", "device", pair, send(device, signal.SIGKILL), stops, gone),
            Case("another of the same model in its place, held down", "device", pair,
                 device_again, stops, gone, 3.0),
            Case("killed, there anew at once", "robot", pair, robot_restarts(0.0), stops, dies,
                 3.0),
            Case("killed, there anew after 2 s", "robot", pair, robot_restarts(2.0), stops, dies,
                 3.0),
            Case("out of descriptors", "session", pair, no_descriptors(session), goes,
                 watch_s=GOES_ON_S),
            Case("out of descriptors, another device in place of its own", "session", pair,
                 no_descriptors(session, device_again), stops, gone, 3.0),
            Case("out of descriptors, programs connect", "daemon", pair,
                 no_descriptors(daemon, clients), goes, watch_s=GOES_ON_S),
            Case("out of descriptors, its session is killed", "daemon", pair,
                 no_descriptors(daemon, send(session, signal.SIGKILL)), stops, dies, dies=True),
            Case("disk full", "daemon", pair, disk_full, goes, watch_s=GOES_ON_S, loses=True),
        ]  # fmt: skip
        if index % 2 == 0:
            found += [
                Case("a program asks for everything and reads nothing", "daemon", pair,
                     reader_that_stops(
                         Ask(1, "events", "", True), Ask(2, "log", "", True),
                         Ask(3, "figures", "", None),
                     ), goes, watch_s=GOES_ON_S),
                Case("its files are wrong at a reload", "daemon", pair, broken_reload, goes,
                     watch_s=GOES_ON_S),
            ]  # fmt: skip
        else:
            found.append(
                Case("a second one at the same socket", "daemon", pair, second_daemon, goes,
                     watch_s=0.2)
            )  # fmt: skip
        if pair != ROS2:  # The ROS 2 controller accepts commands from all senders.
            found.append(
                Case("another session for the same robot", "session", pair, second_session, goes,
                     watch_s=0.2)
            )  # fmt: skip
    return found


def _some_pairs() -> list[Case]:
    stops, goes = Outcome.STOPS, Outcome.GOES_ON
    gone = after(STALE_S, brakes)
    return [
        Case("SIGTERM", "robot", GOFA, send(robot, signal.SIGTERM), stops, dies),
        Case("SIGTERM", "robot", UR5, send(robot, signal.SIGTERM), stops, dies),
        Case("SIGTERM", "device", GP8, send(device, signal.SIGTERM), stops, gone),
        Case("spacenavd is killed", "device", SPNAV, send(server, signal.SIGKILL), stops, gone),
        Case("spacenavd is started anew, the device held down", "device", SPNAV, server_again,
             stops, gone, 3.0),
        Case("spacenavd stands still for 2 s", "device", SPNAV, stop(server, 2.0), stops, gone),
        Case("its router is killed", "bus", GOFA, send(router, signal.SIGKILL), goes,
             watch_s=GOES_ON_S),
        Case("its router stands still", "bus", GOFA, send(router, signal.SIGSTOP), goes,
             watch_s=GOES_ON_S),
        Case("stands still", "server", GOFA, send(gateway_server, signal.SIGSTOP), goes,
             watch_s=GOES_ON_S),
        Case("a client that reads nothing", "server", GOFA, web_client, goes, watch_s=1.5),
        Case("out of descriptors, programs connect", "server", GOFA,
             no_descriptors(gateway_server, web_clients), goes, watch_s=GOES_ON_S),
        Case("killed, and its port is taken before it is back", "session", GOFA, port_taken, stops,
             dies, dies=True),
        Case("killed, and its port is taken before it is back", "session", SPNAV, port_taken,
             stops, dies, dies=True),
    ]  # fmt: skip


def _run() -> list[Case]:
    stops, goes = Outcome.STOPS, Outcome.GOES_ON
    found = []
    for pair in (GP8, ROS2):
        found += [
            Case("SIGKILL", "cardan run", pair, send(supervisor, signal.SIGKILL), stops,
                 after(GONE_S, brakes), run=True),
            Case("stands still for 2 s", "cardan run", pair, stop(supervisor, 2.0), stops,
                 after(BEAT_S, brakes), run=True),
            Case("SIGINT", "cardan run", pair, send(supervisor, signal.SIGINT), stops, brakes,
                 run=True),
            Case("its session gets SIGKILL", "cardan run", pair, send(session, signal.SIGKILL),
                 stops, dies, run=True),
        ]  # fmt: skip
    found += [
        Case("its recorder gets SIGKILL", "cardan run", GOFA, send(recorder, signal.SIGKILL), goes,
             watch_s=GOES_ON_S, run=True),
        Case("its recorder's disk is full", "cardan run", GOFA,
             limit(recorder, resource.RLIMIT_FSIZE, lambda _: 1), goes, watch_s=GOES_ON_S,
             run=True),
        Case("its session gets SIGKILL while it is recorded", "cardan run", GOFA,
             send(session, signal.SIGKILL), stops, dies, run=True),
    ]  # fmt: skip
    return found


def all_cases() -> list[Case]:
    """Every case; group, pair and name identify a case."""
    found: dict[str, Case] = {}
    for case in (*_each_pair(), *_some_pairs(), *_standstills(), *_signals(), *_run()):
        found.setdefault(case.key, case)
    return list(found.values())


SHORT = (
    f"session: SIGKILL ({GOFA})",
    f"session: SIGKILL ({UR5})",
    f"session: stands still for 500 ms ({GOFA})",
    f"daemon: SIGKILL ({GOFA})",
    f"daemon: SIGKILL ({UR5})",
    f"daemon: stands still for 1 s ({UR5})",
    f"daemon: disk full ({GOFA})",
    f"daemon: out of descriptors, programs connect ({UR5})",
    f"server: SIGKILL ({GOFA})",
    f"bus: its router is killed ({GOFA})",
    f"device: another of the same model in its place, held down ({GOFA})",
    f"device: another of the same model in its place, held down ({UR5})",
    f"robot: killed, there anew at once ({UR5})",
    f"robot: killed, there anew at once ({GOFA})",
)
"""Cases that are part of every test run."""
