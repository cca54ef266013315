"""One readable line of a datagram of the joint stream, in the units of the wire."""

from __future__ import annotations

from cardan.dissect._scapy import Packet
from cardan.dissect.joint_stream import MODES, JointStreamState
from cardan.dissect.text import number, numbers

UNITS = {"positions": "rad or m", "speeds": "rad/s or m/s", "torques": "N·m or N"}
"""The arm's model decides between the two; the wire does not say it."""


def describe(layer: Packet) -> str:
    """Every value of a JointStreamState or JointStreamCommand."""
    parts = [
        type(layer).__name__,
        f"session {layer.session} sequence {layer.sequence} stamp {layer.stamp_s:.6f} s",
        f"{MODES[layer.mode]}, {layer.joints} joint{'s' if layer.joints > 1 else ''}",
    ]
    if isinstance(layer, JointStreamState):
        parts.append(f"taken {layer.taken}, cycle {number(layer.cycle_s)} s")
    parts += [f"{name} {numbers(getattr(layer, name))} {UNITS[name]}" for name in layer.lists]
    if isinstance(layer, JointStreamState):
        pose, wrench = layer.tcp_pose, layer.wrench
        parts.append(f"TCP pos {numbers(pose[:3])} m, quat {numbers(pose[3:])}")
        parts.append(f"force {numbers(wrench[:3])} N, torque {numbers(wrench[3:])} N·m")
        if layer.reason:
            parts.append(f"reason {layer.reason.decode()!r}")
    return " | ".join(parts)
