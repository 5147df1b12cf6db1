"""Benchmarks: how often and how well the tracker answers, how fast, and what its peers do on the same scenes."""
