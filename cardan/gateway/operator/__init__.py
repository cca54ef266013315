"""The operator's input: what an operator device asks for. It decides nothing about the robot."""
