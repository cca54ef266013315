"""Conformance of a driver that guides a controller over EGM: we are the controller."""
