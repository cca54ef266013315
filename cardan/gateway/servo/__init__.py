"""The servo: one quadratic program a tick turns the requested twist into safe joint motion."""
