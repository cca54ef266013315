"""Conformance of a Leap Motion tracking service."""
