"""Operator devices, arms and records in the form of robot-learning programs: flat dictionaries of
names and numbers, and data sets of them. Nothing here needs LeRobot; lerobot_robot_cardan and
lerobot_teleoperator_cardan have its classes on top of these."""
