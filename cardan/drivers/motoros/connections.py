"""The TCP connections of a MotoROS driver."""

from __future__ import annotations

from typing import Literal

Channel = Literal["motion", "state"]
CHANNELS: tuple[Channel, ...] = ("state", "motion")
"""Order of connecting: messages of the state port reveal the byte order of the motion port."""
