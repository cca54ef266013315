"""An arm on the bus: what a session publishes, and what it takes."""
