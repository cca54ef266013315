"""Backends that carry the reports of simulated devices: each is one way to reach a device.

A backend is a part of a :class:`~cardan.sim_peers.device_peer.DevicePeer`; `base` has the contract.
"""
