"""Acceptance tests: programs use the whole of Cardan as users do, through the console page, through
rosbridge and in a lab."""
