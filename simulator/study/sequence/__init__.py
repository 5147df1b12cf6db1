"""Sequences of frames in tracking mode."""
