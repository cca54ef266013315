"""Simulated peers that serve while a test runs."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TypeVar

from cardan.demos.examples import Demo, find_demos
from cardan.demos.safety import check_words
from cardan.sim_peers.base import SimulatedPeer

_P = TypeVar("_P", bound=SimulatedPeer)

PATIENT = {"device_age_s": 0.5, "stall_s": 0.5, "heartbeat_s": 0.5}
"""Watchdogs for a session in a thread of the tests, on a computer with other load: by default a
pause of 0.1 s ends motion. For `parse_config` with `from_file=False`."""

ARM_SESSION = """
[robot]
driver = "sim_arm"
robot = "ur5"
drive = "ideal"
period_s = 0.008

[arm]
model = "ur5"

[network]
name = "arm"
namespace = "left"
router = ""
listen = ["{endpoint}"]
"""
"""Session file: an arm on the network as /left/arm, reachable at `endpoint`."""


@contextmanager
def in_a_thread(peer: _P) -> Iterator[_P]:
    """Open `peer`, and serve it in a thread until the end."""
    with peer:
        yield peer


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def free_endpoint() -> str:
    """Return an unused Zenoh endpoint on loopback."""
    return f"tcp/127.0.0.1:{free_tcp_port()}"


def free_tcp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@contextmanager
def session_on_the_network(
    folder: Path, text: str = ARM_SESSION, more: str = "", seconds: int = 600
) -> Iterator[str]:
    """Run a session in its own process, with `more` at the end of its file; yield its endpoint."""
    endpoint = free_endpoint()
    path = folder / "session.toml"
    path.write_text(text.format(endpoint=endpoint) + more)
    command = [sys.executable, "-m", "cardan", "run", str(path), "--seconds", str(seconds)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as session:
        try:
            yield endpoint
        finally:
            session.terminate()


@contextmanager
def served(*arguments: str) -> Iterator[str]:
    """Serve ``cardan ARGUMENTS`` in its own process; yield the endpoint."""
    process = subprocess.Popen(
        [sys.executable, "-m", "cardan", *arguments], stdout=subprocess.PIPE, text=True
    )
    with process:
        try:
            assert process.stdout is not None
            ready, _, endpoint = process.stdout.readline().strip().partition(" ")
            assert ready == "READY", f"cardan {' '.join(arguments)} did not serve"
            yield endpoint
        finally:
            process.terminate()


def demo_of(driver: str) -> Demo:
    """Return the demo with that driver that launches the fewest programs."""
    demos = (demo for demo in find_demos().values() if driver in demo.drivers)
    return min(demos, key=lambda demo: len(demo.launch))


@contextmanager
def demonstrated(demo: Demo, folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the tables of a demo's session while its programs serve, with its files in `folder`."""
    tables, launches = demo.prepare(folder)
    with ExitStack() as stack:
        for words in launches:
            stack.enter_context(served(*check_words(demo, "launch", words)))
        yield tables
