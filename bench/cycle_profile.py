"""Time of a session's cycle by part, at the robot's rate: `python -m bench cycle-profile`.

A session runs in a separate process and receives a state every 4 ms, so that the caches are as cold
as in service. Each part is timed by a wrapper around the method that does it, which adds less than
0.5 µs to that method and to its callers. A tracing profiler would more than double the time; a
sampling one sees too little of a load of 2 % of a core.
"""

from __future__ import annotations

import contextlib
import functools
import json
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from bench.egm_latency import ANSWER_WITHIN_S, PERIOD_S, SESSIONS
from cardan.demos.examples import free_ports
from cardan.gateway.session.subprocesses import cardan_subprocess
from studies.cartesian.controller import START, datagram, obeyed

SECONDS = 12.0
MAX_SAMPLES = 100_000
INTERPRETED = "session with model, nothing compiled"
"""Case without a C compiler: servo, decoding and answering in Python."""
SITUATIONS = {
    "cardan-session": "cardan-session",
    "session with model": "session with model",
    "session with model, holding": "session with model, holding",
    INTERPRETED: "session with model",
}
"""Columns of the table, and the session that each measures."""

_LIBRARIES = ("cardan.gateway.servo.native", "cardan.drivers.abb_egm.compiled")

_CONTROLLER = "cardan.gateway.arm.controller:ArmController"
_EGM = "cardan.drivers.abb_egm"
PARTS = (
    ("receive", f"{_EGM}.session:EgmSession.receive"),
    ("device state", "cardan.drivers.reader_thread:ReaderMixin.state"),
    ("button events", "cardan.drivers.reader_thread:ReaderMixin.button_events"),
    ("tick", f"{_CONTROLLER}.tick"),
    ("- robot judged", "cardan.gateway.arm.supervision:Supervision.look"),
    ("- robot observed", f"{_CONTROLLER}._observe"),
    ("- compared", "cardan.gateway.arm.supervision:Supervision.compare"),
    ("- operator's request", f"{_CONTROLLER}._read_operator"),
    ("- motion", f"{_CONTROLLER}._move"),
    ("- - compiled servo", "cardan.gateway.servo.compiled:CompiledServo.tick"),
    ("- - servo in Python", "cardan.gateway.servo.servo:Servo.tick"),
    ("- phase and words", f"{_CONTROLLER}._settle"),
    ("- command and its check", f"{_CONTROLLER}._command"),
    ("send", f"{_EGM}.driver:AbbEgm.send"),
    ("- reply", f"{_EGM}.session:EgmSession.reply"),
    ("- handed to the system", f"{_EGM}.driver:AbbEgm._say"),
    ("figures (answer has left)", "cardan.gateway.session.parts:Figures.after"),
    ("feedback", "cardan.gateway.session.parts:Feedback.after"),
    ("snapshot, 10 a second", "cardan.gateway.session.session:Session._publish"),
)
"""Timed parts in the order of a cycle; a part that begins with a dash is contained in the one
above."""


# -- in the session's process ---------------------------------------------------------------------


def _timed(function: Callable[..., Any], retained: list[int]) -> Callable[..., Any]:
    clock = time.perf_counter_ns

    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        start_ns = clock()
        result = function(*arguments, **named)
        retained.append(clock() - start_ns)
        return result

    return call


def _wrap_parts() -> dict[str, list[int]]:
    """Time every part from now on; parts that this version of the package lacks are left out."""
    retained: dict[str, list[int]] = {}
    for label, name in PARTS:
        module, _, path = name.partition(":")
        owner_name, _, method = path.rpartition(".")
        with contextlib.suppress(ModuleNotFoundError, AttributeError):
            owner = getattr(import_module(module), owner_name)
            function = getattr(owner, method)
            retained[label] = []
            setattr(owner, method, _timed(function, retained[label]))
    return retained


