"""Conformance of a client of MotoROS: we are the controller."""
