"""Conformance of an arm under ros2_control: its joint states, its description, its controller."""
