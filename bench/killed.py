"""Stopping distance of each robot when its session is killed (SIGKILL) while it moves.

    python -m bench killed

The session is a ``cardan run`` process driven by a simulated SpaceMouse; the controllers are
simulated, on real sockets. After the kill only the controller's own reaction to missing commands
stops the arm. Motion is measured at the TCP, from the controller's true joints.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import SessionProcess
from cardan.robots import load_arm
from cardan.sim_peers.arm.options import SimulatedArmOptions
from cardan.sim_peers.arm.udp import SimulatedArmPeer
from cardan.sim_peers.base import SimulatedPeer
from cardan.sim_peers.egm_controller import EgmControllerOptions, EgmControllerPeer, EgmMode
from cardan.sim_peers.motoros_controller import MotorosControllerOptions, MotorosControllerPeer
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions

SPEEDS_M_S = (0.1, 0.25)
TIMES = 5

STROKE_S = 1.7
"""Period of the device's strokes; the arm rests for less than a second between two of them."""

SAMPLE_S = 0.001
WINDOW_S = 0.06
"""Averaging time of speeds: many periods of every controller."""
STEADY_S = 0.4
"""Minimum time at full speed before the session is killed."""
AT_SPEED = 0.9
"""Share of the commanded speed that counts as full speed."""
REST_M_S = 0.001
"""Speed limit of a resting arm, which has to hold for REST_S."""
REST_S = 0.5
WITHIN_S = 120.0
"""Timeouts: until the arm has full speed, and until it rests."""

COMM_TIMEOUT_S = 0.2
"""Communication timeout of EGM, as docs/abb-egm.md sets it."""

Joints = Callable[[], Sequence[float]]


class Robot(NamedTuple):
    """A running simulated controller."""

    peer: SimulatedPeer
    joints: Joints
    tables: dict[str, Any]
    """Tables of the session's configuration."""


def _gofa(mode: str) -> Robot:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    options = EgmControllerOptions(pc_port=port, mode=EgmMode(mode), comm_timeout_s=COMM_TIMEOUT_S)
    peer = EgmControllerPeer(options)
    robot = {"driver": "abb_egm", "mode": mode, "listen_port": port, "robot": "gofa_crb15000_5"}
    tables: dict[str, Any] = {"robot": robot}
    if mode == "joint":
        tables["arm"] = {"model": "gofa_crb15000_5"}
    return Robot(peer, lambda: peer.core.joints_rad, tables)


def _gp8(mode: str, plant: Literal["ideal", "paper"] = "ideal") -> Robot:
    velocity_mode = mode == "velocity"
    options = MotorosControllerOptions(base_port=0, velocity_mode=velocity_mode, plant=plant)
    peer = MotorosControllerPeer(options)
    peer.open()  # From here on the peer's ports are known.
    robot = {
        "driver": "motoros",
        "mode": mode,
        "robot": "gp8",
        "enable": "at-start",
        "motion_port": peer.motion_port,
        "state_port": peer.state_port,
        "io_port": peer.io_port,
    }
    tables = {"robot": robot, "arm": {"model": "gp8"}}
    return Robot(peer, lambda: peer.controller.measured_rad(0), tables)


def _ur5() -> Robot:
    peer = SimulatedArmPeer(SimulatedArmOptions(robot="ur5", port=0))
    peer.open()
    robot = {"driver": "sim_arm", "robot": "ur5", "transport": "udp", "endpoint": peer.endpoint}
    tables: dict[str, Any] = {"robot": robot, "arm": {"model": "ur5"}}
    return Robot(peer, lambda: peer.core.plant.positions, tables)


class Case(NamedTuple):
    """A robot, and the direction in which its TCP has room."""

    make: Callable[[], Robot]
    arm: str
    direction: tuple[int, int, int]


ROBOTS: dict[str, Case] = {
    "GoFa, EGM pose": Case(lambda: _gofa("pose"), "gofa_crb15000_5", (-1, 0, 0)),
    "GoFa, EGM joint": Case(lambda: _gofa("joint"), "gofa_crb15000_5", (-1, 0, 0)),
    "GP8, MotoROS stream": Case(lambda: _gp8("stream"), "gp8", (0, 1, 0)),
    "GP8, MotoROS velocity": Case(lambda: _gp8("velocity"), "gp8", (0, 1, 0)),
    "the same, late, stream": Case(lambda: _gp8("stream", "paper"), "gp8", (0, 1, 0)),
    "the same, late, velocity": Case(lambda: _gp8("velocity", "paper"), "gp8", (0, 1, 0)),
    "UR5, joint stream": Case(_ur5, "ur5", (0, -1, 0)),
}


