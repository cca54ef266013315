"""Conformance of a daemon that serves spacenavd's socket."""
