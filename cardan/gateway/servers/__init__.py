"""Processes on the bus that show it in other protocols, or keep it together."""
