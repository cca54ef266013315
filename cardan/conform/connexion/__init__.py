"""Conformance of a 3Dconnexion device that speaks HID."""
