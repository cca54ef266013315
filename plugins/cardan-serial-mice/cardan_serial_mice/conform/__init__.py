"""Conformance suites for serial six-axis devices."""
