"""Drivers, a module or package per device or controller: connection and protocol, nothing else."""
