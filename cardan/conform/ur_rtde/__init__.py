"""Conformance of a Universal Robots controller: RTDE, programs over the primary interface, and
dashboard."""
