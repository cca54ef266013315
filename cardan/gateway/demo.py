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
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from cardan.errors import ConfigurationError, DriverError
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


class Demo(NamedTuple):
    """A robot to show."""

    words: str
    """What is joined to what."""
    robot: Callable[[int], dict[str, Any]]
    """The configuration's tables beside the device's, for the port."""
    port: Callable[[], int]
    """Finds a free one, or the first of so many."""
    peer: Callable[[int], tuple[str, ...]]
    """``cardan sim`` of the controller, for the port."""


def _gofa(port: int) -> dict[str, Any]:
    """As examples/spacemouse-gofa-simulated.toml."""
    return {
        "robot": {"driver": "abb_egm", "listen_port": port},
        "mapping": {"deadman": "left", "linear_speed_m_s": 0.1, "angular_speed_rad_s": 0.4},
        "gripper": {"toggle": "right"},
    }


def _gp8(port: int) -> dict[str, Any]:
    """Velocity mode, by the joints of the arm's model."""
    return {
        "robot": {
            "driver": "motoros",
            "motion_port": port,
            "state_port": port + 1,
            "io_port": port + 2,
            "enable": "at-start",
        },
        "arm": {"model": "gp8"},
        "mapping": {"deadman": "left", "linear_speed_m_s": 0.1, "angular_speed_rad_s": 0.4},
    }


def demo_config(name: str, hid_path: str, port: int) -> SessionConfig:
    """The configuration of the demo called `name`."""
    device = {"driver": "spacemouse", "transport": "socket", "path": hid_path}
    return parse_config({"device": device, **DEMOS[name].robot(port)})


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


def free_udp_port() -> int:
    """A UDP port nobody has now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def free_tcp_ports(count: int = 3) -> int:
    """The first of `count` TCP ports in a row that nobody has now."""
    for _ in range(100):
        with contextlib.ExitStack() as probes:
            first = 0
            try:
                for offset in range(count):
                    probe = probes.enter_context(socket.socket())
                    probe.bind(("127.0.0.1", first + offset if first else 0))
                    first = first or probe.getsockname()[1]
            except (OSError, OverflowError):
                continue
            return first
    raise DriverError(f"there are no {count} free TCP ports in a row")


DEMOS: Mapping[str, Demo] = {
    "gofa": Demo(
        "simulated SpaceMouse (HID reports) -> gateway -> simulated GoFa (EGM, 250 Hz)",
        _gofa,
        free_udp_port,
        lambda port: ("abb-gofa", "--to", f"127.0.0.1:{port}"),
    ),
    "gp8": Demo(
        "simulated SpaceMouse (HID reports) -> gateway -> simulated Motoman GP8 "
        "(simple message, velocity mode, 250 Hz)",
        _gp8,
        free_tcp_ports,
        lambda port: ("motoman-gp8", "--base-port", str(port), "--servo-on"),
    ),
}


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


def run_demo(seconds: float, name: str = "gofa") -> int:
    """Run one of DEMOS; returns the exit code of the command."""
    demo = DEMOS.get(name)
    if demo is None:
        raise ConfigurationError("demo", f"{name!r} is none; allowed: {', '.join(DEMOS)}")
    port = demo.port()
    # Should this process be killed, its peers still end by themselves.
    until = ("--seconds", str(seconds + READY_WITHIN_S + KILL_AFTER_S))
    with tempfile.TemporaryDirectory(prefix="cardan-demo-") as folder, SessionView() as view:
        hid_path = str(Path(folder) / "spacemouse")
        view.console.print(demo.words)
        with (
            simulated_peer("spacemouse", "--hid", hid_path, "--script", "demo", *until),
            simulated_peer(*demo.peer(port), *until),
        ):
            outcome = supervise(demo_config(name, hid_path, port), seconds, view.show)
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
