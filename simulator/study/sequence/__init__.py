"""Sequences: frame after frame in tracking mode."""
