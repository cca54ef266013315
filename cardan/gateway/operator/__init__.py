"""The operator's input: requests of an operator device. Decisions about the robot are the
controller's."""
