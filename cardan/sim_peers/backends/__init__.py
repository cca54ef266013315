"""Transports for the reports of simulated devices.

A backend is a part of a :class:`~cardan.sim_peers.device_peer.DevicePeer`; `base` has the contract.
"""
