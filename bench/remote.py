"""Cost of an operator device at another computer: `python -m bench remote`.

    python -m bench remote [--acts=100] [--pages]

This process plays the device and the robot's controller: it writes a SpaceMouse's reports into a
socket, and asks sessions by EGM, once in 4 ms, as a controller does. Two times are measured: from
the report that deflects the device to the first answer that moves the arm, and from the report that
releases the dead-man button to the last answer that moves the arm by SWING_M or more.

Speed: one session reads the device itself, one by ``cardan devices share`` and a router, and one by
the messages of ROS 2's spacenav_node (:mod:`bench.spacenav_node`) on the same router. For the third
one this process plays spacenavd, without delay. All run side by side and are moved in turns, each
at the same phases of the robot's cycle.

Networks: ``cardan devices share`` runs on one computer, router and session on another, both made of
network namespaces, with a link between them (:mod:`bench.two_computers`). The link is a model; TCP
and UDP over it are the kernel's. Each network is measured over TCP, and over QUIC as set up by
``cardan net pair --quic``. "Beyond the network" means: minus the link's transit time of the first
frame after the operator's action, and minus the same quantile of the session that reads the device
itself. The limit for rest includes the link's constant delay.

`--pages` writes the tables into docs/measurements.md.
"""

from __future__ import annotations

import contextlib
import math
import os
import random
import selectors
import socket
import subprocess
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from bench import pages
from bench.figures import Figures
from bench.link import Conditions
from bench.spacenav_node import EVENT, MOTION, PRESS, RELEASE
from bench.two_computers import (
    ADDRESSES,
    OPERATOR,
    ROBOT,
    NoNamespacesError,
    TwoComputers,
    two_computers,
)
from cardan.demos.examples import free_ports
from cardan.gateway.session.subprocesses import CardanSubprocess, cardan_subprocess
from cardan.protocols.connexion.reports import encode_buttons, encode_motion
from cardan.protocols.egm.messages import EgmMotion
from cardan.types import Vector3
from studies.cartesian.controller import START, datagram, obeyed

PAGE: Final = Path(__file__).parents[1] / "docs/measurements.md"
SPEED_PART, NETWORK_PART = "remote-speed", "remote-networks"

LOCAL, REMOTE, SPACENAV = "read locally", "`cardan devices share`", "spacenav_node"
BEYOND = "beyond the network"

ACTS = 100
PERIOD_S = 0.004
REPORT_S = 0.008
ROOM = 64
"""Report period of a SpaceMouse while it is deflected."""
COUNTS = 150
STROKE_S = 0.4
"""Duration of motion before the button is released."""
REST_S = 0.1
"""Time without motion after which an arm is at rest; longer than a stall of the network."""
STILL_S = 0.05
"""Time without a change of position after which an arm stands still."""
PAUSE_S = 0.3
"""Pause at rest, with the button held, before the device is deflected."""
SWING_M = 1e-3
"""Threshold of progress. The robot obeys at once: if an answer is a cycle late, the arm oscillates
about its rest position with a smaller amplitude, for up to a second. At full speed it moves this
far in 10 ms."""
SWING_WITHIN_S = 0.1
"""Longest time in which a moving arm advances by SWING_M; an arm braking from full speed advances
by less than SWING_M."""
GOLDEN: Final = (math.sqrt(5.0) - 1.0) / 2.0
READY_WITHIN_S, ACT_WITHIN_S = 60.0, 5.0
PAIRED_WITHIN_S = 20.0

EGM_PORT: Final = 6510
"""Port of the session at the robot's computer."""
ROUTER_PORT: Final = 7447

ADDED_S: Final = 1.0e-3
"""Limit for the median that sharing adds to a local device."""
OF_SPACENAV: Final = 0.5
"""Limit for the same, as a share of what spacenav_node adds."""


