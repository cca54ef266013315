"""Program that runs an unmodified public EGM client: LIBRARY SCENARIO.

The two libraries register different schemas under one file name, and cannot share a process. The
program prints its port, then the received data as one line of JSON.
"""

from __future__ import annotations

import json
import socket
import sys
from contextlib import closing
from typing import Any

import numpy as np

START_DEG = np.array([0.0, 0.0, 0.0, 0.0, 30.0, 0.0])
TARGET_DEG = START_DEG + np.array([5.0, -3.0, 2.0, 4.0, -5.0, 10.0])
SHIFT_MM = np.array([-20.0, 40.0, 15.0])
SPEED_MM_S = 25.0
CYCLES = 180
"""0.7 s: at k = 15 a step is reached to 0.002 %, apart from delays."""


def receive(client: Any) -> Any:
    received, state = client.receive_from_robot(timeout=5.0)
    if not received:
        raise TimeoutError("no datagram")
    return state


def position_of(cartesian: Any) -> tuple[Any, Any]:
    """Return (xyz in mm, quaternion w x y z) of either library's pose."""
    if hasattr(cartesian, "pos"):
        p, q = cartesian.pos, cartesian.orient
        return np.array([p.x, p.y, p.z]), np.array([q.u0, q.u1, q.u2, q.u3])
    return cartesian[0], cartesian[1]


def seen(state: Any) -> dict[str, Any]:
    xyz, orientation = position_of(state.cartesian)
    planned, _ = position_of(state.cartesian_planned)
    return {
        "joints": list(state.joint_angles),
        "joints_planned": list(state.joint_angles_planned),
        "xyz": list(xyz),
        "xyz_planned": list(planned),
        "orientation": list(orientation),
        "motors_on": state.motors_on,
        "rapid_running": state.rapid_running,
        "force": None if state.measured_force is None else list(state.measured_force),
        "move_index": state.move_index,
        "rapid": None if state.rapid_from_robot is None else list(state.rapid_from_robot),
    }


def joints(client: Any) -> list[Any]:
    states = [receive(client)]
    for _ in range(CYCLES):
        client.send_to_robot(TARGET_DEG)
        states.append(receive(client))
    return states


def poses(client: Any) -> list[Any]:
    states = [receive(client)]
    start, orientation = position_of(states[0].cartesian)
    for _ in range(CYCLES):
        client.send_to_robot_cart(start + SHIFT_MM, orientation)
        states.append(receive(client))
    return states


def speeds(client: Any) -> list[Any]:
    states = [receive(client)]
    start, orientation = position_of(states[0].cartesian)
    for n in range(CYCLES // 2 + 50):
        speed = SPEED_MM_S if n < CYCLES // 2 else 0.0
        client.send_to_robot_cart(start, orientation, speed_ref=[0.0, speed, 0.0, 0.0, 0.0, 0.0])
        states.append(receive(client))
    return states


def rapid_data(client: Any) -> list[Any]:
    states = [receive(client)]
    for _ in range(25):
        client.send_to_robot(START_DEG, rapid_to_robot=[1.0, 2.5, -3.0])
        states.append(receive(client))
    return states


def path_correction(client: Any) -> list[Any]:
    states = [receive(client)]
    for _ in range(18):
        client.send_to_robot_path_corr([0.0, 6.0, 8.0], age=1)
        states.append(receive(client))
    return states


def silence(client: Any) -> list[Any]:
    """Stay silent until standard input ends; then read the messages received by then."""
    # A large buffer for the messages that the controller sends in virtual time.
    client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    states = [receive(client)]
    for _ in range(20):
        client.send_to_robot(START_DEG)
        states.append(receive(client))
    sys.stdin.read()
    while True:
        received, state = client.receive_from_robot(timeout=0.3)
        if not received:
            return states
        states.append(state)


SCENARIOS = {f.__name__: f for f in (joints, poses, speeds, rapid_data, path_correction, silence)}


def main(library: str, scenario: str) -> None:
    if library == "ABBRobotEGM":
        from ABBRobotEGM import EGM
    else:
        from abb_robot_client.egm import EGM

    with closing(EGM(port=0)) as client:
        print(client.socket.getsockname()[1], flush=True)
        states = SCENARIOS[scenario](client)
    result = {"first": seen(states[0]), "last": seen(states[-1]), "count": len(states)}
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
