"""Hands and arms as programs for robot learning have them: flat dictionaries of names and numbers.

Nothing here needs LeRobot; the distributions beside this one are its classes on top of these.
"""
