"""The servo: one quadratic program a tick turns what is wanted into joint motion that is safe."""