class Network(NamedTuple):
    """One of the networks over which a device is used."""

    name: str
    link: Conditions
    """Conditions in each direction."""
    max_age_s: float
    """Age limit of the driver, as docs/remote.md recommends."""
    aim_ms: tuple[float, float]
    """Limits for the median and p99 from the device to the arm, beyond the network."""
    rest_s: float
    """Limit for the time from release to rest, including the constant delay."""

    @property
    def in_words(self) -> str:
        """Description of the link for a table."""
        link = self.link
        words = [f"{1e3 * link.delay_s:g}"]
        if link.jitter_s:
            words[0] += f" ± {1e3 * link.jitter_s:g}"
        words[0] += " ms"
        if link.loss:
            words.append(f"{link.loss:.1%}")
        if link.stall_s:
            words.append(f"{1e3 * link.stall_s:g} ms each {link.stall_every_s:g} s")
        return ", ".join(words)

    @property
    def longest_s(self) -> float:
        """Longest delay, except when several losses coincide."""
        link = self.link
        return link.delay_s + link.jitter_s + link.stall_s + 2 * link.delay_s + 3 * REPORT_S


NETWORKS: Final = (
    Network("LAN", Conditions(0.0003), 0.15, (1.0, 3.0), 0.12),
    Network("Wi-Fi", Conditions(0.005, 0.005, 0.01, 0.08, 2.0), 0.15, (1.0, 10.0), 0.255),
    Network("LTE", Conditions(0.045, 0.02, 0.01, 0.5, 10.0), 0.25, (2.0, 25.0), 0.295),
    Network("Internet", Conditions(0.12, 0.01, 0.005), 0.4, (2.0, 15.0), 0.37),
)


TCP, TLS, QUIC = "TCP", "TLS", "QUIC"
"""Connections of the two computers: to the router's endpoint alone, or paired."""
WAYS: Final = (TCP, QUIC)
"""Ways that are measured."""


class HandHeld(ABC):
    """A device played by this process."""

    buttons = axis = False
    counts = COUNTS
    """Deflection in counts; its sign alternates, so that no stroke reaches the edge of the
    workspace."""

    @abstractmethod
    def report(self) -> None:
        """Send the present buttons and deflections to all readers."""


