"""Two implementations of an arm: CartesianDevice in this process, RemoteArm through a session on
the network."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from cardan.gateway.arm import CartesianArm, CartesianDevice, ControllerOptions
from cardan.gateway.arm.remote_arm import RemoteArm
from cardan.gateway.bus.remote import network_arm
from cardan.gateway.session.config import SessionConfig, parse_config
from cardan.gateway.session.driver_assembly import make_driver
from cardan.gateway.session.session import make_session
from tests.serving import PATIENT, free_endpoint

TIMEOUT_S = 20.0


class Place(NamedTuple):
    """An arm before open(), and the function that ends its control loop."""

    device: CartesianDevice | RemoteArm
    end_loop: Callable[[], None]
    address: str = ""
    """Address of the arm on the network."""


def config_of(robot: dict[str, Any], tables: dict[str, Any]) -> SessionConfig:
    robot = {"driver": "sim_arm", "drive": "ideal", **robot, **tables.pop("robot", {})}
    merged = {"robot": robot, "arm": {"model": "ur5"}, "watchdogs": PATIENT, **tables}
    return parse_config(merged, from_file=False)


class Here:
    """CartesianDevice on a simulated robot that runs as fast as it can."""

    @contextmanager
    def place(self, **tables: Any) -> Iterator[Place]:
        """An arm with these tables of a session, closed at the end."""
        config = config_of({"pacing": "virtual"}, tables)
        robot = make_driver(config.robot, "robot")
        device = CartesianDevice(
            robot,
            "ur5",
            ControllerOptions(authority=config.authority),
            device=None if config.device is None else make_driver(config.device, "device"),
            mapping=config.mapping,
        )

        def end_loop() -> None:
            robot.close()
            device._link.wait_for(lambda: not device._link.running, TIMEOUT_S)

        try:
            yield Place(device, end_loop)
        finally:
            device.close()

    @contextmanager
    def arm(self, **tables: Any) -> Iterator[CartesianArm]:
        """The same arm, open."""
        with self.place(**tables) as place, place.device as device:
            yield device


class OnTheBus(Here):
    """RemoteArm, with a session in a thread of this process."""

    @contextmanager
    def place(self, **tables: Any) -> Iterator[Place]:
        """An arm with these tables of a session, closed at the end."""
        endpoint = free_endpoint()
        tables["network"] = {"router": "", "listen": [endpoint]}
        session = make_session(config_of({"period_s": 0.004}, tables))
        running = threading.Thread(target=session.run)
        device = network_arm(endpoint)

        def end_loop() -> None:
            session.stop("the test ends it")
            running.join(TIMEOUT_S)

        running.start()
        try:
            yield Place(device, end_loop, endpoint)
        finally:
            device.close()
            end_loop()
