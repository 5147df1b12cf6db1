"""Benchmarks of the tracker's success rate, accuracy and speed, compared with other programs on the same scenes."""