class Mouse(HandHeld):
    """A SpaceMouse: a socket whose packets are its reports."""

    def __init__(self, path: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.bind(path)
        self._socket.listen()
        self._socket.setblocking(False)
        self._readers: list[socket.socket] = []
        self._said = (False, False)

    def report(self) -> None:
        """Send reports like the device: buttons on change, and axes while deflected."""
        with contextlib.suppress(BlockingIOError):
            self._readers.append(self._socket.accept()[0])
        packets = [encode_motion(0, self.counts if self.axis else 0, 0, 0, 0, 0)]
        if self._said[0] != self.buttons:
            packets.insert(0, encode_buttons(int(self.buttons), 3))
        if self.axis or (self.axis, self.buttons) != self._said[::-1]:
            for reader in self._readers:
                with contextlib.suppress(OSError):  # The buffer of a stopped reader is full.
                    for packet in packets:
                        reader.send(packet, socket.MSG_DONTWAIT)
                with contextlib.suppress(BlockingIOError):  # The LED's, for which there is room.
                    while reader.recv(ROOM, socket.MSG_DONTWAIT):
                        pass
        self._said = (self.buttons, self.axis)

    def close(self) -> None:
        """Unplug the device."""
        for each in (*self._readers, self._socket):
            each.close()


class Spacenavd(HandHeld):
    """The daemon that spacenav_node polls for events."""

    def __init__(self, path: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.bind(path)
        self._socket.listen()
        self._node: socket.socket | None = None
        self._reported = (False, False)

    def accept(self) -> None:
        """Wait for the node."""
        self._socket.settimeout(READY_WITHIN_S)
        self._node = self._socket.accept()[0]
        self._node.setblocking(False)

    def report(self) -> None:
        """Send an event for a changed button, and one for the axes while they are deflected."""
        assert self._node is not None
        if self._reported[0] != self.buttons:
            self._send(PRESS if self.buttons else RELEASE, 0)
        if self.axis or self._reported[1]:
            self._send(MOTION, self.counts if self.axis else 0)
        self._reported = (self.buttons, self.axis)

    def _send(self, kind: int, word: int) -> None:
        assert self._node is not None
        with contextlib.suppress(OSError):
            self._node.send(EVENT.pack(kind, word, 0, 0, 0, 0, 0, 0))

    def close(self) -> None:
        """Close the connection, which ends the node, too."""
        for each in (self._node, self._socket):
            if each is not None:
                each.close()


@contextlib.contextmanager
def spacenav_node(path: str, router: str) -> Iterator[Spacenavd]:
    """Run the node, and the daemon at `path` that it polls."""
    daemon = Spacenavd(path)
    process = subprocess.Popen([sys.executable, "-m", "bench.spacenav_node", path, router])
    try:
        daemon.accept()
        yield daemon
    finally:
        daemon.close()
        process.terminate()
        process.wait()


class Robot:
    """A controller that receives a session's answers, and whose arm obeys at once."""

    def __init__(self, port: int, device: HandHeld, datagrams: socket.socket | None = None) -> None:
        """`datagrams`: socket in the namespace of the session's computer; None: one of this
        computer."""
        self.device = device
        self.socket = datagrams or socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.setblocking(False)
        self.place = START
        self.moved_s = 0.0
        """Time of the last answer that moved the arm."""
        self.went_s = 0.0
        """Time of the last answer that moved the arm by SWING_M or more."""
        self._went = _position(START)

    def ask(self, cycle: int) -> None:
        """Send one datagram."""
        with contextlib.suppress(OSError):
            self.socket.send(datagram(cycle, self.place))

    def take(self, now_s: float) -> None:
        """Read the answers that have arrived."""
        with contextlib.suppress(OSError):
            while True:
                place = obeyed(self.socket.recv(2048), self.place)
                if place.cartesian != self.place.cartesian:
                    self.moved_s = now_s
                if math.dist(where := _position(place), self._went) >= SWING_M:
                    self.went_s, self._went = now_s, where
                self.place = place


def _position(place: EgmMotion) -> Vector3:
    """Return the position of the TCP, m."""
    assert place.cartesian is not None
    assert place.cartesian.pos is not None
    return place.cartesian.pos


class Stroke(NamedTuple):
    """Times of an operator's action and of the arm's reaction, s."""

    begun_s: float
    moved_s: float
    released_s: float
    rested_s: float

    @property
    def moves_s(self) -> float:
        """Time until the arm moves."""
        return self.moved_s - self.begun_s

    @property
    def rests_s(self) -> float:
        """Time from the button's release until the arm rests."""
        return self.rested_s - self.released_s


class Cell:
    """All robots, which send their states at their own rate, and the operator, who acts at any
    phase.

    The robots ask in turns, spread over the period: sessions that answer at the same time would
    wait for each other's processor, the later ones longer.
    """

    def __init__(self, robots: Mapping[str, Robot]) -> None:
        self.robots = robots
        self._in_turn = list(robots.values())
        self._turn_s = PERIOD_S / len(robots)
        self._turn = 0
        """Index of the robot that asks next, at _slot_s."""
        self._selector = selectors.SelectSelector()
        for robot in robots.values():
            self._selector.register(robot.socket, selectors.EVENT_READ, robot)
        self._cycle = 0
        self._slot_s = self._reported_s = time.monotonic()
        self._random = random.Random(0)
        self._strokes: Counter[Robot] = Counter()
        """Number of strokes begun, by robot."""

    def play(self, till_s: float) -> float:
        """Run until `till_s`; return the time."""
        while (now_s := time.monotonic()) < till_s:
            if now_s >= self._slot_s:
                # A controller's clock does not wait for a busy computer: the cycles are skipped.
                cycles = int((now_s - self._slot_s) / PERIOD_S)
                self._cycle += cycles
                self._slot_s += cycles * PERIOD_S + self._turn_s
                self._in_turn[self._turn].ask(self._cycle)
                self._turn = (self._turn + 1) % len(self._in_turn)
                self._cycle += self._turn == 0
                continue
            if now_s >= self._reported_s + REPORT_S:
                self._reported_s = now_s
                for robot in self.robots.values():
                    robot.device.report()
            due_s = min(self._slot_s, self._reported_s + REPORT_S, till_s)
            for key, _ in self._selector.select(max(0.0, due_s - time.monotonic())):
                key.data.take(time.monotonic())
        return now_s

    def wait(self, seconds: float) -> float:
        """Run for this time plus a random part of a cycle, so that actions fall at any phase."""
        return self.play(time.monotonic() + seconds + self._random.uniform(0.0, PERIOD_S))

    def moved_after(self, robot: Robot, since_s: float) -> float | None:
        """Return the time of the first motion after `since_s`; None: there was none."""
        now_s = since_s
        while robot.moved_s <= since_s:
            if now_s > since_s + ACT_WITHIN_S:
                return None
            now_s = self.play(time.monotonic() + PERIOD_S)
        return robot.moved_s

    def rested_after(self, robot: Robot, since_s: float, rest_s: float) -> float:
        """Return the time of the last motion, ignoring oscillation at rest."""
        self.wait(rest_s)
        while (now_s := time.monotonic()) < max(since_s, robot.went_s) + rest_s:
            self.play(now_s + REST_S)
        return robot.went_s

    def await_phase(self, robot: Robot) -> None:
        """Run until the next phase of the robot's cycle. All robots get the same sequence of
        phases, so that the wait for the next cycle contributes equally to all medians."""
        phase = self._strokes[robot] * GOLDEN % 1.0
        self._strokes[robot] += 1
        turns = (self._in_turn.index(robot) - self._turn) % len(self._in_turn)
        self.play(self._slot_s + turns * self._turn_s + PERIOD_S * (1.0 + phase))

    def act(self, robot: Robot, **what: bool) -> float:
        """Perform the operator's action now; return its time."""
        for name, value in what.items():
            setattr(robot.device, name, value)
        now_s = time.monotonic()
        robot.device.report()
        return now_s

    def make_ready(self, robot: Robot, rest_s: float) -> None:
        """Deflect, release and press until the arm follows. Raises RuntimeError if it does not."""
        end_s = time.monotonic() + READY_WITHIN_S
        while time.monotonic() < end_s:
            for what in ({"axis": True}, {"axis": False}, {"buttons": True}, {"axis": True}):
                since_s = self.act(robot, **what)
                self.wait(0.2 + rest_s)
            follows = robot.moved_s > since_s
            self.act(robot, axis=False)
            self.act(robot, buttons=False)
            self.rested_after(robot, time.monotonic(), REST_S + rest_s)
            if follows:
                return
        raise RuntimeError("a session does not follow its device")

    def stroke(self, robot: Robot, rest_s: float) -> Stroke | None:
        """Move the arm and bring it to rest; return None if it did not move."""
        self.act(robot, buttons=True)
        self.wait(PAUSE_S + rest_s)
        # An arm that still oscillates would count as moved by the action.
        end_s = time.monotonic() + ACT_WITHIN_S
        while (now_s := time.monotonic()) < min(robot.moved_s + STILL_S, end_s):
            self.play(now_s + PERIOD_S)
        robot.device.counts *= -1
        self.await_phase(robot)
        begun_s = self.act(robot, axis=True)
        moved_s = self.moved_after(robot, begun_s)
        self.wait(STROKE_S)
        released_s = self.act(robot, buttons=False)
        rested_s = self.rested_after(robot, released_s, REST_S + rest_s)
        self.act(robot, axis=False)
        self.wait(REST_S + rest_s)
        if moved_s is None or rested_s < released_s - SWING_WITHIN_S:
            return None
        return Stroke(begun_s, moved_s, released_s, max(released_s, rested_s))


@contextlib.contextmanager
def session(
    folder: Path,
    port: int,
    device: str,
    deadman: str,
    device_age_s: float = 0.1,
    at: Sequence[str] = (),
) -> Iterator[None]:
    """Run ``cardan run`` for a robot that sends to `port`; `at`: prefix of the command."""
    config = folder / f"session-{port}.toml"
    config.write_text(
        f'[robot]\ndriver = "abb_egm"\nlisten_port = {port}\n\n[device]\n{device}\n\n'
        f'[mapping]\ndeadman = "{deadman}"\nlinear_speed_m_s = 0.1\n\n'
        f"[watchdogs]\ndevice_age_s = {device_age_s}\n"
    )
    process = subprocess.Popen(
        [*at, sys.executable, "-m", "cardan", "run", str(config)], stdout=subprocess.PIPE
    )
    try:
        assert process.stdout is not None
        process.stdout.readline()  # its first view: the loop runs
        yield
    finally:
        process.terminate()
        process.communicate()


@contextlib.contextmanager
def shared(
    folder: Path, mouse: str, way: Sequence[str], at: Sequence[str] = ()
) -> Iterator[CardanSubprocess]:
    """Run ``cardan devices share`` for the mouse with the options `way`; `at`: prefix of the
    command."""
    config = folder / "operator.toml"
    config.write_text(f'[device]\ndriver = "spacemouse"\ntransport = "socket"\npath = "{mouse}"\n')
    words = ("devices", "share", str(config), *way, "--name", "mouse")
    command = CardanSubprocess(*words, at=at)
    try:
        yield command
    finally:
        command.end()


def remote(router: str, more: str = "") -> str:
    """The keys of a session's [device]."""
    return f'driver = "remote"\nrouter = "{router}"\ndevice = "mouse"\n{more}'


def measure_speed(acts: int) -> Figures:
    """Measure the time from the device's bytes to motion, for three kinds of sessions."""
    figures = Figures("From the device's report to the answer that moves the arm")
    with tempfile.TemporaryDirectory(prefix="cardan-remote-") as name, _stack() as stack:
        folder = Path(name)
        router = stack.enter_context(_router())
        near, far = Mouse(f"{name}/near"), Mouse(f"{name}/far")
        stack.callback(near.close)
        stack.callback(far.close)
        spacenav = stack.enter_context(spacenav_node(f"{name}/spnav", router))
        stack.enter_context(shared(folder, f"{name}/far", ("--router", router)))
        robots: dict[str, Robot] = {}
        ways: dict[str, tuple[HandHeld, str, str]] = {
            LOCAL: (
                near,
                f'driver = "spacemouse"\ntransport = "socket"\npath = "{name}/near"',
                "left",
            ),
            REMOTE: (far, remote(router), "left"),
            SPACENAV: (
                spacenav,
                f'driver = "ros2_spacenav"\nrouter = "{router}"\nmode = "client"',
                "button-0",
            ),
        }
        for way, (device, keys, deadman) in ways.items():
            port = free_ports()
            stack.enter_context(session(folder, port, keys, deadman))
            robots[way] = Robot(port, device)
            stack.callback(robots[way].socket.close)
        cell = Cell(robots)
        for robot in robots.values():
            cell.make_ready(robot, 0.0)
        for _ in range(acts):
            for way, robot in robots.items():
                if (took := cell.stroke(robot, 0.0)) is None:
                    figures.miss(way)
                else:
                    figures.add(way, took.moves_s)
    return figures


class RemoteLab(NamedTuple):
    """A device on one computer, and the arm that it moves on the other."""

    cell: Cell
    robot: Robot
    both: TwoComputers
    routers: list[CardanSubprocess]
    """Routers started on the robot's computer; the last one is running."""
    router_way: Sequence[str]
    """The router's options."""

    def start_router(self) -> None:
        """Start a router; no other may be running."""
        words = ("net", "server", "router", *self.router_way)
        self.routers.append(CardanSubprocess(*words, at=self.both.at(ROBOT)))

    def end_routers(self) -> None:
        """Stop all routers."""
        for router in self.routers:
            router.end()


def paired(folder: Path, both: TwoComputers, *options: str) -> tuple[str, str]:
    """Pair the two computers; return the paths of Zenoh's files for the router and for the
    operator."""
    state = {at: folder / at for at in (ROBOT, OPERATOR)}

    def command(at: str, *words: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*both.at(at), sys.executable, "-m", "cardan", "net", "pair", *words],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "XDG_STATE_HOME": str(state[at])},
        )

    with command(ROBOT) as robot:
        try:
            assert robot.stdout is not None
            code = robot.stdout.readline().partition(";")[0].removeprefix("code ")
            with command(OPERATOR, ADDRESSES[ROBOT], "--code", code, *options) as operator:
                operator.communicate()
            if operator.returncode:
                raise RuntimeError("the two computers cannot be paired: see above")
            robot.communicate(timeout=PAIRED_WITHIN_S)
        finally:
            robot.kill()
    files = [
        next(state[at].glob(f"cardan/pair/{name}/zenoh.json5"))
        for at, name in ((ROBOT, "as-robot"), (OPERATOR, "with-*"))
    ]
    return str(files[0]), str(files[1])


