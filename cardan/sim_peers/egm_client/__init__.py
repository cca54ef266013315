"""Defects of clients of EGM: what they make of the messages of one that has none."""

from cardan.sim_peers.egm_client.defects import EgmClientDefects as EgmClientDefects
from cardan.sim_peers.egm_client.faults import FAULTS as FAULTS
