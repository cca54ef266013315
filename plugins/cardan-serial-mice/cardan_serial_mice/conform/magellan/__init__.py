"""Conformance of a serial device that speaks Magellan's protocol."""