@contextlib.contextmanager
def remote_lab(network: Network, way: str = TCP) -> Iterator[RemoteLab]:
    """Run both computers with that network between them; `way`: TCP, TLS or QUIC."""
    with tempfile.TemporaryDirectory(prefix="cardan-remote-") as name, _stack() as stack:
        folder = Path(name)
        both = stack.enter_context(two_computers(network.link, network.link))
        mouse = Mouse(f"{name}/mouse")
        stack.callback(mouse.close)
        robot = Robot(EGM_PORT, mouse, both.datagrams(ROBOT))
        stack.callback(robot.socket.close)
        if way != TCP:
            files = paired(folder, both, *(("--quic",) if way == QUIC else ()))
            ours, theirs = (("--zenoh-config", each) for each in files)
        else:
            ours = ("--endpoint", f"tcp/0.0.0.0:{ROUTER_PORT}")
            theirs = ("--router", f"tcp/{ADDRESSES[ROBOT]}:{ROUTER_PORT}")
        found = RemoteLab(Cell({REMOTE: robot}), robot, both, [], ours)
        stack.callback(found.end_routers)
        found.start_router()
        stack.enter_context(shared(folder, f"{name}/mouse", theirs, both.at(OPERATOR)))
        keys = remote(
            f"tcp/127.0.0.1:{ROUTER_PORT}",
            f"max_age_s = {network.max_age_s}\nwait_for_device = true\n",
        )
        age_s, at = network.max_age_s, both.at(ROBOT)
        stack.enter_context(session(folder, EGM_PORT, keys, "left", age_s, at))
        yield found


