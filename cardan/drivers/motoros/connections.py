"""The TCP connections of a MotoROS driver."""

from __future__ import annotations

from typing import Literal

Channel = Literal["motion", "state"]
CHANNELS: tuple[Channel, ...] = ("state", "motion")
"""The state port comes first: its messages reveal the byte order of the other."""
