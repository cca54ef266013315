"""A simulated 3Dconnexion device: the puck, the hands that move it, and the ways to open it."""
