"""Acceptance tests: programs use all of Cardan as its users do, by page, by rosbridge, in a lab."""
