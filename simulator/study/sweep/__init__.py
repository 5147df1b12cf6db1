"""Sweeps over keys, and runs side by side."""
