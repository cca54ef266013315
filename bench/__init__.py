"""Benchmarks: each compares its subjects within one run and prints ratios. ``python -m bench``."""
