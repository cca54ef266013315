"""JR3 force-torque sensors behind uc3m's mbed board, on a CAN bus, for Cardan."""
