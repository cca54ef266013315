"""Conformance suites for arms on ROS 2 and the joint stream, and for drivers of the latter."""
