"""Defects of clients of MotoROS: what they make of the messages of one that has none."""

from cardan.sim_peers.motoros_client.defects import (
    MotorosClientDefects as MotorosClientDefects,
    Sent as Sent,
)
from cardan.sim_peers.motoros_client.faults import FAULTS as FAULTS
