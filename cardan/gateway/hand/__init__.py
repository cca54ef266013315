"""What an operator's hand asks for; it decides nothing about the robot."""
