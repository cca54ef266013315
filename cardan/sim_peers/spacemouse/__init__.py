"""A simulated 3Dconnexion device: the puck, its motion scripts, and the ways to open it."""
