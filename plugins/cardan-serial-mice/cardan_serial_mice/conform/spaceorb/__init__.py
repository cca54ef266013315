"""Conformance of a SpaceOrb 360 on its serial line."""
