"""A gantry of three linear axes, whose controller exchanges axis positions over UDP at 125 Hz."""
