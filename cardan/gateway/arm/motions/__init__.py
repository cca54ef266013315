"""Motions of an arm, one at a time. No motion supervises or limits."""
