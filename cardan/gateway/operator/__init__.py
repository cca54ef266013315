"""The operator's input: requests of an operator device. It decides nothing about the robot."""
