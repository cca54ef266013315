"""The servo: one quadratic programme a tick turns what is wanted into joint motion that is safe."""
