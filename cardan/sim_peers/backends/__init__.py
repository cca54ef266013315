"""Backends that carry the reports of simulated devices: each is one way to reach a device.

A backend is a part of a :class:`~cardan.sim_peers.hand_peer.HandPeer`; `base` has the contract.
"""
