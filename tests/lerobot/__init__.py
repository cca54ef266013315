"""Distributions of plugins/ tested with LeRobot if it is installed, else with its published
interface."""
