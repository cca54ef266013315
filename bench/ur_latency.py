"""Latency from RTDE state out to command in at a UR controller: our driver, our session, echo.

    python -m bench ur-latency

This process runs the simulated controllers on real sockets and steps their time. All peers are
measured in turn, first in 2 ms slots as with an e-Series, then without pauses. The session is the
real one: ``cardan run`` with a simulated SpaceMouse that moves, and with the arm's model.
"""

from __future__ import annotations

import contextlib
import gc
import json
import selectors
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from bench.egm_latency import MOVE, TOUCH
from bench.figures import Figures
from cardan.gateway.session.subprocesses import cardan_subprocess
from cardan.protocols.ur.program import ProgramCommand
from cardan.protocols.ur.rtde import Recipe
from cardan.sim_peers.ur_controller import UrController, UrControllerOptions, UrServers

PORT_KINDS: Final = ("rtde", "primary", "dashboard")
"""Ports to which the driver connects."""
CYCLES = 5000
WARM_UP = 500
PERIOD_S = 0.002
ANSWER_WITHIN_S = 0.5
READY_WITHIN_S = 60.0
PATIENT: Final = {"enable": "at-start", "watchdog_s": 0.5, "state_timeout_s": 0.5}
"""Options of a driver that tolerates states or commands delayed by a busy computer."""

ECHO, DRIVER, SESSION = "echo", "cardan-driver", "session with model"
STATE = Recipe(1, ["state"] * 26, ["DOUBLE"] * 26).pack([0.0] * 26)
"""Message with the length of a state."""


class Played:
    """A simulated controller on three real ports, with time that advances in steps."""

    def __init__(self) -> None:
        options = UrControllerOptions(running=True)
        self.controller = UrController(options)
        self.servers = UrServers(self.controller, options)
        telemetry, began_s = self.servers.telemetry, time.monotonic()
        value = telemetry.value
        # Without pauses, frames are sent faster than a controller's; its clock must not run faster.
        telemetry.value = lambda name: (  # type: ignore[method-assign]
            time.monotonic() - began_s if name == "timestamp" else value(name)
        )
        self.now_s = 0.0
        self._selector = selectors.DefaultSelector()
        self._sockets: dict[int, socket.socket] = {}
        self.rtde: socket.socket | None = None
        self.ports: dict[str, int] = {}
        self._rtde_number = 0
        self._listeners: list[socket.socket] = []
        for kind in PORT_KINDS:
            listener = socket.create_server(("127.0.0.1", 0))
            self._listeners.append(listener)
            self.ports[kind] = listener.getsockname()[1]
            self._selector.register(listener, selectors.EVENT_READ, kind)

    @property
    def followed(self) -> bool:
        """True if the program runs and commands come."""
        registers = self.controller.registers
        return self.controller.has_program and registers.input_int[26] == ProgramCommand.FOLLOW

    def carry(self, timeout_s: float) -> None:
        """Transfer the bytes that wait on the sockets, in both directions."""
        for key, _ in self._selector.select(timeout_s):
            assert isinstance(key.fileobj, socket.socket)
            if isinstance(key.data, str):
                taken, _ = key.fileobj.accept()
                taken.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                number = self.servers.accepted(key.data, self.now_s)  # type: ignore[arg-type]
                assert number is not None
                self._sockets[number] = taken
                self._selector.register(taken, selectors.EVENT_READ, number)
                if key.data == "rtde":
                    self.rtde, self._rtde_number = taken, number
                continue
            try:
                data = key.fileobj.recv(65536)
            except ConnectionResetError:  # closed while a message was in transit
                data = b""
            if data:
                self.servers.data(key.data, data, self.now_s)
            else:
                self._selector.unregister(key.fileobj)
                self._sockets.pop(key.data).close()
                self.servers.eof(key.data, self.now_s)
        self.flush()

    def flush(self) -> None:
        """Send the pending data."""
        for number, data in self.servers.outgoing():
            with contextlib.suppress(OSError, KeyError):
                self._sockets[number].sendall(data)
        for number in self.servers.closing():
            with contextlib.suppress(KeyError):
                self._selector.unregister(self._sockets[number])
                self._sockets.pop(number).close()

    def close(self) -> None:
        """Close all sockets."""
        for each in (*self._listeners, *self._sockets.values()):
            each.close()
        self._selector.close()

    def step(self) -> None:
        """Advance by one frame, and read the bytes that have arrived since."""
        self.now_s += PERIOD_S
        self.servers.advance(self.now_s)
        self.carry(0.0)

    def asked(self) -> float | None:
        """Advance by one frame; return the time from sending the state to receiving the command, s;
        None: no command came."""
        assert self.rtde is not None
        self.now_s += PERIOD_S
        self.servers.advance(self.now_s)
        clock = time.perf_counter
        start_s = clock()
        self.flush()
        self.rtde.settimeout(ANSWER_WITHIN_S)
        try:
            data = self.rtde.recv(65536)
        except TimeoutError:
            return None
        took_s = clock() - start_s
        self.servers.data(self._rtde_number, data, self.now_s)
        self.flush()
        return took_s