@contextlib.contextmanager
def driven(name: str, speed_m_s: float, folder: Path) -> Iterator[tuple[Robot, dict[str, Any]]]:
    """Run a robot of ROBOTS and yield its tables for a session whose device moves at this speed,
    back and forth without end."""
    case = ROBOTS[name]
    robot = case.make()
    hand, mouse = folder / "hand", folder / "mouse.sock"
    x, y, z = case.direction
    lines = ["0.1 axes 0.3 0 0 0 0 0", "0.2 neutral"]
    # Each stroke begins with enabling and re-arming, so that a stop of the arm or its controller
    # ends one stroke only.
    for start_s, sign in ((0.4, 1), (0.4 + STROKE_S, -1)):
        lines += [
            f"{start_s - 0.15:.2f} press right",
            f"{start_s - 0.1:.1f} release right",
            f"{start_s} press left",
            f"{start_s + 0.1:.1f} axes {sign * x} {sign * y} {sign * z} 0 0 0",
            f"{start_s + STROKE_S - 0.4:.1f} neutral",
            f"{start_s + STROKE_S - 0.2:.1f} release left",
        ]
    hand.write_text("\n".join((*lines, f"{0.4 + 2 * STROKE_S:.1f} loop", "")))
    options = SpaceMousePeerOptions(hid=str(mouse), script=str(hand), jitter_lsb=0)
    enabled_by = {"enable": "right"} if "enable" in robot.tables["robot"] else {}
    tables = {
        **robot.tables,
        "device": {"driver": "spacemouse", "transport": "socket", "path": str(mouse)},
        "mapping": {"deadman": "left", "linear_speed_m_s": speed_m_s, **enabled_by},
        "limits": {"linear_speed_m_s": max(SPEEDS_M_S)},
    }
    with robot.peer, SpaceMousePeer(options):
        yield robot, tables


class Watch:
    """Sampler of an arm's TCP."""

    def __init__(self, arm: str, joints: Joints) -> None:
        self._kinematics = ArmKinematics(load_arm(arm))
        self._joints = joints
        self.times: list[float] = []
        self.points: list[Any] = []

    def sample(self) -> float:
        """Take a sample; return the TCP's speed, m/s."""
        threading.Event().wait(SAMPLE_S)
        now_s = time.monotonic()
        self.times.append(now_s)
        joints = np.array(self._joints())
        self.points.append(self._kinematics.forward(joints).translation.copy())
        first = len(self.times) - 1
        while first > 0 and self.times[first] > now_s - WINDOW_S:
            first -= 1
        if first == len(self.times) - 1:
            return 0.0
        way = np.linalg.norm(self.points[-1] - self.points[first])
        return float(way) / (now_s - self.times[first])

    def until(self, speed_ok: Callable[[float], bool], lasting_s: float) -> float:
        """Sample until the speed has met the condition for `lasting_s`; return the time since which
        it did."""
        give_up_s = time.monotonic() + WITHIN_S
        since_s = give_up_s
        while (now_s := time.monotonic()) < since_s + lasting_s:
            if now_s > give_up_s:
                raise TimeoutError("the arm did not do what was waited for")
            since_s = min(since_s, now_s) if speed_ok(self.sample()) else give_up_s
        return since_s


class RunOn(NamedTuple):
    """Motion of an arm after the kill of its session."""

    speed_m_s: float
    """Speed before the kill."""
    time_s: float
    """Time until the arm rested."""
    distance_m: float


def kill_while_moving(name: str, speed_m_s: float) -> RunOn:
    """Kill the session of a robot of ROBOTS while its TCP moves."""
    with (
        tempfile.TemporaryDirectory(prefix="cardan-killed-") as folder,
        contextlib.ExitStack() as stack,
    ):
        robot, tables = stack.enter_context(driven(name, speed_m_s, Path(folder)))
        process = SessionProcess(parse_config(tables))
        follower = threading.Thread(target=process.follow, args=(Snapshot.from_bytes,))
        follower.start()
        stack.callback(follower.join)
        stack.callback(process.stop)
        watch = Watch(ROBOTS[name].arm, robot.joints)
        watch.until(lambda found: found > AT_SPEED * speed_m_s, STEADY_S)
        had = watch.sample()
        here, killed_s = watch.points[-1], time.monotonic()
        os.kill(process.pid, signal.SIGKILL)
        rested_s = watch.until(lambda found: found < REST_M_S, REST_S)
        # The averaging window had already begun this much earlier.
        stopped_s = max(rested_s - WINDOW_S - killed_s, 0.0)
        return RunOn(had, stopped_s, float(np.linalg.norm(watch.points[-1] - here)))


def _run(name: str, speed_m_s: float) -> RunOn:
    """Measure once; repeat if a busy machine stopped the arm before the kill."""
    for _ in range(TIMES):
        with contextlib.suppress(TimeoutError):
            return kill_while_moving(name, speed_m_s)
    raise TimeoutError(f"{name}: the arm was never moved steadily; is this machine very busy?")


def main() -> None:
    """Print the table."""
    print("\nthe session's process is killed while the TCP moves: how far the robot runs on\n")
    print(f"{'':24}" + "".join(f"{1e3 * each:>14.0f} mm/s" + " " * 14 for each in SPEEDS_M_S))
    print(f"{'median (largest) of ' + str(TIMES):24}" + "   mm            ms to rest    " * 2)
    for name in ROBOTS:
        cells = ""
        for speed_m_s in SPEEDS_M_S:
            runs = [_run(name, speed_m_s) for _ in range(TIMES)]
            ways = [1e3 * run.distance_m for run in runs]
            times = [1e3 * run.time_s for run in runs]
            cells += f"{statistics.median(ways):8.1f} ({max(ways):4.1f})"
            cells += f"{statistics.median(times):9.0f} ({max(times):3.0f})"
        print(f"{name:24}{cells}", flush=True)
    print(f"\nEGM's CommTimeout is {COMM_TIMEOUT_S:g} s here. An arm that is simulated in the")
    print("session's own process ends with it. Late: behind its command by as much as in the")
    print("paper of 2021.")
