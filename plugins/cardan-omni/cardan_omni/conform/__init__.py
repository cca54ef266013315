"""Conformance of an HDAPI library, with the haptic device behind it."""
