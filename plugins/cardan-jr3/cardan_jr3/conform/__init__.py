"""Conformance of a JR3 force-torque sensor behind uc3m's board, on a CAN bus."""