def transit_s(both: TwoComputers, stroke: Stroke, delay_s: float) -> float:
    """Return the transit time of the first frame that left the operator's computer after the
    action, whether it carries the state or an earlier acknowledgment.

    A frame queued behind stalled ones includes their wait. For a lost frame the result is
    `delay_s`, because the retransmission time is the protocol's.
    """
    first = next(iter(both.carried(ROBOT, stroke.begun_s, stroke.moved_s)), None)
    return delay_s if first is None or first.came_s is None else first.came_s - first.sent_s


def measure_network(network: Network, way: str, acts: int) -> tuple[Figures, Figures]:
    """Measure the times until motion and until rest over that network, connected by `way`."""
    moves, rests = Figures(network.name), Figures(network.name)
    with remote_lab(network, way) as (cell, robot, both, *_):
        rest_s = network.longest_s
        cell.make_ready(robot, rest_s)
        for _ in range(acts):
            if (took := cell.stroke(robot, rest_s)) is None:
                moves.miss(REMOTE)
                continue
            beyond_s = took.moves_s - transit_s(both, took, network.link.delay_s)
            if beyond_s < 0.0:  # Oscillation: nothing of the action had arrived yet.
                moves.miss(REMOTE)
                continue
            moves.add(REMOTE, took.moves_s)
            moves.add(BEYOND, beyond_s)
            rests.add(REMOTE, took.rests_s)
    return moves, rests


