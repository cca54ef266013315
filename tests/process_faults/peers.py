"""The other processes of the fault table: a simulated robot that records its motion, and a
simulated device that follows commands.

    python -m tests.process_faults.peers robot KIND FILE PORT
    python -m tests.process_faults.peers hand KIND PLACE
"""

from __future__ import annotations

import os
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cardan.common.realtime import ask_for_real_time
from cardan.sim_peers.arm.options import PlantOptions, SimulatedArmOptions
from cardan.sim_peers.arm.udp import SimulatedArmPeer
from cardan.sim_peers.base import ScriptStep, SimulatedPeer, parse_script
from cardan.sim_peers.device_peer import DevicePeer
from cardan.sim_peers.egm_controller import EgmControllerOptions, EgmControllerPeer, EgmMode
from cardan.sim_peers.evdev import motion_script as pad
from cardan.sim_peers.evdev.peer import EvdevPeer, EvdevPeerOptions
from cardan.sim_peers.motoros_controller import MotorosControllerOptions, MotorosControllerPeer
from cardan.sim_peers.ros2_arm.options import RosArmOptions
from cardan.sim_peers.ros2_arm.peer import RosArmPeer
from cardan.sim_peers.ros2_device.peer import NodePeer, NodePeerOptions
from cardan.sim_peers.spacemouse import motion_script as puck
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions
from cardan_wiimote.peer import motion_script as remote
from cardan_wiimote.peer.peer import WiimotePeer, WiimotePeerOptions

COMM_TIMEOUT_S = 0.2
"""Period of EGM, as in docs/abb-egm.md."""

JOINTS = 6
SAMPLE = struct.Struct(f"d{JOINTS}d")
"""Local monotonic time, s, and the joints, rad. A NaN as time marks the start of a new process."""

SAMPLE_S = 0.004
LATE_S = 0.002
"""Longest time between a robot's cycle and its sample; later samples are left out."""
LISTEN_S = 0.02

# -- robots ---------------------------------------------------------------------------------------


def _gofa(mode: str, port: int) -> tuple[SimulatedPeer, Callable[[], Sequence[float]]]:
    options = EgmControllerOptions(pc_port=port, mode=EgmMode(mode), comm_timeout_s=COMM_TIMEOUT_S)
    peer = EgmControllerPeer(options)
    return peer, lambda: peer.core.joints_rad


def _gp8(port: int) -> tuple[SimulatedPeer, Callable[[], Sequence[float]]]:
    peer = MotorosControllerPeer(MotorosControllerOptions(base_port=port, velocity_mode=True))
    return peer, lambda: peer.controller.measured_rad(0)


# Without dynamics, which would need half of a processor: the samples are the commanded joints.


def _ur5(port: int) -> tuple[SimulatedPeer, Callable[[], Sequence[float]]]:
    options = SimulatedArmOptions(robot="ur5", port=port, plant=PlantOptions(drive="ideal"))
    peer = SimulatedArmPeer(options)
    return peer, lambda: peer.core.plant.positions


def _ros2(port: int) -> tuple[SimulatedPeer, Callable[[], Sequence[float]]]:
    peer = RosArmPeer(RosArmOptions(robot="ur5", port=port, drive="ideal"))
    return peer, lambda: peer.core.plant.positions


ROBOTS: dict[str, Callable[[int], tuple[SimulatedPeer, Callable[[], Sequence[float]]]]] = {
    "gofa-pose": lambda port: _gofa("pose", port),
    "gofa-joint": lambda port: _gofa("joint", port),
    "gp8": _gp8,
    "ur5": _ur5,
    "ros2-ur5": _ros2,
}


def serve_robot(kind: str, file: Path, port: int) -> None:
    """Serve until killed, and append samples of the joints to the file."""
    peer, joints = ROBOTS[kind](port)
    ask_for_real_time()  # before opening starts threads
    peer.open()
    with file.open("ab", buffering=0) as out:
        out.write(SAMPLE.pack(float("nan"), *[0.0] * JOINTS))
        print("READY", flush=True)
        while True:
            until_s = time.monotonic() + SAMPLE_S
            peer.step(until_s)
            found, now_s = joints(), time.monotonic()
            # If the process has paused, these joints may be older than the time of the sample.
            if now_s < until_s + LATE_S:
                out.write(SAMPLE.pack(now_s, *found))


# -- devices --------------------------------------------------------------------------------------


class ScriptedPeer(NamedTuple):
    """A simulated device, and functions that drive it by lines of a motion script."""

    make: Callable[[str, str], DevicePeer[Any, Any]]
    """Make the device from a place and a first script."""
    motion: Callable[[Sequence[ScriptStep], Any], Any]
    """Make a motion from steps and the device."""
    verbs: Mapping[str, str]


def _mouse(place: str, script: str) -> DevicePeer[Any, Any]:
    return SpaceMousePeer(SpaceMousePeerOptions(hid=place, script=script, jitter_lsb=0))


PEERS: dict[str, ScriptedPeer] = {
    "spacemouse": ScriptedPeer(
        _mouse,
        lambda steps, device: puck.ScriptedPuck(steps, device.model),
        puck.SCRIPT_VERBS,
    ),
    "gamepad": ScriptedPeer(
        lambda place, script: EvdevPeer(EvdevPeerOptions(path=place, script=script)),
        pad.ScriptedInput,
        pad.SCRIPT_VERBS,
    ),
    "wiimote": ScriptedPeer(
        lambda place, script: WiimotePeer(WiimotePeerOptions(l2cap=place, script=script)),
        lambda steps, _: remote.ScriptedWiimote(steps),
        remote.SCRIPT_VERBS,
    ),
    "ros2-device": ScriptedPeer(
        lambda place, script: NodePeer(NodePeerOptions(port=int(place), script=script)),
        lambda steps, device: puck.ScriptedPuck(steps, device.model),
        puck.SCRIPT_VERBS,
    ),
}


def serve_device(kind: str, place: str, held: str = "") -> None:
    """Serve until killed. Each line of standard input has steps of a script, separated by
    semicolons; the device does them at once and keeps the result. `held` is done before a driver
    can connect."""
    of = PEERS[kind]

    def motion_of(steps: str) -> Any:
        text = "\n".join(f"0 {step.strip()}" for step in steps.split(";"))
        return of.motion(parse_script(text, of.verbs), peer.device)

    with tempfile.NamedTemporaryFile("w", suffix=".txt") as nothing:
        peer = of.make(place, nothing.name)
    if held:
        peer.motion = motion_of(held)
    ask_for_real_time()
    peer.open()
    os.set_blocking(0, False)
    print("READY", flush=True)
    left = b""
    while True:
        peer.step(time.monotonic() + LISTEN_S)
        try:
            data = os.read(0, 4096)
        except BlockingIOError:
            continue
        if not data:
            return
        *lines, left = (left + data).split(b"\n")
        for line in lines:
            peer.motion = motion_of(line.decode())
            peer.catch_up()
            print("DONE", flush=True)


if __name__ == "__main__":
    what, kind, *rest = sys.argv[1:]
    if what == "robot":
        serve_robot(kind, Path(rest[0]), int(rest[1]))
    else:
        serve_device(kind, *rest)