class Echoed:
    """Baseline: CPython receives as many bytes as a state has, and sends as many as a command
    has."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._socket: socket.socket | None = None

    def close(self) -> None:
        """Close its sockets."""
        self._listener.close()
        if self._socket is not None:
            self._socket.close()

    def wait(self) -> None:
        """Wait for the connection."""
        self._socket, _ = self._listener.accept()
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def asked(self) -> float | None:
        """Return the round-trip time, s, measured as for a controller."""
        assert self._socket is not None
        start_s = time.perf_counter()
        self._socket.sendall(STATE)
        self._socket.recv(65536)
        return time.perf_counter() - start_s


def echo(port: int) -> None:
    """Process behind `Echoed`."""
    with socket.create_connection(("127.0.0.1", port)) as sock:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while data := sock.recv(65536):
            sock.sendall(data[:112])


def driver(rtde: int, primary: int, dashboard: int) -> None:
    """Our driver alone; the command is the measured position."""
    from cardan.drivers.ur_rtde import UrRtde
    from cardan.types import JointCommand

    ports = {"rtde_port": rtde, "primary_port": primary, "dashboard_port": dashboard}
    with UrRtde(**PATIENT, **ports) as robot:
        for state in robot.cycles():
            if state.ready:
                robot.send(JointCommand(state.joints))


@contextlib.contextmanager
def process(*words: str) -> Iterator[None]:
    """Run a Python process until the end of the context."""
    started = subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        started.terminate()
        started.wait()


@contextlib.contextmanager
def session(played: Played) -> Iterator[None]:
    """Run ``cardan run`` with a simulated SpaceMouse that moves the arm."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        hid_path, script, config = (Path(folder) / name for name in ("hid", "script", "ur.toml"))
        script.write_text(TOUCH + MOVE)
        robot = PATIENT | {f"{kind}_port": port for kind, port in played.ports.items()}
        lines = "".join(f"{key} = {json.dumps(value)}\n" for key, value in robot.items())
        config.write_text(
            f'[robot]\ndriver = "ur_rtde"\n{lines}'
            '[arm]\nmodel = "ur5e"\n[mapping]\ndeadman = "left"\n'
            f'[device]\ndriver = "spacemouse"\ntransport = "socket"\npath = "{hid_path}"\n'
        )
        stack.enter_context(
            cardan_subprocess("sim", "spacemouse", "--hid", str(hid_path), "--script", str(script))
        )
        stack.enter_context(process("-m", "cardan", "run", str(config)))
        yield


def slots(period_s: float) -> Iterator[None]:
    """Slots one after the other, each at least `period_s` long; a late slot is not made up for."""
    slot_s = time.perf_counter()
    while True:
        yield
        slot_s = max(slot_s + period_s, time.perf_counter())
        time.sleep(max(0.0, slot_s - time.perf_counter()))


def measure(cycles: int = CYCLES, period_s: float = PERIOD_S, warm_up: int = WARM_UP) -> Figures:
    """Measure every peer `cycles` times, every `period_s`; return the latencies by name."""
    pace = f"every {period_s * 1e3:g} ms" if period_s else "without a pause"
    figures = Figures(f"RTDE state out to command in, as a UR's controller sees it, {pace}")
    echoed, alone, moving = Echoed(), Played(), Played()
    with contextlib.ExitStack() as stack:
        for each in (echoed, alone, moving):
            stack.callback(each.close)
        module = ("-m", "bench.ur_latency")
        stack.enter_context(process(*module, ECHO, str(echoed.port)))
        echoed.wait()
        stack.enter_context(session(moving))
        stack.enter_context(process(*module, DRIVER, *(str(alone.ports[k]) for k in PORT_KINDS)))
        asked = {ECHO: echoed, DRIVER: alone, SESSION: moving}
        begin_s = time.monotonic()
        for _ in slots(PERIOD_S):
            # Both start together: a driver whose controller falls silent ends motion.
            if alone.followed and moving.followed:
                break
            if time.monotonic() - begin_s > READY_WITHIN_S:
                raise RuntimeError("no commands came: is this machine very busy?")
            alone.step()
            moving.step()
        gc.disable()
        for cycle, _ in zip(range(cycles + warm_up), slots(period_s), strict=False):
            for name, responder in asked.items():
                took_s = responder.asked()
                if took_s is None:
                    figures.miss(name)
                elif cycle >= warm_up:
                    figures.add(name, took_s)
        gc.enable()
    return figures


def main() -> None:
    """Print the tables."""
    measure().print()
    measure(period_s=0.0).print()


if __name__ == "__main__":
    kind, *numbers = sys.argv[1:]
    {ECHO: echo, DRIVER: driver}[kind](*map(int, numbers))  # type: ignore[operator]
