"""Benchmarks: everything is measured in one run and printed as ratios. ``python -m bench``."""
