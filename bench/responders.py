"""Responders of the latency benchmark, each run in a separate process.

``python -m bench.responders KIND PORT`` prints READY and answers until no request has come for
IDLE_S.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable
from typing import Literal

C_ECHO = "echo in C"

IDLE_S = 20.0
"""Time without a datagram after which a responder ends."""


def echo(port: int) -> None:
    """Baseline: CPython receives a datagram and sends it back."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", port))
        sock.settimeout(IDLE_S)
        print("READY", flush=True)
        while True:
            try:
                data, peer = sock.recvfrom(2048)
            except TimeoutError:
                return
            sock.sendto(data, peer)


def c_echo(port: int) -> None:
    """Echo in C: a lower bound for the latency of ABB's own C++ library."""
    from bench import native

    program = str(native.built(native.ECHO))
    os.execv(program, (program, str(port)))


def cardan_driver(port: int) -> None:
    """Our driver alone; the command is the measured position."""
    _cardan(port, "pose")


def cardan_joints(port: int) -> None:
    """Our driver alone in joint mode."""
    _cardan(port, "joint")


def _cardan(port: int, mode: Literal["pose", "joint"]) -> None:
    from cardan.drivers.abb_egm import AbbEgm, AbbEgmOptions
    from cardan.types import JointCommand, PoseCommand, RobotLink

    with AbbEgm(AbbEgmOptions(listen_port=port, mode=mode)) as robot:
        print("READY", flush=True)
        silent = 0
        for state in robot.cycles():
            if state.ready and state.pose is not None:
                silent = 0
                if mode == "pose":
                    robot.send(PoseCommand(state.pose))
                else:
                    robot.send(JointCommand(state.joints))
            elif state.link is not RobotLink.LIVE:
                silent += 1
                if silent > IDLE_S / 0.1:
                    return


def abb_robot_egm(port: int) -> None:
    """ABBRobotEGM from PyPI, used as in its examples."""
    from ABBRobotEGM import EGM

    with EGM(port) as egm:
        print("READY", flush=True)
        while True:
            ok, state = egm.receive_from_robot(IDLE_S)
            if not ok:
                return
            egm.send_to_robot_cart(state.cartesian.pos, state.cartesian.orient)


def abb_robot_client(port: int) -> None:
    """abb-robot-client from PyPI, used as in its examples."""
    from abb_robot_client.egm import EGM

    egm = EGM(port)
    try:
        print("READY", flush=True)
        while True:
            ok, state = egm.receive_from_robot(IDLE_S)
            if not ok:
                return
            position, orientation = state.cartesian
            egm.send_to_robot_cart(position, orientation)
    finally:
        egm.close()


KINDS: dict[str, Callable[[int], None]] = {
    "echo": echo,
    C_ECHO: c_echo,
    "cardan-driver": cardan_driver,
    "ABBRobotEGM": abb_robot_egm,
    "cardan-joints": cardan_joints,
    "abb-robot-client": abb_robot_client,
}

if __name__ == "__main__":
    KINDS[sys.argv[1]](int(sys.argv[2]))
