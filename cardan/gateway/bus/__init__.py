"""An arm on the bus: topics and commands of a session."""
