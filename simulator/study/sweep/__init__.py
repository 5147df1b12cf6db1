"""Sweeps over keys, and comparison of runs."""
