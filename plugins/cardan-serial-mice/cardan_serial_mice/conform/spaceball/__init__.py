"""Conformance of a Spaceball on its serial line."""
