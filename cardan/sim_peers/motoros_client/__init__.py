"""Defects of clients of MotoROS, applied to the messages of a client without defects."""

from cardan.sim_peers.motoros_client.defects import (
    MotorosClientDefects as MotorosClientDefects,
    Sent as Sent,
)
from cardan.sim_peers.motoros_client.faults import FAULTS as FAULTS
