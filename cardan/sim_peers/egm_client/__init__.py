"""Defects of clients of EGM, applied to the messages of a client without defects."""

from cardan.sim_peers.egm_client.defects import EgmClientDefects as EgmClientDefects
from cardan.sim_peers.egm_client.faults import FAULTS as FAULTS
