"""Conformance of a Wii Remote."""
