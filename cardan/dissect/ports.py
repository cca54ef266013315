"""Where each protocol is looked for when nothing else is said."""

from __future__ import annotations

EGM_PORTS = (6510, 6511, 6512, 6513)
"""UDP ports of a PC: 6510 in ABB's examples, 6511 and up for the first, second ... robot in the
StateMachine add-in and the ROS drivers."""

JOINT_STREAM_PORT = 6520
"""UDP port of the simulated arm when none is chosen."""
