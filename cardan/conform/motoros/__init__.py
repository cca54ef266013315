"""Conformance of a Motoman controller that runs MotoROS: trajectories, and the velocity mode."""
