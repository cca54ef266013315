"""A simulated robot or device in a separate process, which reports its true state.

    python -m bench.soak.peers KIND OPTIONS

KIND is one of ROBOTS or DEVICES, OPTIONS are those of its peer, as JSON. It prints READY. A robot
then prints its true joints twenty times a second: ``J TIME JOINT ...``, monotonic s and rad. A
device reads motion scripts from standard input, one JSON line each, and plays them at once. The
process ends at the end of standard input.
"""

from __future__ import annotations

import json
import os
import select
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

from cardan.common.realtime import ask_for_real_time
from cardan.sim_peers.arm.options import PlantOptions, SimulatedArmOptions
from cardan.sim_peers.arm.udp import SimulatedArmPeer
from cardan.sim_peers.base import ScriptStep, SimulatedPeer
from cardan.sim_peers.device_peer import DevicePeer
from cardan.sim_peers.egm_controller import EgmControllerOptions, EgmControllerPeer, EgmMode
from cardan.sim_peers.evdev.motion_script import ScriptedInput
from cardan.sim_peers.evdev.peer import EvdevPeer, EvdevPeerOptions
from cardan.sim_peers.motoros_controller import MotorosControllerOptions, MotorosControllerPeer
from cardan.sim_peers.scripted import DeviceMotion
from cardan.sim_peers.spacemouse.motion_script import ScriptedPuck
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions
from cardan_wiimote.peer.motion_script import ScriptedWiimote
from cardan_wiimote.peer.peer import WiimotePeer, WiimotePeerOptions

STEP_S: Final = 0.05
"""Period at which a robot reports its joints and a device checks for a new motion script."""

IDEAL: Final = PlantOptions(drive="ideal")
"""Kinematic arms: the soak tests the controllers, not the dynamics."""

Joints = Callable[[], Sequence[float]]

Script = dict[str, Any]
"""``at_s``: start, monotonic; ``steps``: lists of seconds, verb and arguments."""


def _gofa(options: dict[str, Any]) -> tuple[SimulatedPeer, Joints]:
    egm = EgmControllerPeer(EgmControllerOptions(mode=EgmMode.JOINT, **options))
    return egm, lambda: egm.core.joints_rad


def _gp8(options: dict[str, Any]) -> tuple[SimulatedPeer, Joints]:
    motoros = MotorosControllerPeer(MotorosControllerOptions(**options))
    return motoros, lambda: motoros.controller.measured_rad(0)


def _ur5(options: dict[str, Any]) -> tuple[SimulatedPeer, Joints]:
    arm = SimulatedArmPeer(SimulatedArmOptions(robot="ur5", plant=IDEAL, **options))
    return arm, lambda: arm.core.plant.positions


def _spacemouse(options: dict[str, Any]) -> DevicePeer[Any, Any]:
    return SpaceMousePeer(SpaceMousePeerOptions(script="rest", start_on_connect=False, **options))


def _gamepad(options: dict[str, Any]) -> DevicePeer[Any, Any]:
    return EvdevPeer(EvdevPeerOptions(script="rest", start_on_connect=False, **options))


def _wiimote(options: dict[str, Any]) -> DevicePeer[Any, Any]:
    return WiimotePeer(WiimotePeerOptions(script="rest", start_on_connect=False, **options))


ROBOTS: Final = {"gofa": _gofa, "gp8": _gp8, "ur5": _ur5}
DEVICES: Final = {"spacemouse": _spacemouse, "gamepad": _gamepad, "wiimote": _wiimote}


def steps_of(script: Script, device_s: float, now_s: float) -> list[ScriptStep]:
    """Convert a script's steps to the device's time, which is `device_s` at the monotonic time
    `now_s`. Overdue steps are performed at once, so that a device that was stopped does not lag
    behind its script."""
    begin_s = device_s + script["at_s"] - now_s
    return [
        ScriptStep(max(begin_s + float(time_s), 0.0), verb, tuple(map(str, words)))
        for time_s, verb, *words in script["steps"]
    ]


def _motion(kind: str, peer: DevicePeer[Any, Any], script: Script) -> DeviceMotion[Any]:
    """Return the motion of a script."""
    steps = steps_of(script, peer.device_s(), time.monotonic())
    if kind == "spacemouse":
        return ScriptedPuck(steps, peer.device.model)
    return ScriptedInput(steps, peer.device) if kind == "gamepad" else ScriptedWiimote(steps)


class _Lines:
    """Standard input, read line by line without blocking."""

    def __init__(self) -> None:
        self._left = b""
        self.ended = False

    def read(self) -> list[bytes]:
        while not self.ended and select.select([0], [], [], 0.0)[0]:
            data = os.read(0, 1 << 16)
            self.ended = not data
            self._left += data
        *lines, self._left = self._left.split(b"\n")
        return lines


def main() -> None:
    """Run the peer until the end of standard input."""
    kind, options = sys.argv[1], json.loads(sys.argv[2])
    joints: Joints | None = None
    device: DevicePeer[Any, Any] | None = None
    peer: SimulatedPeer
    if kind in ROBOTS:
        peer, joints = ROBOTS[kind](options)
    else:
        peer = device = DEVICES[kind](options)
    lines = _Lines()
    peer.open()
    try:
        ask_for_real_time()
        print(f"READY {peer.endpoint}", flush=True)
        while not lines.ended:
            peer.step(time.monotonic() + STEP_S)
            for line in lines.read():
                if device is not None:
                    device.motion = _motion(kind, device, json.loads(line))
            if joints is not None:
                words = " ".join(f"{each:.6f}" for each in joints())
                print(f"J {time.monotonic():.4f} {words}", flush=True)
    finally:
        peer.close()


if __name__ == "__main__":
    main()