def _stack() -> contextlib.ExitStack:
    return contextlib.ExitStack()


@contextlib.contextmanager
def _router() -> Iterator[str]:
    endpoint = f"tcp/127.0.0.1:{free_ports()}"
    with cardan_subprocess("net", "server", "router", "--endpoint", endpoint):
        yield endpoint


def speed_table(figures: Figures, conditions: str) -> str:
    """Return the table of docs/measurements.md."""
    lines = ["| the device | median | p99 | beyond local, median |", "|---|---|---|---|"]
    local_s = figures.quantile(LOCAL, "median")
    added = {}
    for name in (LOCAL, REMOTE, SPACENAV):
        median_s = figures.quantile(name, "median")
        added[name] = median_s - local_s
        beyond = "" if name == LOCAL else f"{1e3 * added[name]:+.2f} ms"
        lines.append(
            f"| {name} | {1e3 * median_s:.2f} ms | {1e3 * figures.quantile(name, 'p99'):.2f} ms "
            f"| {beyond} |"
        )
    most_s = min(ADDED_S, OF_SPACENAV * added[SPACENAV])
    met = "met" if added[REMOTE] <= most_s else "missed"
    aim = (
        f"Aim: {REMOTE} adds at most {1e3 * ADDED_S:g} ms, and at most {OF_SPACENAV:g} of what "
        f"spacenav_node adds: {met}."
    )
    return "\n".join(lines) + f"\n\n{aim} {conditions}"


