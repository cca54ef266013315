"""Bounds of a CAN bus's options, for driver and simulated sensor."""

from __future__ import annotations

from cardan.common.bounds import Text

CAN_PORTS = {"udp_multicast": 43113, "socketcand": 29536}
"""Default ports of python-can's interfaces over a network."""
CAN_NAME = Text(r"[^\0]+", "a name, as python-can calls it")
