"""Attitude, camera and lens: rotations between frames, pixels and unit vectors, linear algebra with few unknowns."""
