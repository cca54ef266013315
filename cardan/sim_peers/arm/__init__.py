"""A simulated joint-controlled arm with rigid-body dynamics, drives, joint stops and contact.

`options` and `faults` do without Pinocchio, as the driver of a served arm does.
"""
