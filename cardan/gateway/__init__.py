"""Joins an operator device to a robot: mapping, reference, sessions, configuration."""
