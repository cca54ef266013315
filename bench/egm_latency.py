"""EGM datagram in to datagram out: our driver, our session, two public clients, and the floor.

One process plays the controller and asks all of them in turn, in an order that rotates, so that
whatever else the machine does hits all alike: once in 4 ms slots as a controller does, when
everybody wakes up with cold caches, and once without any pause. The session is the real one:
``cardan run`` with a simulated SpaceMouse that moves.
"""

from __future__ import annotations

import contextlib
import gc
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bench.figures import Aim, Figures
from bench.responders import KINDS
from cardan.gateway.session.demo import launched
from cardan.gateway.session.examples import free_ports
from cardan.protocols.egm import EgmHeader, EgmMotion, EgmPose, EgmRobot, encode_robot
from cardan.types import Quaternion, Vector3

CYCLES = 5000
WARM_UP_CYCLES = 250
PERIOD_S = 0.004
ANSWER_WITHIN_S = 0.5

SESSION = "cardan-session"

AIMS = (
    Aim("cardan-driver", "echo", 1.5, "median"),
    Aim("cardan-driver", "ABBRobotEGM", 0.5, "median"),
    Aim(SESSION, None, 250e-6, "median"),
)


def datagram(cycle: int) -> bytes:
    """What a RobotWare 7 controller sends in this cycle (joints, pose, clock, states)."""
    joints = (0.0, 0.0, 0.0, 0.0, 0.5235987755982988, 0.0)
    pose = EgmPose(Vector3(0.5975, 0.0, 0.83775), Quaternion(0.5, 0.0, 0.8660254037844386, 0.0))
    motion = EgmMotion(joints, pose, None, 1_700_000_000_000_000 + cycle * 4000)
    header = EgmHeader(seqno=cycle, tm_ms=1_000_000 + cycle * 4, mtype=2)
    return encode_robot(
        EgmRobot(
            header=header,
            feed_back=motion,
            planned=motion,
            motor_state=1,
            mci_state=3,
            mci_convergence_met=False,
            rapid_exec_state=2,
            utilization_rate=12.5,
        )
    )


@contextlib.contextmanager
def responder(kind: str, port: int) -> Iterator[None]:
    """A responder's process, serving."""
    process = subprocess.Popen(
        [sys.executable, "-m", "bench.responders", kind, str(port)], stdout=subprocess.PIPE
    )
    try:
        assert process.stdout is not None
        if process.stdout.readline() != b"READY\n":
            raise RuntimeError(f"{kind} did not start")
        yield
    finally:
        process.terminate()
        process.communicate()


@contextlib.contextmanager
def session(port: int) -> Iterator[None]:
    """``cardan run`` with a simulated SpaceMouse."""
    with tempfile.TemporaryDirectory() as folder:
        hid_path = str(Path(folder) / "hid")
        config = Path(folder) / "bench.toml"
        config.write_text(
            f'[device]\ndriver = "spacemouse"\ntransport = "socket"\npath = "{hid_path}"\n'
            f'[robot]\ndriver = "abb_egm"\nlisten_port = {port}\n'
            '[mapping]\ndeadman = "left"\n'
        )
        with launched("sim", "spacemouse", "--hid", hid_path, "--script", "demo"):
            process = subprocess.Popen(
                [sys.executable, "-m", "cardan", "run", str(config)], stdout=subprocess.PIPE
            )
            try:
                assert process.stdout is not None
                process.stdout.readline()  # its first view: the loop runs
                yield
            finally:
                process.terminate()
                process.communicate()


def measure(cycles: int = CYCLES, period_s: float = PERIOD_S) -> Figures:
    """Ask everybody `cycles` times, every `period_s`; returns the latencies by name."""
    pace = f"every {period_s * 1e3:g} ms" if period_s else "without a pause"
    figures = Figures(f"EGM datagram in to datagram out, as the controller sees it, {pace}")
    names = [*KINDS, SESSION]
    datagrams = [datagram(cycle) for cycle in range(cycles + WARM_UP_CYCLES)]
    with contextlib.ExitStack() as stack:
        sockets = []
        for name in names:
            port = free_ports()
            stack.enter_context(session(port) if name == SESSION else responder(name, port))
            sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            sock.connect(("127.0.0.1", port))
            sock.settimeout(ANSWER_WITHIN_S)
            sockets.append((name, sock))
        clock = time.perf_counter
        gc.disable()
        slot_s = clock()
        for cycle, data in enumerate(datagrams):
            for turn in range(len(sockets)):
                name, sock = sockets[(cycle + turn) % len(sockets)]
                start_s = clock()
                sock.send(data)
                try:
                    sock.recv(2048)
                except (TimeoutError, ConnectionRefusedError):
                    figures.miss(name)
                    continue
                if cycle >= WARM_UP_CYCLES:
                    figures.add(name, clock() - start_s)
            slot_s = max(slot_s + period_s, clock())
            time.sleep(max(0.0, slot_s - clock()))
        gc.enable()
    return figures


def main() -> None:
    """Print the tables and how the aims are met."""
    measure().print(AIMS)
    measure(period_s=0.0).print()


if __name__ == "__main__":
    main()
