"""Hands, arms and records as programs for robot learning have them: flat dictionaries of names and
numbers, and data sets of them.

Nothing here needs LeRobot; the distributions beside this one are its classes on top of these.
"""
