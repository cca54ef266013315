"""A simulated peer that serves while a test does something else."""

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
"""Watchdogs of a session in a thread of the tests, whatever else this computer does: by default it
ends motions when it stood still for 0.1 s. For `parse_config` with `from_file=False`."""

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
"""A session's file: an arm on the network as /left/arm, met at `endpoint`."""


@contextmanager
def in_a_thread(peer: _P) -> Iterator[_P]:
    """`peer`, opened, stepping in a thread of its own until the end."""
    with peer:
        yield peer


def free_udp_port() -> int:
    """A UDP port nobody has now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def free_endpoint() -> str:
    """An endpoint of Zenoh on loopback that nobody has now."""
    return f"tcp/127.0.0.1:{free_tcp_port()}"


def free_tcp_port() -> int:
    """A TCP port nobody has now."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@contextmanager
def served(*arguments: str) -> Iterator[str]:
    """The endpoint of what ``cardan ARGUMENTS`` serves in a process of its own."""
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
    """The demo with that driver that launches the least."""
    demos = (demo for demo in find_demos().values() if driver in demo.drivers)
    return min(demos, key=lambda demo: len(demo.launch))


@contextmanager
def demonstrated(demo: Demo, folder: Path) -> Iterator[dict[str, Any]]:
    """The tables of a demo's session, while what it launches is served; its files in `folder`."""
    tables, launches = demo.prepare(folder)
    with ExitStack() as stack:
        for words in launches:
            stack.enter_context(served(*check_words(demo, "launch", words)))
        yield tables
