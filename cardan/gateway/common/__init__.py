"""Shared by the rooms of the gateway: how its commands serve on Unix sockets."""
