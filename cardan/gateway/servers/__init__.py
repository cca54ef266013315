"""Servers that offer the bus in other protocols, and its router."""
