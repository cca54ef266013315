"""Joint stream protocol: states of a joint-controlled arm in one direction, joint commands in the
other.

It is Cardan's own, for the simulated arm; docs/simulated-peers.md describes it.
"""
