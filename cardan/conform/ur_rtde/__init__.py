"""Conformance of a Universal Robots controller: RTDE, programs by primary interface, dashboard."""