def run_session(path: str, *flags: str) -> None:
    """Run the session of a file for its duration and print the samples as JSON; with the flag
    `INTERPRETED`, without compiled parts."""
    from cardan.gateway.session.assembly import load_config
    from cardan.gateway.session.session import make_session

    if INTERPRETED in flags:
        for name in _LIBRARIES:
            module: Any = import_module(name)
            module.library_path = lambda: Path(path).with_suffix(".so")
    retained = _wrap_parts()
    session = make_session(load_config(Path(path)))
    print("READY", flush=True)
    start_s, start_cpu_s = time.monotonic(), time.process_time()
    session.run(SECONDS)
    share = (time.process_time() - start_cpu_s) / (time.monotonic() - start_s)
    samples = {label: values[-MAX_SAMPLES:] for label, values in retained.items() if values}
    print(json.dumps({"cpu": share, "cycles": session.snapshot.loop.cycles, "samples": samples}))


# -- the controller's side ------------------------------------------------------------------------


@contextlib.contextmanager
def _session(port: int, situation: str) -> Iterator[subprocess.Popen[str]]:
    more, script = SESSIONS[SITUATIONS[situation]]
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        hid_path, played = str(Path(folder) / "hid"), Path(folder) / "script"
        played.write_text(script)
        stack.enter_context(
            cardan_subprocess("sim", "spacemouse", "--hid", hid_path, "--script", str(played))
        )
        config = Path(folder) / "bench.toml"
        config.write_text(
            f'[robot]\ndriver = "abb_egm"\nlisten_port = {port}\n{more}\n'
            f'[device]\ndriver = "spacemouse"\ntransport = "socket"\npath = "{hid_path}"\n'
            '[mapping]\ndeadman = "left"\n'
        )
        process = subprocess.Popen(
            [sys.executable, "-m", "bench.cycle_profile", str(config), situation],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            yield process
        finally:
            process.terminate()
            process.communicate()


def measure(situation: str) -> dict[str, Any]:
    """Return the times measured in the session's process, which was polled once per period."""
    port = free_ports()
    with (
        _session(port, situation) as process,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock,
    ):
        assert process.stdout is not None
        if process.stdout.readline() != "READY\n":
            raise RuntimeError("the session did not start")
        sock.connect(("127.0.0.1", port))
        sock.settimeout(ANSWER_WITHIN_S)
        place, clock = START, time.perf_counter
        end_s = clock() + SECONDS - 1.0
        slot_s, cycle = clock(), 0
        while slot_s < end_s:
            with contextlib.suppress(ConnectionRefusedError, TimeoutError):
                sock.send(datagram(cycle, place))
                place = obeyed(sock.recv(2048), place)
            cycle += 1
            slot_s = max(slot_s + PERIOD_S, clock())
            time.sleep(max(0.0, slot_s - clock()))
        found: dict[str, Any] = json.loads(process.stdout.readline())
    return found


def _row(label: str, columns: list[dict[str, Any]]) -> str:
    cells = []
    for found in columns:
        samples = sorted(found["samples"].get(label, ()))
        if samples:
            median, p99 = samples[len(samples) // 2], samples[int(len(samples) * 0.99)]
            cells.append(f"{median / 1e3:.1f} / {p99 / 1e3:.1f}")
        else:
            cells.append("–")
    return f"| {label} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    found = [measure(situation) for situation in SITUATIONS]
    print(f"## Parts of a session's cycle, once every {PERIOD_S * 1e3:g} ms, µs, median / p99\n")
    print(f"| part | {' | '.join(SITUATIONS)} |\n|---|{'---|' * len(SITUATIONS)}")
    for label, _ in PARTS:
        print(_row(label, found))
    shares = [f"{each['cpu'] * 100.0:.1f} % of a core" for each in found]
    print(f"| the process | {' | '.join(shares)} |")


if __name__ == "__main__":
    run_session(*sys.argv[1:])
