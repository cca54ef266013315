"""Kinematics: forward, Jacobian, inverse and distances of any arm, on Pinocchio and Coal."""