def network_table(rows: list[tuple[Network, str, Figures, Figures]], local: Figures) -> str:
    """Return the table of docs/measurements.md."""
    lines = [
        "| network | by | delay, jitter, lost, stands still | device to arm beyond the network, "
        "median / p99 | aim | beyond its delay alone | strokes that do not count "
        "| let go to rest, median / longest | aim |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    alone = [local.quantile(LOCAL, quantile) for quantile in ("median", "p99")]
    for network, way, moves, rests in rows:
        beyond = [
            moves.quantile(BEYOND, quantile) - least_s
            for quantile, least_s in zip(("median", "p99"), alone, strict=True)
        ]
        beyond_delay = [
            moves.quantile(REMOTE, quantile) - network.link.delay_s - least_s
            for quantile, least_s in zip(("median", "p99"), alone, strict=True)
        ]
        rest = [rests.quantile(REMOTE, q) for q in ("median", "p99.9")]
        p50_ms, p99_ms = network.aim_ms
        lines.append(
            f"| {network.name} | {way} | {network.in_words} "
            f"| {1e3 * beyond[0]:.1f} / {1e3 * beyond[1]:.1f} ms | {p50_ms:g} / {p99_ms:g} ms "
            f"| {1e3 * beyond_delay[0]:.1f} / {1e3 * beyond_delay[1]:.1f} ms "
            f"| {moves.missed(REMOTE)} "
            f"| {1e3 * rest[0]:.0f} / {1e3 * rest[1]:.0f} ms | {1e3 * network.rest_s:.0f} ms |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure and print; with `--pages`, write the tables into the page."""
    words = sys.argv[1:]
    given = [word.partition("=")[2] for word in words if word.startswith("--acts=")]
    acts = int(given[-1]) if given else ACTS
    load = os.getloadavg()[0]
    conditions = (
        f"{acts} strokes each, {os.cpu_count()} processors, a cycle of {1e3 * PERIOD_S:g} ms. Load "
        f"in the minute before: {load:.1f}."
    )
    speed = measure_speed(acts)
    parts = {SPEED_PART: speed_table(speed, conditions)}
    print(pages.marked(SPEED_PART, parts[SPEED_PART]), flush=True)
    try:
        rows = [
            (network, way, *measure_network(network, way, acts))
            for network in NETWORKS
            for way in WAYS
        ]
    except NoNamespacesError as error:
        sys.exit(f"the networks are left out, and no page is written: {error}")
    parts[NETWORK_PART] = f"{network_table(rows, speed)}\n\n{conditions}"
    print(pages.marked(NETWORK_PART, parts[NETWORK_PART]), flush=True)
    if "--pages" in words:
        pages.rewrite(PAGE, parts)
        print(f"docs/{PAGE.name} has these numbers")


if __name__ == "__main__":
    main()
