"""What carries the reports of simulated devices: each module is one way to reach a device.

A backend is a part of a :class:`~cardan.sim_peers.hand_peer.HandPeer`; `base` has the contract.
"""
