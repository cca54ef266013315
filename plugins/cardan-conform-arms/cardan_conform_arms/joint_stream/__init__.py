"""Conformance of an arm that speaks the joint stream."""
