"""Default ports of each protocol."""

from __future__ import annotations

EGM_PORTS = (6510, 6511, 6512, 6513)
"""UDP ports of a PC: 6510 in ABB's examples, 6511 and up for the first, second ... robot in the
StateMachine add-in and the ROS drivers."""

JOINT_STREAM_PORT = 6520
"""Default UDP port of the simulated arm."""

SIMPLE_MESSAGE_PORTS = (50240, 50241, 50242)
"""TCP ports of a controller with MotoROS: motion, state, I/O. The generic drivers of ROS-Industrial
have 11000, 11002, 11003 instead."""

SIMPLE_MESSAGE_RT_CONTROL_PORT = 50243
"""TCP port that switches the real-time mode of the NTNU fork of MotoROS on and off."""

SIMPLE_MESSAGE_RT_PORT = 50244
"""UDP port of that mode's cycle."""

RTDE_PORTS = (30004,)
"""TCP port of a Universal Robots controller."""
