"""Conformance of a client of the joint stream: we are the arm."""
