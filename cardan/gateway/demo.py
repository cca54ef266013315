"""The main job without hardware: simulated peers in processes of their own, and a session.

The peers are started as any other program would start them, through ``cardan sim``; what runs
between them is the real gateway with the real drivers.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from cardan.errors import DriverError
from cardan.gateway.config import SessionConfig, parse_config
from cardan.gateway.session import EXIT_OK
from cardan.gateway.snapshot import Snapshot
from cardan.gateway.supervisor import KILL_AFTER_S, supervise
from cardan.gateway.view import SessionView, missed_cycles, summary

EXIT_INCOMPLETE = 4

READY_WITHIN_S = 20.0
"""A peer that is not serving by then has failed; importing takes a second on a slow machine."""

WELL_FOLLOWED_M = 0.02
"""The simulated arm keeps within this of its reference at the demo's speeds: servo delay and
filter account for about 8 mm at 0.25 m/s."""

MISSED_SHARE = 0.01
"""More than this of all cycles missed is no longer the hiccup of a machine that has other work to
do and does not grant real-time scheduling; a real controller would not mind it either."""


def demo_config(hid_path: str, pc_port: int) -> SessionConfig:
    """The demo's configuration; examples/spacemouse-gofa-simulated.toml is the same as a file."""
    return parse_config(
        {
            "device": {"driver": "spacemouse", "transport": "socket", "path": hid_path},
            "robot": {"driver": "abb_egm", "listen_port": pc_port},
            "mapping": {"deadman": "left", "linear_speed_m_s": 0.1, "angular_speed_rad_s": 0.4},
            "gripper": {"toggle": "right"},
        }
    )


@contextlib.contextmanager
def simulated_peer(*arguments: str) -> Iterator[str]:
    """Run ``cardan sim ARGUMENTS``; gives its endpoint once it serves, and ends it after."""
    with tempfile.TemporaryFile("w+") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "cardan", "sim", *arguments],
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            start_new_session=True,
        )
        try:
            yield _endpoint(process, arguments[0])
        except BaseException:
            log.seek(0)
            sys.stderr.write(log.read()[-2000:])
            raise
        finally:
            process.terminate()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            assert process.stdout is not None
            process.stdout.close()


def _endpoint(process: subprocess.Popen[str], name: str) -> str:
    assert process.stdout is not None
    give_up_s = time.monotonic() + READY_WITHIN_S
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while selector.select(max(0.0, give_up_s - time.monotonic())):
            line = process.stdout.readline()
            if line.startswith("READY "):
                return line.removeprefix("READY ").strip()
            if not line:
                raise DriverError(f"the simulated {name} ended before it served")
    raise DriverError(f"the simulated {name} did not serve within {READY_WITHIN_S:.0f} s")


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def shortcomings(last: Snapshot) -> list[str]:
    """What a demo's last snapshot lacks, in words; empty when all went as it should."""
    found = []
    if last.cycles == 0:
        found.append("the robot was never commanded")
    if last.path_m == 0.0:
        found.append("no path was commanded")
    if last.error_max_m > WELL_FOLLOWED_M:
        found.append(
            f"the robot was up to {last.error_max_m * 1e3:.1f} mm away from its reference "
            f"(expected: {WELL_FOLLOWED_M * 1e3:.0f} mm)"
        )
    if (missed := missed_cycles(last)) > MISSED_SHARE * last.cycles:
        found.append(f"{missed} of {last.cycles} cycles were missed: is this machine very busy?")
    if last.trips:
        found.append(f"the hand was taken off the robot {last.trips} times")
    return found


def run_demo(seconds: float) -> int:
    """Run it; returns the exit code of the command."""
    port = _free_udp_port()
    # Should this process be killed, its peers still end by themselves.
    until = ("--seconds", str(seconds + READY_WITHIN_S + KILL_AFTER_S))
    with tempfile.TemporaryDirectory(prefix="cardan-demo-") as folder, SessionView() as view:
        hid_path = str(Path(folder) / "spacemouse")
        view.console.print(
            "simulated SpaceMouse (HID reports) -> gateway -> simulated GoFa (EGM, 250 Hz)"
        )
        with (
            simulated_peer("spacemouse", "--hid", hid_path, "--script", "demo", *until),
            simulated_peer("abb-gofa", "--to", f"127.0.0.1:{port}", *until),
        ):
            outcome = supervise(demo_config(hid_path, port), seconds, view.show)
    view.console.print(summary(outcome.last))
    if outcome.exit_code != EXIT_OK:
        print(f"cardan: {outcome.last.error}", file=sys.stderr)
        return outcome.exit_code
    missing = shortcomings(outcome.last)
    for line in missing:
        print(f"cardan demo: {line}", file=sys.stderr)
    if not missing:
        view.console.print("a hand's HID reports became robot motion; all of it was followed")
    return EXIT_INCOMPLETE if missing else EXIT_OK
