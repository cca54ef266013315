"""The joint stream: states of a joint-controlled arm one way, joint commands the other.

Our own protocol, for the simulated arm; docs/simulated-peers.md describes it.
"""
