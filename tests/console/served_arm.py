"""A simulated UR5 with its session in a process, and the console server in this one, for tests of
the page that also use the network."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.gateway.servers.console.server import ConsoleOptions, ConsoleServer
from cardan.gateway.servers.console.site import Site
from cardan.protocols.ros2.cdr import codec_of
from tests.gateway.servers.bench import WAIT_S, served
from tests.serving import ARM_SESSION, session_on_the_network
from tests.waiting import until

ARM = "/left/arm"
STATUS = "cardan_msgs/msg/ArmStatus"

STOPPED_S = 2.5
"""Longest time from the end of a hold until the arm is at rest: freshness, the arm's ramp, and a
browser that draws without a graphics card on a busy computer."""


@contextlib.contextmanager
def served_arm(
    folder: Path, site: Site, more: str = "", model: str = "ur5"
) -> Iterator[tuple[BusNetwork, str]]:
    """Network of a running session, with `more` in its file and this model of the arm, and the
    address of the page."""
    text = ARM_SESSION.replace('model = "ur5"', f'model = "{model}"')
    options = ConsoleOptions(port=0, records=str(folder / "records"))
    with session_on_the_network(folder, text, more) as endpoint:
        joins = BusOptions(router=endpoint)
        with BusNetwork(joins, "console") as network:
            assert network.wait_for_service(f"{ARM}/ask", WAIT_S)
            with served(lambda: ConsoleServer(network, options, site, joins)) as running:
                yield network, f"http://127.0.0.1:{running.port}/"


@contextlib.contextmanager
def motion_of(network: BusNetwork) -> Iterator[Callable[[], bool]]:
    """True if the arm reports motion."""
    codec, newest = codec_of(STATUS), {}
    handle = network.subscribe(
        f"{ARM}/state/status", STATUS, lambda cdr, _ns: newest.update(codec.decode(cdr))
    )
    try:
        yield lambda: bool(newest.get("moving"))
    finally:
        handle.close()


def stops(moving: Callable[[], bool]) -> None:
    """Wait until the arm rests, and check that it stays at rest."""
    until(lambda: not moving(), "the arm's stop", STOPPED_S)
    end_s = time.monotonic() + 0.5
    while time.monotonic() < end_s:
        assert not moving()
        time.sleep(0.02)
